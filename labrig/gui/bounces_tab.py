"""The bounces of a result: curves, pictures, another sigma_s at once, accuracy by its price."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from tkinter import ttk

import cv2
import numpy as np

from labrig.gui.curves import Chart, Curve
from labrig.gui.pane import Linked, PicturePane
from labrig.gui.plot import PlotPane
from labrig.gui.result_tabs import ResultTab
from labrig.gui.style import Style
from labrig.gui.widgets import Tip, toggle
from labrig.station.shown import Bounces, Price, Shown

FINER = 6  # pixels shown for each node, smooth between
LEAST, MOST = -4.0, -1.0  # powers of ten of the tolerance


def smooth(picture: np.ndarray, lit: tuple[int, int, int, int]) -> np.ndarray:
    """Return the lit part of a picture on nodes enlarged, linear between them."""
    picture = np.ascontiguousarray(picture[lit[0] : lit[1] + 1, lit[2] : lit[3] + 1])
    return np.asarray(cv2.resize(picture, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_LINEAR))


class BouncesTab(ResultTab):
    """Curves left, four pictures right; sliders below."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        reweight: Callable[[float], None],
        price: Callable[[float], None],
        pay: Callable[[float], None],
    ) -> None:
        super().__init__(parent, style, numbers=False)
        px = style.px
        self._reweight, self._price = reweight, price
        self.bounces: Bounces | None = None
        self.own: Bounces | None = None
        self.first = 1
        self._how = ""  # the price was made out
        self.each = tk.BooleanVar(self, value=True)
        self._sliders(pay)
        holder = ttk.Frame(self.figure, style="Card.TFrame")
        holder.pack(fill="both", expand=True)
        holder.columnconfigure((0, 1), weight=1, uniform="half")
        holder.rowconfigure(0, weight=1)
        self.plot = PlotPane(holder, style)
        self.plot.grid(row=0, column=0, sticky="nsew", padx=(0, px(3)))
        grid = ttk.Frame(holder, style="Card.TFrame")
        grid.grid(row=0, column=1, sticky="nsew")
        grid.columnconfigure((0, 1), weight=1, uniform="pane")
        grid.rowconfigure((0, 1), weight=1, uniform="pane")
        linked = Linked()
        self.panes = [PicturePane(grid, style, linked=linked) for _ in range(4)]
        for k, pane in enumerate(self.panes):
            pane.grid(row=k // 2, column=k % 2, sticky="nsew", padx=1, pady=1)

    def _sliders(self, pay: Callable[[float], None]) -> None:
        ui, px = self.ui, self.ui.px
        low = ttk.Frame(self.figure, style="Card.TFrame")
        low.pack(side="bottom", fill="x", pady=(px(5), 0))
        low.columnconfigure(1, weight=1)
        ttk.Label(low, text="σₛ", style="CardBold.TLabel").grid(row=0, column=0, sticky="w")
        self.sigma_s = ttk.Scale(low, from_=0.0, to=1.0, command=self._slid)
        self.sigma_s.grid(row=0, column=1, sticky="ew", padx=px(6))
        Tip(
            self.sigma_s,
            ui,
            "Weights every bounce for another scattering coefficient at once "
            "(Eq. 11); extinction and g stay. Left and Right move it",
        )
        self.sigma_words = ttk.Label(low, text="", style="Card.TLabel", width=34)
        self.sigma_words.grid(row=0, column=2, sticky="w")
        self.back = ttk.Button(low, text="As fitted", style="Tool.TButton", command=self._fitted)
        self.back.grid(row=0, column=3, sticky="e")
        ttk.Label(low, text="ε", style="CardBold.TLabel").grid(row=1, column=0, sticky="w")
        self.tolerance = ttk.Scale(low, from_=MOST, to=LEAST, value=-2.0, command=self._asked)
        self.tolerance.grid(row=1, column=1, sticky="ew", padx=px(6), pady=(px(3), 0))
        Tip(
            self.tolerance,
            ui,
            "What the bounces would cost to this relative error, before it is "
            "paid. Right is tighter",
        )
        self.price_words = ttk.Label(low, text="", style="Card.TLabel", width=34)
        self.price_words.grid(row=1, column=2, sticky="w")
        Tip(self.price_words, ui, lambda: self._how)
        self.pay = ttk.Button(
            low, text="Compute", style="Tool.TButton", command=lambda: pay(self.wanted)
        )
        self.pay.grid(row=1, column=3, sticky="ew", pady=(px(3), 0))
        for scale, step in ((self.sigma_s, 0.01), (self.tolerance, -0.25)):
            for key, sign in (("Left", -1), ("Right", +1)):
                scale.bind(f"<{key}>", self._stepping(scale, step * sign))
        self._choices()

    def _choices(self) -> None:
        ui, px = self.ui, self.ui.px
        top = ttk.Frame(self.figure, style="Card.TFrame")
        top.pack(fill="x", pady=(0, px(4)))
        ttk.Label(top, text="pictures from bounce", style="CardDim.TLabel").pack(side="left")
        self.from_ = ttk.Spinbox(
            top, from_=1, to=9, width=3, command=self._moved, font=ui.font(), state="readonly"
        )
        self.from_.set(1)
        self.from_.pack(side="left", padx=px(6))
        toggle(
            top,
            ui,
            "each to its own maximum",
            "",
            self.each,
            self._redraw,
            "Else all pictures share one scale",
        ).pack(side="left")

    @property
    def wanted(self) -> float:
        """The tolerance that the slider stands at."""
        return float(10.0 ** float(self.tolerance.get()))

    def draw(self, shown: Shown) -> None:
        """Show a result's bounces, as fitted."""
        if shown.bounces is None:
            self.say("This analysis stopped after the separation: there are no bounces.")
            return
        if self.own is not shown.bounces:
            self.take(shown.bounces)
            self._asked(None)
        else:
            self._redraw()

    def take(self, own: Bounces) -> None:
        """Show bounces that were found or solved anew."""
        self.own = self.bounces = own
        self.sigma_s.configure(to=own.sigma_t)
        self.sigma_s.set(own.sigma_s)
        self.from_.configure(to=max(own.pictures.shape[0] - 3, 1))
        self._redraw()

    def show_weighted(self, bounces: Bounces) -> None:
        """Show the bounces of another sigma_s."""
        self.bounces = bounces
        self._redraw()

    def say_prices(self, prices: list[Price]) -> None:
        """Say what the tolerance would take."""
        price = min(prices, key=lambda p: abs(np.log(p.tolerance / self.wanted)))
        self.price_words.configure(
            text=f"{100 * price.tolerance:.2g} %: {price.seconds:.2g} s, "
            f"{1e3 * price.gigabytes:.3g} MB"
        )
        self._how = f"{price.engine}, {price.grid}"

    def _stepping(self, scale: ttk.Scale, share: float) -> Callable[[object], str]:
        return lambda _event: self._key(scale, share)

    def _key(self, scale: ttk.Scale, share: float) -> str:
        low, high = float(scale.cget("from")), float(scale.cget("to"))
        step = share * (high - low) if scale is self.sigma_s else share
        value = float(scale.get()) + step
        scale.set(min(max(value, min(low, high)), max(low, high)))
        return "break"

    def _slid(self, value: str) -> None:
        if self.own is not None and abs(float(value) - self.own.sigma_s) >= 0.0:
            self._say_sigma(float(value))
            if self.bounces is None or float(value) != self.bounces.sigma_s:
                self._reweight(float(value))

    def _fitted(self) -> None:
        if self.own is not None:
            self.sigma_s.set(self.own.sigma_s)

    def _asked(self, _value: str | None) -> None:
        self.price_words.configure(text=f"{100 * self.wanted:.2g} %: asking for the price …")
        self._price(self.wanted)

    def _moved(self) -> None:
        self.first = int(self.from_.get())
        self._redraw()

    def _say_sigma(self, value: float) -> None:
        own = self.own
        if own is None:
            return
        how = "as fitted" if value == own.sigma_s else f"fitted {own.sigma_s:.4f}"
        self.sigma_words.configure(text=f"{value:.4f} /mm, albedo {value / own.sigma_t:.2f}; {how}")

    def _redraw(self) -> None:
        found = self.bounces
        if found is None:
            return
        self._say_sigma(found.sigma_s)
        p = self.ui.palette
        curves = [
            Curve(x=found.depth, y=line, look=look, name=f"bounce {k}")
            for k, (line, look) in enumerate(zip(found.curves, p.curves, strict=False), start=1)
        ]
        curves.append(
            Curve(
                x=found.depth,
                y=found.curves.sum(axis=0),
                look=(p.text, (), ""),
                name="all",
                width=1.5,
            )
        )
        shown = self.shown
        if shown is not None and shown.white.size:
            curves.append(
                Curve(
                    x=shown.white_depth,
                    y=shown.white,
                    look=(p.text, (), "o"),
                    points=True,
                    name="measured, white",
                )
            )
        deepest = min(8.0 / found.sigma_t, float(found.depth[-1]))
        self.plot.show(
            Chart(
                curves=tuple(curves),
                x_label="depth along the beam (mm)",
                y_label="light (counts/s)",
                x_range=(0.0, deepest),
            )
        )
        self._pictures(found)

    def _pictures(self, found: Bounces) -> None:
        last = found.pictures.shape[0]
        chosen = [k for k in range(self.first, self.first + 4) if k <= last]
        tops = [float(np.quantile(found.pictures[k - 1], 0.999)) for k in chosen]
        for pane, k, top in zip(self.panes, chosen, tops, strict=False):
            own = found.error_estimate
            sure = "" if own is None else f"  ±{100 * own[k - 1]:.1g} %"
            share = found.curves[k - 1].sum() / max(float(found.curves.sum()), 1e-30)
            pane.title = f"bounce {k}  {100 * share:.2g} %{sure}"
            pane.look.high = max(top if self.each.get() else max(tops), 1e-30)
            pane.recolour()
            pane.show(smooth(found.pictures[k - 1], found.lit))
        for pane in self.panes[len(chosen) :]:
            pane.title = ""
            pane.show(None)
