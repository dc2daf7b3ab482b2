"""The live picture: what the camera sends, newest first, and everything that is said of it."""

from __future__ import annotations

import time
import tkinter as tk
from collections import deque
from collections.abc import Callable
from tkinter import ttk
from typing import Any

from labrig.gui.drawer import Drawer
from labrig.gui.images import Map
from labrig.gui.pane import PicturePane
from labrig.gui.style import Style
from labrig.gui.widgets import toggle, tool
from labrig.station.door import Connected, Newest, Picture
from labrig.station.meters import Roi

BAR_MM = (1, 2, 5, 10, 20, 50, 100, 200)


class Rates:
    """How many frames a second came and were shown, over the last two seconds."""

    def __init__(self) -> None:
        self._came: deque[tuple[float, int]] = deque(maxlen=240)
        self._shown: deque[float] = deque(maxlen=120)
        self._ages: deque[float] = deque(maxlen=60)

    def shown(self, now_s: float, came: int, age_s: float) -> None:
        """Count a picture that was shown; ``came`` is how many ever came."""
        self._shown.append(now_s)
        self._came.append((now_s, came))
        self._ages.append(age_s)

    def at(self, now_s: float) -> tuple[float, float, float]:
        """Return camera fps, shown fps, and the age of what is shown, s."""
        while len(self._came) > 2 and now_s - self._came[0][0] > 2.0:
            self._came.popleft()
        shown = [t for t in self._shown if now_s - t <= 2.0]
        if len(self._came) < 2 or len(shown) < 2:
            return 0.0, 0.0, 0.0
        (first, n_first), (last, n_last) = self._came[0], self._came[-1]
        camera = (n_last - n_first) / max(last - first, 1e-3)
        return camera, (len(shown) - 1) / max(shown[-1] - shown[0], 1e-3), self._ages[-1]


