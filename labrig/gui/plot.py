"""A pane of curves: OpenCV's smooth lines under Tk's own text, drawn in milliseconds."""

from __future__ import annotations

import tkinter as tk
from typing import Any

import numpy as np
from PIL import Image, ImageTk

from labrig.gui.curves import (
    Chart,
    Frame,
    draw,
    log_ticks,
    power_text,
    ranges,
    tick_text,
    ticks,
)
from labrig.gui.palette import rgb
from labrig.gui.style import Style

LEGEND_SHARE = 0.9  # of the pane's width, at most


class PlotPane(tk.Canvas):
    """Shows a chart, and the values under the pointer."""

    def __init__(self, parent: tk.Misc, style: Style, *, height: int = 120) -> None:
        super().__init__(
            parent,
            highlightthickness=0,
            borderwidth=0,
            width=style.px(160),
            height=style.px(height),
        )
        self.ui = style
        self.chart = Chart()
        self.frame: Frame | None = None
        self._photo: ImageTk.PhotoImage | None = None
        self.n_drawn = 0
        self.bind("<Configure>", lambda _e: self.redraw())
        self.bind("<Motion>", self._read)
        self.bind("<Leave>", lambda _e: self.delete("read"))

    def show(self, chart: Chart) -> None:
        """Show a chart."""
        self.chart = chart
        self.redraw()

    def redraw(self) -> None:
        """Draw everything anew."""
        width, height = self.winfo_width(), self.winfo_height()
        if width < 40 or height < 40:
            return
        p, px = self.ui.palette, self.ui.px
        self.configure(background=p.card)
        self.delete("all")
        frame = self._frame(width, height)
        self.frame = frame
        picture = np.empty((height, width, 3), np.uint8)
        picture[:] = rgb(p.card)
        picture[frame.top : frame.bottom, frame.left : frame.right] = rgb(p.field)
        self._item = self.create_image(0, 0, anchor="nw")
        self._draw_ticks(picture, frame)
        draw(picture, self.chart, frame, scale=self.ui.scale, ground=p.field)
        self._photo = ImageTk.PhotoImage(Image.fromarray(picture), master=self)
        self.itemconfigure(self._item, image=self._photo)
        self.create_rectangle(frame.left, frame.top, frame.right, frame.bottom, outline=p.line)
        chart, small = self.chart, self.ui.font("small")
        self._text((frame.left + frame.right) // 2, height - px(3), chart.x_label, anchor="s")
        self._text(
            frame.left, px(3), chart.title or chart.y_label, anchor="nw", bold=bool(chart.title)
        )
        if chart.title and chart.y_label:
            self.create_text(
                frame.right, px(4), text=chart.y_label, anchor="ne", font=small, fill=p.dim
            )
        self._legend(frame)
        self.n_drawn += 1

    def _frame(self, width: int, height: int) -> Frame:
        px, small = self.ui.px, self.ui.font("small")
        x, y = ranges(self.chart)
        texts = [text for _, text in self._y_ticks(y, 5)]
        margin = max((small.measure(text) for text in texts), default=0)
        line = small.metrics("linespace")
        return Frame(
            left=margin + px(12),
            top=line + px(9),
            right=width - px(12),
            bottom=max(height - 2 * line - px(9), line + px(20)),
            x=x,
            y=y,
            log=self.chart.log,
        )

    def _y_ticks(self, y: tuple[float, float], n: int) -> list[tuple[float, str]]:
        if self.chart.log:
            return [(value, power_text(value)) for value in log_ticks(*y)[0]]
        found = ticks(*y, n)
        step = found[1] - found[0] if len(found) > 1 else 1.0
        return [(value, tick_text(value, step)) for value in found]

    def _draw_ticks(self, picture: Any, frame: Frame) -> None:
        p, px, small = self.ui.palette, self.ui.px, self.ui.font("small")
        line = small.metrics("linespace")
        n_y = max((frame.bottom - frame.top) // (2 * line), 1)
        n_x = max((frame.right - frame.left) // (5 * line), 2)
        x_ticks = ticks(*frame.x, n_x)
        grid = [(2 * a + b) // 3 for a, b in zip(rgb(p.field), rgb(p.line), strict=True)]
        step = x_ticks[1] - x_ticks[0] if len(x_ticks) > 1 else 1.0
        for value in x_ticks:
            x = float(frame.at(np.array([value]), np.array([frame.y[1]]))[0, 0])
            picture[frame.top : frame.bottom, min(round(x), frame.right)] = grid
            self.create_text(
                x,
                frame.bottom + px(3),
                text=tick_text(value, step),
                anchor="n",
                font=small,
                fill=p.dim,
            )
        for value, text in self._y_ticks(frame.y, n_y):
            y = float(frame.at(np.array([frame.x[0]]), np.array([value]))[0, 1])
            picture[min(round(y), frame.bottom), frame.left : frame.right] = grid
            self.create_text(frame.left - px(5), y, text=text, anchor="e", font=small, fill=p.dim)

    def _text(self, x: int, y: int, text: str, *, anchor: Any, bold: bool = False) -> None:
        if text:
            p = self.ui.palette
            self.create_text(
                x,
                y,
                text=text,
                anchor=anchor,
                font=self.ui.font("bold" if bold else "small"),
                fill=p.text if bold else p.dim,
            )

    def _legend(self, frame: Frame) -> None:
        p, px, font = self.ui.palette, self.ui.px, self.ui.font("small")
        named = [c for c in self.chart.curves if c.name] if self.chart.legend else []
        if not (named or self.chart.notes):
            return
        line = font.metrics("linespace") + px(2)
        texts = [*(c.name for c in named), *self.chart.notes]
        wide = max(font.measure(text) for text in texts) + px(44)
        rows, columns = self._legend_size(frame, len(texts), wide, line)
        if rows * line > 0.5 * (frame.bottom - frame.top):
            return  # it would hide the curves
        x, y = frame.right - columns * wide - px(4), frame.top + px(6)
        self.create_rectangle(
            x, y, frame.right - px(6), y + line * rows + px(6), fill=p.card, outline=p.line
        )
        for k, text in enumerate(texts):
            left, row = x + (k // rows) * wide, y + px(3) + line * (k % rows) + line // 2
            indent = px(8)
            if k < len(named):
                colour, dashes, marker = named[k].look
                self._key(left + px(6), row, colour, dashes, marker, hollow=named[k].points)
                indent = px(36)
            self.create_text(left + indent, row, text=text, anchor="w", font=font, fill=p.text)

    def _legend_size(self, frame: Frame, n: int, wide: int, line: int) -> tuple[int, int]:
        """Return rows and columns of a legend of n names: one column if that leaves room below."""
        width, height = frame.right - frame.left, frame.bottom - frame.top
        fit = next((r for r in range(1, n + 1) if -(-n // r) * wide <= LEGEND_SHARE * width), n)
        rows = n if n * line <= 0.5 * height else fit
        return rows, -(-n // rows)

    def _key(
        self, x: int, y: int, colour: str, dashes: tuple[float, ...], marker: str, *, hollow: bool
    ) -> None:
        px = self.ui.px
        if not hollow:
            dash = tuple(max(px(d), 1) for d in dashes) or ()
            self.create_line(x, y, x + px(24), y, fill=colour, width=px(2), dash=dash)
        r, at = px(3), x + px(12)
        shapes = {
            "s": (at - r, y - r, at + r, y - r, at + r, y + r, at - r, y + r),
            "^": (at - r, y + r, at + r, y + r, at, y - r - 1),
            "v": (at - r, y - r, at + r, y - r, at, y + r + 1),
            "D": (at - r - 1, y, at, y - r - 1, at + r + 1, y, at, y + r + 1),
            "P": (
                at,
                y - r - 1,
                at + r + 1,
                y - 1,
                at + r - 1,
                y + r,
                at - r + 1,
                y + r,
                at - r - 1,
                y - 1,
            ),
        }
        filled = self.ui.palette.card if hollow else colour
        if marker == "o":
            self.create_oval(at - r, y - r, at + r, y + r, fill=filled, outline=colour)
        elif marker in shapes:
            self.create_polygon(*shapes[marker], fill=filled, outline=colour)

    def _read(self, event: tk.Event[Any]) -> None:
        self.delete("read")
        frame = self.frame
        if frame is None or not self.chart.curves:
            return
        if not (frame.left <= event.x <= frame.right and frame.top <= event.y <= frame.bottom):
            return
        x, y = frame.values(event.x, event.y)
        p, font, px = self.ui.palette, self.ui.font("small"), self.ui.px
        self.create_line(
            event.x, frame.top, event.x, frame.bottom, fill=p.dim, dash=(2, 3), tags="read"
        )
        item = self.create_text(
            frame.left + px(5),
            frame.bottom - px(4),
            text=f"{x:.4g}, {y:.4g}",
            anchor="sw",
            font=font,
            fill=p.text,
            tags="read",
        )
        box = self.bbox(item)
        under = self.create_rectangle(*box, fill=p.card, outline="", tags="read")
        self.tag_lower(under, item)
