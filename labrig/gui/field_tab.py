"""The light field: pictures with a glyph of directions at every sampling point."""

from __future__ import annotations

import math
import tkinter as tk
from dataclasses import dataclass
from tkinter import ttk
from typing import Any

import numpy as np
from PIL import Image, ImageTk

from labrig.gui.bounces_tab import FINER, smooth
from labrig.gui.images import Rgb, fill, outline
from labrig.gui.palette import rgb
from labrig.gui.pane import PicturePane
from labrig.gui.result_tabs import ResultTab
from labrig.gui.style import Style
from labrig.station.shown import Bounces, Shown

PITCH_PX = 46.0  # of glyphs on the screen at scale 1
REACH = 0.46  # of the pitch
FAINT = 1e-4  # of the brightest: points darker than that have no glyph
RED = "#ff6b57"
ALONE = "red marks: sampling points · white outlines: radiance by direction"
BESIDE = "each picture to its own maximum"


@dataclass
class Half:
    """One result in the tab: its pane, its bounces, its name, and the glyphs drawn last."""

    pane: PicturePane
    bounces: Bounces | None = None
    name: str = ""
    n_glyphs: int = 0


class FieldTab(ResultTab):
    """Light of one bounce with its directions; under the pointer they are shown large."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style, numbers=False)
        px = style.px
        top = ttk.Frame(self.figure, style="Card.TFrame")
        top.pack(fill="x", pady=(0, px(4)))
        ttk.Label(top, text="bounce", style="CardDim.TLabel").pack(side="left")
        self.chosen = ttk.Spinbox(
            top, from_=2, to=6, width=3, command=self._moved, font=style.font(), state="readonly"
        )
        self.chosen.set(2)
        self.chosen.pack(side="left", padx=px(6))
        self.alone = ttk.Button(
            top, text="End comparison", style="Tool.TButton", command=lambda: self.compare(None)
        )
        self.words = ttk.Label(top, text=ALONE, style="CardDim.TLabel")
        self.words.pack(side="right")
        side = ttk.Frame(self.figure, style="Card.TFrame", width=px(200))
        side.pack_propagate(False)
        side.pack(side="right", fill="y", padx=(px(4), 0))
        self.polar = tk.Canvas(side, width=px(196), height=px(196), highlightthickness=0)
        self.polar.pack(fill="x")
        self.numbers_of = ttk.Label(
            side,
            text="Point at the picture, or use the arrow keys.",
            style="Card.TLabel",
            justify="left",
            wraplength=px(190),
        )
        self.numbers_of.pack(fill="x", pady=px(6))
        holder = ttk.Frame(self.figure, style="Card.TFrame")
        holder.pack(fill="both", expand=True)
        self.halves = [Half(pane=PicturePane(holder, style)) for _ in range(2)]
        for half in self.halves:
            half.pane.on_paint.append(lambda rgb, half=half: self._glyphs(rgb, half))  # type: ignore[misc]
            half.pane.on_read = lambda half=half: self._read(half)  # type: ignore[misc]
        self.halves[0].pane.pack(side="left", fill="both", expand=True)
        self._photo: ImageTk.PhotoImage | None = None
        self.polar.bind("<Configure>", lambda _e: self._read(self.halves[0]))

    @property
    def bounce(self) -> int:
        """The bounce that is shown."""
        return int(self.chosen.get())

    def draw(self, shown: Shown) -> None:
        """Show a result's light field."""
        if shown.bounces is None:
            self.say("This analysis stopped after the separation: there is no light field.")
            return
        self.take(shown.bounces, shown.title)

    def take(self, bounces: Bounces, name: str) -> None:
        """Show bounces, as fitted or weighted."""
        self.halves[0].bounces, self.halves[0].name = bounces, name
        self.chosen.configure(to=bounces.pictures.shape[0])
        self._redraw()

    def compare(self, other: Shown | None) -> None:
        """Show another result beside this one, or no other."""
        half = self.halves[1]
        half.bounces = None if other is None else other.bounces
        half.name = "" if other is None else other.title
        if half.bounces is None:
            half.pane.pack_forget()
            self.alone.pack_forget()
            self.words.configure(text=ALONE)
        else:
            self.words.configure(text=BESIDE)
            half.pane.pack(side="left", fill="both", expand=True, padx=(self.ui.px(3), 0))
            self.alone.pack(side="left", padx=self.ui.px(6))
        self._redraw()

    def _moved(self) -> None:
        self._redraw()

    def _redraw(self) -> None:
        k = self.bounce
        for half in self.halves:
            found = half.bounces
            if found is None or k > found.pictures.shape[0]:
                half.pane.title = ""
                half.pane.show(None)
                continue
            picture = found.pictures[k - 1]
            angle = math.degrees(found.beam_angle_rad)
            half.pane.title = f"bounce {k}, beam at {angle:.3g}°"
            if self.halves[1].bounces is not None:
                half.pane.title += f"\n{half.name}"
            half.pane.look.high = max(float(np.quantile(picture, 0.999)), 1e-30)
            half.pane.recolour()
            half.pane.show(smooth(picture, found.lit))
        self._read(self.halves[0])

    def _glyphs(self, painted: Rgb, half: Half) -> None:
        """Draw a glyph at every sampling point of the pane's own grid."""
        found, view = half.bounces, half.pane.view
        half.n_glyphs = 0
        if found is None:
            return
        scale = self.ui.scale
        node_px = FINER * view.zoom
        step = max(round(PITCH_PX * scale / node_px), 1)
        reach = REACH * step * node_px
        light = found.light_field[self.bounce - 2]
        top, bottom, left, right = found.lit
        light = light[top : bottom + 1, left : right + 1]
        n_y, n_x = light.shape[:2]
        rows = np.arange((n_y - 1) // 2 % step, n_y, step)
        cols = np.arange(step // 2, n_x, step)
        part = light[np.ix_(rows, cols)].astype(np.float64)
        tops = part.max(axis=2)
        least = FAINT * float(light.max())
        turn = np.stack([np.cos(found.theta), np.sin(found.theta)], axis=1)
        for i, row in enumerate(rows):
            for j, col in enumerate(cols):
                if tops[i, j] <= least:
                    continue
                centre = np.array(view.to_pane((col + 0.5) * FINER, (row + 0.5) * FINER))
                if not (
                    -reach < centre[0] < view.width + reach
                    and -reach < centre[1] < view.height + reach
                ):
                    continue
                shape = centre + reach * (part[i, j] / tops[i, j])[:, None] * turn
                outline(painted, shape, "#0b0e11", width=max(round(3 * scale), 3))
                outline(painted, shape, "#ffffff", width=max(round(scale), 1))
                arm = 3.0 * scale
                for d in ((arm, 0.0), (0.0, arm)):
                    cross = np.array([centre - d, centre + d])
                    outline(painted, cross, RED, width=max(round(1.4 * scale), 1), closed=False)
                half.n_glyphs += 1

    def _read(self, half: Half) -> None:
        found, at = half.bounces, half.pane.read_at
        if found is None:
            return
        n_y, n_x = found.pictures.shape[1:]
        top, bottom, left, _ = found.lit
        col, row = left + 4, (top + bottom) // 2
        if at is not None:
            col, row = left + at[0] // FINER, top + at[1] // FINER
        col, row = min(max(col, 0), n_x - 1), min(max(row, 0), n_y - 1)
        self._draw_polar(found, row, col)

    def _draw_polar(self, found: Bounces, row: int, col: int) -> None:
        """Draw the radiance of a point by direction, large, with its numbers."""
        canvas, p, px = self.polar, self.ui.palette, self.ui.px
        size = min(canvas.winfo_width(), canvas.winfo_height())
        if size < 40:
            return
        radiance = found.light_field[self.bounce - 2, row, col].astype(np.float64)
        total, top = float(radiance.sum()), float(radiance.max())
        picture = np.empty((size, size, 3), np.uint8)
        picture[:] = rgb(p.field)
        centre, radius = np.array([size / 2, size / 2]), 0.40 * size
        circle = np.linspace(0.0, 2.0 * np.pi, 97)[:-1]
        ring = np.stack([np.cos(circle), np.sin(circle)], axis=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            outline(picture, centre + share * radius * ring, p.line, width=1)
        beam = np.array([math.cos(found.beam_angle_rad), math.sin(found.beam_angle_rad)])
        outline(
            picture,
            np.array([centre - radius * beam, centre + radius * beam]),
            p.dim,
            width=1,
            closed=False,
        )
        if top > 0.0:
            turn = np.stack([np.cos(found.theta), np.sin(found.theta)], axis=1)
            shape = centre + radius * (radiance / top)[:, None] * turn
            fill(picture, shape, p.accent, 0.35)
            outline(picture, shape, p.accent, width=px(2))
        self._photo = ImageTk.PhotoImage(Image.fromarray(picture), master=canvas)
        canvas.delete("all")
        canvas.configure(background=p.field)
        canvas.create_image(0, 0, image=self._photo, anchor="nw")
        tip = centre + 1.1 * radius * beam
        canvas.create_text(*tip, text="▸", fill=p.dim, font=self.ui.font("small"))
        self._say(found, row, col, radiance, total)

    def _say(
        self, found: Bounces, row: int, col: int, radiance: np.ndarray[Any, Any], total: float
    ) -> None:
        x, y = float(found.x[col]), float(found.y[row])
        if total <= 0.0:
            self.numbers_of.configure(text=f"x {x:.1f}  y {y:.1f} mm\nno light of this bounce")
            return
        to_beam = found.theta - found.beam_angle_rad
        cosine = float((radiance * np.cos(to_beam)).sum()) / total
        brightest = math.degrees(float(found.theta[radiance.argmax()]) - found.beam_angle_rad)
        brightest = (brightest + 180.0) % 360.0 - 180.0
        light = float(found.pictures[self.bounce - 1, row, col])
        self.numbers_of.configure(
            text=f"x {x:.1f}  y {y:.1f} mm\nlight {light:.4g} counts/s\n"
            f"radiance ≤ {float(radiance.max()):.3g} /rad\nmean cosine to the beam {cosine:.3f}\n"
            f"brightest {brightest:+.0f}° from the beam"
        )
