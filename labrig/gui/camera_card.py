"""The controls at the right: histogram, exposure with what the camera took, focus."""

from __future__ import annotations

import tkinter as tk
from collections import deque
from collections.abc import Callable
from tkinter import ttk

from PIL import Image, ImageTk

from labrig.gui.images import histogram_bars
from labrig.gui.style import Style
from labrig.gui.widgets import Card, NumberField, Tip, by_steps, number
from labrig.station.door import Applied, Connected
from labrig.station.meters import Meter, Roi


class HistogramCard(Card):
    """Raw counts, their height logarithmic; the shares that clip and that are dark."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style, "Histogram (raw counts, log)")
        self._style = style
        self.canvas = tk.Canvas(
            self.body, height=style.px(26), width=style.px(180), highlightthickness=0
        )
        self.canvas.pack(fill="both", expand=True)
        self._item = self.canvas.create_image(0, 0, anchor="nw")
        self._photo: ImageTk.PhotoImage | None = None
        self.words = ttk.Label(self.body, text="no picture yet", style="CardMono.TLabel")
        self.words.pack(anchor="w", pady=(style.px(3), 0))
        self.meter: Meter | None = None

    def show(self, meter: Meter | None) -> None:
        """Show the readings of a picture."""
        self.meter = meter
        p = self._style.palette
        self.canvas.configure(background=p.field)
        width, height = self.canvas.winfo_width(), self.canvas.winfo_height()
        if meter is None or width < 10 or height < 10:
            return
        bars = histogram_bars(
            meter.histogram, width, height, colour=p.accent, ground=p.field, limit=p.bad
        )
        image = Image.fromarray(bars)
        if self._photo is None or (self._photo.width(), self._photo.height()) != (width, height):
            self._photo = ImageTk.PhotoImage(image, master=self.canvas)
            self.canvas.itemconfigure(self._item, image=self._photo)
        else:
            self._photo.paste(image)
        clipped = meter.saturated > 0.0005
        self.words.configure(
            text=f"{'!' if clipped else ' '}sat {100 * meter.saturated:4.1f} %  "
            f"dark {100 * meter.dark:4.1f} %",
            style="CardBad.TLabel" if clipped else "CardMono.TLabel",
            font=self._style.font("mono"),
        )


class CameraCard(Card):
    """Exposure and gain as the camera reports them, automatic exposure, the region read."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        expose: Callable[[float, float], None],
        auto: Callable[[], None],
        roi: Callable[[Roi | None], None],
    ) -> None:
        super().__init__(parent, style, "Camera")
        px = style.px
        self._expose, self._roi = expose, roi
        self._applied: Applied | None = None
        self.exposure = NumberField(
            self.body,
            style,
            label="Exposure",
            unit="ms",
            commit=self._exposure_typed,
            step=by_steps,
        )
        self.gain = NumberField(
            self.body,
            style,
            label="Gain",
            unit="dB",
            commit=self._gain_typed,
        )
        self.region = NumberField(
            self.body,
            style,
            label="ROI",
            unit="px",
            commit=self._roi_typed,
        )
        for field in (self.exposure, self.gain, self.region):
            field.pack(fill="x", pady=px(1))
        Tip(self.exposure.entry, style, self._about_exposure)
        Tip(self.gain.entry, style, lambda: self._gain_why)
        Tip(
            self.region.entry,
            style,
            "x y width height of what is read; empty: everything. R draws it with the mouse",
        )
        self._gain_why = ""
        self._automatic(style, auto)

    def _automatic(self, style: Style, auto: Callable[[], None]) -> None:
        row = ttk.Frame(self.body, style="Card.TFrame")
        row.pack(fill="x", pady=(style.px(3), 0))
        self.auto = ttk.Button(row, text="Auto expose  A", style="Tool.TButton", command=auto)
        self.auto.pack(side="left")
        self.continuous = tk.BooleanVar(self, value=False)
        self.always = ttk.Checkbutton(row, text="continuous", variable=self.continuous)
        self.always.pack(side="right")

    def connected(self, rig: Connected | None) -> None:
        """Enable what the camera has; say why where it has not."""
        fixed = rig is None or rig.gain_range_db[0] == rig.gain_range_db[1]
        self._gain_why = (
            "no camera is connected"
            if rig is None
            else "the gain of this camera is fixed"
            if fixed
            else f"{rig.gain_range_db[0]:g} .. {rig.gain_range_db[1]:g} dB"
        )
        self.gain.enable(on=not fixed)
        self.enable(on=rig is not None)

    def enable(self, *, on: bool) -> None:
        """Let settings be changed, or not while a run has the camera."""
        self.exposure.enable(on=on)
        self.region.enable(on=on)
        for button in (self.auto, self.always):
            button.state(["!disabled" if on else "disabled"])

    def applied(self, applied: Applied) -> None:
        """Show what the camera took."""
        self._applied = applied
        self.exposure.hold(f"{1e3 * applied.exposure_s:.5g}")
        self.gain.hold(f"{applied.gain_db:g}")
        if applied.why:
            self.exposure.refuse()

    def show_roi(self, roi: Roi | None) -> None:
        """Show the region that is read."""
        self.region.hold("" if roi is None else " ".join(str(n) for n in roi))

    def _about_exposure(self) -> str:
        a = self._applied
        if a is None:
            return "Return sets it; Up and Down change it by a tenth"
        if abs(a.exposure_s - a.asked_exposure_s) > 1e-3 * a.asked_exposure_s:
            return f"asked {1e3 * a.asked_exposure_s:g} ms; the camera took {1e3 * a.exposure_s:g}"
        return "as the camera reports it; Return sets it, Up and Down change it by a tenth"

    def _exposure_typed(self, text: str) -> None:
        try:
            wanted = number(text) / 1e3
        except ValueError:
            self.exposure.refuse()
            return
        self._expose(wanted, self._applied.gain_db if self._applied else 0.0)

    def _gain_typed(self, text: str) -> None:
        try:
            wanted = number(text)
        except ValueError:
            self.gain.refuse()
            return
        if self._applied is not None:
            self._expose(self._applied.exposure_s, wanted)

    def _roi_typed(self, text: str) -> None:
        parts = text.replace(",", " ").split()
        if not parts:
            self._roi(None)
            return
        try:
            x, y, width, height = (int(part) for part in parts)
        except ValueError:
            self.region.refuse()
            return
        if min(x, y) < 0 or min(width, height) < 8:
            self.region.refuse()
            return
        self._roi((x, y, width, height))


