"""A pane that shows a picture: zoom at the pointer, pan, a read pixel, marks over it."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageTk

from labrig.gui.images import Map, Rgb, paint
from labrig.gui.style import Style
from labrig.gui.viewport import Viewport

ZOOM_STEP = 1.25


@dataclass
class Look:
    """How values become colours."""

    low: float = 0.0
    high: float = 1.0
    colours: Map = "cividis"
    root: bool = False
    white_level: int | None = None


@dataclass
class Linked:
    """Panes that zoom and pan as one."""

    panes: list[PicturePane] = field(default_factory=list)


class PicturePane(tk.Canvas):
    """One canvas, one image item kept for ever; the picture is cropped and resized first."""

    def __init__(
        self, parent: tk.Misc, style: Style, *, linked: Linked | None = None, name: str = ""
    ) -> None:
        super().__init__(
            parent, highlightthickness=1, borderwidth=0, takefocus=True, width=80, height=60
        )
        self.ui = style
        self.look = Look()
        self.view = Viewport(cols=1, rows=1)
        self.values: NDArray[Any] | None = None
        self.title = name
        self.read_at: tuple[int, int] | None = None
        self.on_paint: list[Callable[[Rgb], None]] = []
        self.on_marks: list[Callable[[], None]] = []
        self.on_read: Callable[[], None] = lambda: None
        self.painted: Rgb | None = None
        self.n_pasted = 0
        self._photo: ImageTk.PhotoImage | None = None
        self._item = self.create_image(0, 0, anchor="nw")
        self._drag: tuple[int, int] | None = None
        self._linked = linked
        if linked is not None:
            linked.panes.append(self)
        self._listen()
        self.recolour()

    def recolour(self) -> None:
        """Take the colours of the palette."""
        p = self.ui.palette
        self.configure(background=p.field, highlightbackground=p.field, highlightcolor=p.accent)
        self.refresh()

    def show(self, values: NDArray[Any] | None) -> None:
        """Show a picture (rows, cols); None shows nothing."""
        self.values = values
        if values is not None:
            self.view = self.view.of(values.shape[1], values.shape[0])
        self.refresh()

    def set_view(self, view: Viewport) -> None:
        """Show another part, in every linked pane."""
        for pane in self._linked.panes if self._linked else [self]:
            if pane.values is None:
                continue
            own = pane.view
            if pane is self:
                pane.view = view
            elif (own.cols, own.rows) == (view.cols, view.rows):
                pane.view = Viewport(
                    cols=own.cols,
                    rows=own.rows,
                    width=own.width,
                    height=own.height,
                    zoom=view.zoom,
                    left=view.left,
                    top=view.top,
                    fitted=view.fitted,
                )
            pane.refresh()

    def fit(self) -> None:
        """Show the whole picture."""
        self.set_view(self.view.fit())

    def read(self, col: int, row: int) -> None:
        """Read a pixel."""
        if self.values is None:
            return
        rows, cols = self.values.shape[:2]
        self.read_at = (min(max(col, 0), cols - 1), min(max(row, 0), rows - 1))
        self.marks()
        self.on_read()

    @property
    def value(self) -> float | int | None:
        """The value under the read pixel, as it is in the picture."""
        if self.values is None or self.read_at is None:
            return None
        found = self.values[self.read_at[1], self.read_at[0]]
        return int(found) if np.issubdtype(self.values.dtype, np.integer) else float(found)

    def refresh(self) -> None:
        """Paint the picture anew."""
        if self.values is None or min(self.view.width, self.view.height) < 4:
            self.itemconfigure(self._item, image="")
            self.painted = None
        else:
            look = self.look
            painted = paint(
                self.values,
                self.view,
                low=look.low,
                high=look.high,
                colours=look.colours,
                ground=self.ui.palette.field,
                root=look.root,
                white_level=look.white_level,
            )
            for draw in self.on_paint:
                draw(painted)
            self._paste(painted)
        self.marks()

    def _paste(self, painted: Rgb) -> None:
        size = (painted.shape[1], painted.shape[0])
        image = Image.fromarray(painted)
        if self._photo is None or (self._photo.width(), self._photo.height()) != size:
            self._photo = ImageTk.PhotoImage(image, master=self)
        else:
            self._photo.paste(image)
        self.itemconfigure(self._item, image=self._photo)
        self.painted = painted
        self.n_pasted += 1

    def marks(self) -> None:
        """Draw what lies over the picture anew: title, read pixel, and what others add."""
        self.delete("mark")
        if self.title:
            self.label(self.ui.px(8), self.ui.px(6), self.title)
        for draw in self.on_marks:
            draw()
        if self.read_at is not None and self.values is not None:
            x, y = self.view.to_pane(self.read_at[0] + 0.5, self.read_at[1] + 0.5)
            arm = self.ui.px(7)
            for width, colour in ((3, "#000000"), (1, "#ffffff")):
                self.create_line(x - arm, y, x + arm, y, width=width, fill=colour, tags="mark")
                self.create_line(x, y - arm, x, y + arm, width=width, fill=colour, tags="mark")

    def label(
        self, x: float, y: float, text: str, *, anchor: Any = "nw", font: str = "bold"
    ) -> None:
        """Write over the picture, on a ground of its own, so that it reads on any picture."""
        item = self.create_text(
            x, y, text=text, anchor=anchor, font=self.ui.font(font), fill="#ffffff", tags="mark"
        )
        left, top, right, bottom = self.bbox(item)
        pad = self.ui.px(3)
        under = self.create_rectangle(
            left - pad, top - 1, right + pad, bottom + 1, fill="#101418", outline="", tags="mark"
        )
        self.tag_lower(under, item)

    def _listen(self) -> None:
        self.bind("<Configure>", self._resized)
        self.bind("<ButtonPress-1>", self._press)
        self.bind("<B1-Motion>", self._dragged)
        self.bind("<Motion>", self._moved)
        self.bind("<Button-4>", lambda e: self._wheel(e, +1))
        self.bind("<Button-5>", lambda e: self._wheel(e, -1))
        self.bind("<MouseWheel>", lambda e: self._wheel(e, 1 if e.delta > 0 else -1))
        self.bind("<Double-Button-1>", lambda _e: self.fit())
        for key, dx, dy in (("Left", -1, 0), ("Right", 1, 0), ("Up", 0, -1), ("Down", 0, 1)):
            self.bind(f"<{key}>", self._by(self._walk, dx, dy))
            self.bind(f"<Shift-{key}>", self._by(self._walk, 10 * dx, 10 * dy))
            self.bind(f"<Control-{key}>", self._by(self._pan_by, dx, dy))
        for key in ("plus", "KP_Add", "equal"):
            self.bind(f"<{key}>", lambda _e: self._zoom(ZOOM_STEP))
        for key in ("minus", "KP_Subtract"):
            self.bind(f"<{key}>", lambda _e: self._zoom(1.0 / ZOOM_STEP))

    def _resized(self, event: tk.Event[Any]) -> None:
        size = (event.width - 2, event.height - 2)
        if size != (self.view.width, self.view.height):
            self.view = self.view.resized(*size)
            self.coords(self._item, 1, 1)
            self.refresh()

    def _press(self, event: tk.Event[Any]) -> None:
        self.focus_set()
        self._drag = (event.x, event.y)
        self._read_under(event)

    def _dragged(self, event: tk.Event[Any]) -> None:
        if self._drag is None or self.values is None:
            return
        dx, dy = event.x - self._drag[0], event.y - self._drag[1]
        self._drag = (event.x, event.y)
        self.set_view(self.view.panned(dx, dy))

    def _moved(self, event: tk.Event[Any]) -> None:
        self._read_under(event)

    def _read_under(self, event: tk.Event[Any]) -> None:
        at = self.view.pixel(event.x - 1, event.y - 1)
        if at is not None and self.values is not None:
            self.read(*at)

    def _wheel(self, event: tk.Event[Any], sign: int) -> None:
        if self.values is not None:
            factor = ZOOM_STEP if sign > 0 else 1.0 / ZOOM_STEP
            self.set_view(self.view.zoomed(factor, event.x - 1, event.y - 1))

    def _zoom(self, factor: float) -> str:
        if self.values is not None:
            x, y = 0.5 * self.view.width, 0.5 * self.view.height
            if self.read_at is not None:
                x, y = self.view.to_pane(self.read_at[0] + 0.5, self.read_at[1] + 0.5)
            self.set_view(self.view.zoomed(factor, x, y))
        return "break"

    @staticmethod
    def _by(act: Callable[[int, int], str], dx: int, dy: int) -> Callable[[object], str]:
        return lambda _event: act(dx, dy)

    def _walk(self, dx: int, dy: int) -> str:
        if self.values is not None:
            rows, cols = self.values.shape[:2]
            col, row = self.read_at or (cols // 2, rows // 2)
            self.read(col + dx, row + dy)
        return "break"

    def _pan_by(self, dx: int, dy: int) -> str:
        if self.values is not None:
            step = 0.1 * min(self.view.width, self.view.height)
            self.set_view(self.view.panned(-dx * step, -dy * step))
        return "break"