class LiveTab(ttk.Frame):
    """The picture with its tools above, its readings below, and a drawer."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        hold: Callable[[bool], None],
        snap: Callable[[], None],
        roi: Callable[[Roi | None], None],
        colours: Callable[[Map], None],
        drawer: Callable[[str], None],
        run: Callable[[str], None],
    ) -> None:
        super().__init__(parent, style="Card.TFrame", padding=style.px(4))
        self.ui = style
        self.rig: Connected | None = None
        self.picture: Picture | None = None
        self.rates = Rates()
        self._hold, self._set_roi, self._set_drawer = hold, roi, drawer
        self.paused = tk.BooleanVar(self, value=False)
        self.zebra = tk.BooleanVar(self, value=True)
        self.root_scale = tk.BooleanVar(self, value=False)
        self.drawing_roi = tk.BooleanVar(self, value=False)
        self.profile = tk.BooleanVar(self, value=False)
        self.decomposing = tk.BooleanVar(self, value=False)
        self.roi: Roi | None = None
        self._corner: tuple[int, int] | None = None
        self._tools(snap, colours)
        self.readings = self._readings()
        self.drawer = Drawer(self, style, run)
        self.pane = PicturePane(self, style)
        self.pane.pack(fill="both", expand=True)
        self.pane.on_marks.append(self._marks)
        self.pane.on_read = self._read
        self.pane.bind("<ButtonPress-1>", self._press, add="+")
        self.pane.bind("<B1-Motion>", self._drag, add="+")
        self.pane.bind("<ButtonRelease-1>", self._release, add="+")
        self.why_empty = "connecting"
        self._empty = self.pane.create_text(0, 0, text="", tags="why")
        self.pane.bind("<Configure>", lambda _e: self._explain(), add="+")

    def _tools(self, snap: Callable[[], None], colours: Callable[[Map], None]) -> None:
        ui, px = self.ui, self.ui.px
        bar = ttk.Frame(self, style="Card.TFrame")
        bar.pack(fill="x", pady=(0, px(4)))
        self._colour_box(bar, colours)

        def press(text: str, key: str, act: Callable[[], None], tip: str) -> ttk.Widget:
            return tool(bar, ui, text, key, act, tip)

        def turn(
            text: str, key: str, of: tk.BooleanVar, act: Callable[[], None], tip: str
        ) -> ttk.Widget:
            return toggle(bar, ui, text, key, of, act, tip)

        clipped = "Hatch pixels whose raw counts are at the white level"
        weak = "A square-root scale shows the weak light beside the beam; its ends stay fixed"
        self.tools = {
            "pause": turn("❚❚", "Space", self.paused, self._pause, "Hold the live picture"),
            "snap": press("Snap", "S", snap, "Keep this frame as a 16-bit TIFF"),
            "fit": press("Fit", "0", lambda: self.pane.fit(), "The whole picture"),
            "one": press("1:1", "1", self.one, "A pixel of the camera on one of the screen"),
            "zebra": turn("Zebra", "Z", self.zebra, self.refresh, clipped),
            "root": turn("√", "V", self.root_scale, self.refresh, weak),
            "roi": turn(
                "ROI",
                "R",
                self.drawing_roi,
                self._roi_toggled,
                "Draw what histogram and focus look at",
            ),
            "profile": turn(
                "Profile",
                "P",
                self.profile,
                lambda: self._open("profile", self.profile),
                "Light along the beam, before any capture",
            ),
            "fit live": turn(
                "Live fit",
                "D",
                self.decomposing,
                lambda: self._open("decomposition", self.decomposing),
                "Separate and fit every new set of cycling stripes",
            ),
        }
        for widget in self.tools.values():
            widget.pack(side="left", padx=(0, px(1)))

    def _colour_box(self, bar: ttk.Frame, colours: Callable[[Map], None]) -> None:
        self.map = tk.StringVar(self, value="cividis")
        box = ttk.Combobox(
            bar,
            textvariable=self.map,
            values=["cividis", "grey"],
            state="readonly",
            width=6,
            font=self.ui.font(),
        )
        box.pack(side="right")
        box.bind("<<ComboboxSelected>>", lambda _e: colours(self.map.get()))  # type: ignore[arg-type]

    def _readings(self) -> tuple[ttk.Label, ttk.Label]:
        px = self.ui.px
        row = ttk.Frame(self, style="Card.TFrame")
        row.pack(side="bottom", fill="x", pady=(px(3), 0))
        rates = ttk.Label(row, text="", style="CardSmall.TLabel")
        rates.pack(side="right")
        pixel = ttk.Label(row, text="", style="CardMono.TLabel")
        pixel.pack(side="left")
        return pixel, rates

    # What is shown.

    def connected(self, rig: Connected | None, why: str = "") -> None:
        """Take a rig's white level, region and scale; None: say why nothing is shown."""
        self.rig = rig
        self.why_empty = why
        if rig is not None:
            self.pane.look.high = float(rig.white_level)
            self.pane.look.low = 0.0
        else:
            self.picture = None
            self.pane.show(None)
            self.rates = Rates()
            self._read()
        self._explain()

    def take(self, box: Newest[Picture], *, visible: bool) -> Picture | None:
        """Take the newest picture, if there is one, and show it; return it."""
        picture = box.take()
        if picture is None or self.rig is None:  # one may come after the rig was lost
            return None
        self.picture = picture
        if visible:
            if self.why_empty:
                self.why_empty = ""
                self._explain()
            self.refresh()
        now = time.monotonic()
        self.rates.shown(now, box.put_in, now - picture.taken_s)
        return picture

    def refresh(self) -> None:
        """Paint the newest picture."""
        if self.picture is None or self.rig is None:
            return
        self.pane.look.white_level = self.rig.white_level if self.zebra.get() else None
        self.pane.look.root = self.root_scale.get()
        self.pane.show(self.picture.pixels)
        self._read()

    def say_rates(self, dropped: int) -> None:
        """Write how fast it goes, and how old what is shown is."""
        if self.rig is None:
            self.readings[1].configure(text="no camera")
            return
        camera, shown, age_s = self.rates.at(time.monotonic())
        held = "held · " if self.paused.get() else ""
        self.readings[1].configure(
            text=f"{held}cam {camera:.0f} · shown {shown:.0f} fps · {1e3 * age_s:.0f} ms old · "
            f"{dropped} dropped · {100 * self.pane.view.zoom:.0f} %"
        )

    def set_map(self, name: Map) -> None:
        """Show in other colours."""
        self.map.set(name)
        self.pane.look.colours = name
        self.pane.refresh()

    def set_roi(self, roi: Roi | None) -> None:
        """Show what is read."""
        self.roi = roi
        self.pane.marks()

    def recolour(self) -> None:
        """Take the colours of the palette."""
        self.pane.recolour()
        self.drawer.recolour()
        self._explain()

    def one(self) -> None:
        """Show a pixel of the camera on one of the screen."""
        if self.pane.values is not None:
            self.pane.set_view(self.pane.view.at(1.0))

    # How it is done.

    def _pause(self) -> None:
        self._hold(self.paused.get())

    def _open(self, what: str, of: tk.BooleanVar) -> None:
        for name, other in (("profile", self.profile), ("decomposition", self.decomposing)):
            if name != what:
                other.set(False)
        self._set_drawer(what if of.get() else "")

    def _roi_toggled(self) -> None:
        if self.drawing_roi.get():
            self.pane.focus_set()
            self.pane.configure(cursor="crosshair")
        else:
            self.pane.configure(cursor="")
            self._set_roi(None)

    def _press(self, event: tk.Event[Any]) -> None:
        if self.drawing_roi.get() and self.pane.values is not None:
            self._corner = self.pane.view.pixel(event.x - 1, event.y - 1)

    def _drag(self, event: tk.Event[Any]) -> None:
        if self._corner is None:
            return
        at = self.pane.view.pixel(event.x - 1, event.y - 1)
        if at is not None:
            (x0, y0), (x1, y1) = self._corner, at
            self.roi = (min(x0, x1), min(y0, y1), abs(x1 - x0) + 1, abs(y1 - y0) + 1)
            self.pane.marks()

    def _release(self, _event: object) -> None:
        corner, self._corner = self._corner, None
        if corner is not None and self.roi is not None and min(self.roi[2:]) >= 8:
            self._set_roi(self.roi)

    def _read(self) -> None:
        pane = self.pane
        if pane.read_at is None or pane.value is None or self.rig is None:
            self.readings[0].configure(text="point at a pixel")
            return
        col, row = pane.read_at
        counts = int(pane.value)  # numpy's 16 bits would overflow
        share = 100.0 * counts / self.rig.white_level
        self.readings[0].configure(text=f"x {col:4d} y {row:4d} {counts:5d} DN {share:5.1f} %")

    def _explain(self) -> None:
        pane, p = self.pane, self.ui.palette
        pane.coords(self._empty, pane.winfo_width() / 2, pane.winfo_height() / 2)
        pane.itemconfigure(
            self._empty,
            text=self.why_empty,
            fill=p.dim,
            font=self.ui.font("title"),
            width=max(pane.winfo_width() - self.ui.px(60), 100),
            justify="center",
        )

    def _marks(self) -> None:
        rig, pane = self.rig, self.pane
        if rig is None or pane.values is None:
            return
        view, px = pane.view, self.ui.px
        if rig.region_px is not None:
            x, y, width, height = rig.region_px
            left, top = view.to_pane(x, y)
            right, bottom = view.to_pane(x + width, y + height)
            pane.create_rectangle(
                left, top, right, bottom, outline="#e8edf2", dash=(2, 4), tags="mark"
            )
            if rig.beam_rows_px is not None and rig.lit_side in ("left", "right"):
                face = left if rig.lit_side == "left" else right
                rows = [view.to_pane(0.0, row)[1] for row in rig.beam_rows_px]
                pane.create_line(
                    face, rows[0], face, rows[1], fill="#56B4E9", width=px(3), tags="mark"
                )
                middle = 0.5 * (rows[0] + rows[1])
                pane.create_line(
                    left, middle, right, middle, fill="#56B4E9", dash=(8, 6), tags="mark"
                )
        if self.roi is not None:
            x, y, width, height = self.roi
            corner, far = view.to_pane(x, y), view.to_pane(x + width, y + height)
            pane.create_rectangle(*corner, *far, outline="#F0E442", width=px(2), tags="mark")
        if rig.mm_per_px:
            self._scale_bar(rig.mm_per_px)
        if self.picture is not None:
            shows = f"{self.picture.shows}{', √ scale' if pane.look.root else ''}"
            pane.label(pane.winfo_width() - px(10), px(6), shows, anchor="ne", font="small")

    def _scale_bar(self, mm_per_px: float) -> None:
        pane, px = self.pane, self.ui.px
        per_mm = pane.view.zoom / mm_per_px
        length = next((mm for mm in BAR_MM if mm * per_mm > px(60)), BAR_MM[-1])
        right, y = pane.winfo_width() - px(14), pane.winfo_height() - px(14)
        left = right - length * per_mm
        pad = px(4)
        pane.create_rectangle(
            left - pad, y - pad, right + pad, y + pad, fill="#101418", outline="", tags="mark"
        )
        pane.create_line(left, y, right, y, fill="#ffffff", width=px(3), tags="mark")
        pane.label((left + right) / 2, y - px(5), f"{length} mm", anchor="s", font="small")