class FocusCard(Card):
    """How sharp the picture is, against the sharpest since the last reset."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style, "")
        self._style = style
        row = ttk.Frame(self.body, style="Card.TFrame")
        row.pack(fill="x")
        ttk.Label(row, text="FOCUS", style="Head.TLabel").pack(side="left")
        self.words = ttk.Label(row, text="", style="CardSmall.TLabel")
        self.words.pack(side="left", padx=style.px(8))
        self.reset = ttk.Button(row, text="Reset", style="Tool.TButton", command=self.reset_best)
        self.reset.pack(side="right")
        Tip(self.reset, style, "Forget the sharpest picture seen")
        self.canvas = tk.Canvas(
            self.body, height=style.px(14), width=style.px(180), highlightthickness=0
        )
        self.canvas.pack(fill="x", pady=(style.px(3), 0))
        self._kept: deque[float] = deque(maxlen=120)
        self.best, self.readings = 0.0, 0

    @property
    def share(self) -> float:
        """The last reading as a share of the best."""
        return self._kept[-1] / self.best if self._kept and self.best > 0.0 else 0.0

    def reset_best(self) -> None:
        """Begin anew."""
        self._kept.clear()
        self.best, self.readings = 0.0, 0

    def read(self, value: float) -> None:
        """Take a reading."""
        self._kept.append(value)
        self.readings += 1
        self.best = max(self.best, value)
        self.show()

    def show(self) -> None:
        """Draw the last readings under the line of the best one."""
        p, canvas = self._style.palette, self.canvas
        width, height = canvas.winfo_width(), canvas.winfo_height()
        canvas.configure(background=p.field)
        canvas.delete("all")
        if not self._kept or width < 10:
            return
        self.words.configure(text=f"{100 * self.share:3.0f} % of best")
        base, top = height - 2, self._style.px(4)
        points = [
            (width * k / 120, base - (base - top) * v / max(self.best, 1e-30))
            for k, v in enumerate(self._kept)
        ]
        canvas.create_line(0, top, width, top, fill=p.ok, width=self._style.px(1), dash=(4, 3))
        if len(points) > 1:
            canvas.create_line(*points, fill=p.accent, width=self._style.px(2))
