"""Tabs of a result: separation, attenuation, and the report with its export."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from tkinter import ttk
from typing import Any

import numpy as np

from labrig.gui.curves import Chart, Curve
from labrig.gui.pane import Linked, PicturePane
from labrig.gui.plot import PlotPane
from labrig.gui.style import Style
from labrig.gui.table import Numbers
from labrig.gui.widgets import Tip, toggle, tool
from labrig.station.shown import Decay, Shown

NUMBERS_PX = 220


class ResultTab(ttk.Frame):
    """What all tabs of a result share: a figure left, numbers right, or words why there is none."""

    def __init__(self, parent: tk.Misc, style: Style, *, numbers: bool = True) -> None:
        super().__init__(parent, style="Card.TFrame", padding=style.px(4))
        self.ui = style
        self.shown: Shown | None = None
        self.why = ttk.Label(
            self,
            text="No result yet. F5 captures; the analysis then starts by itself.",
            style="CardDim.TLabel",
            anchor="center",
            justify="center",
            wraplength=style.px(460),
        )
        self.why.place(relx=0.5, rely=0.45, anchor="center")
        self.figure = ttk.Frame(self, style="Card.TFrame")
        self.numbers: Numbers | None = None
        if numbers:
            side = ttk.Frame(self.figure, style="Card.TFrame", width=style.px(NUMBERS_PX))
            side.pack_propagate(False)
            side.pack(side="right", fill="y", padx=(style.px(4), 0))
            self.numbers = Numbers(side, style)
            self.numbers.pack(fill="both", expand=True)

    def say(self, text: str) -> None:
        """Say why there is nothing, or what is being done."""
        self.figure.pack_forget()
        self.why.configure(text=text)

    def show(self, shown: Shown) -> None:
        """Show a result."""
        self.shown = shown
        if self.numbers is not None:
            self.numbers.show(shown)
        self.figure.pack(fill="both", expand=True)
        self.figure.lift()
        self.draw(shown)

    def draw(self, shown: Shown) -> None:
        """Draw a result; each tab does it in its way."""
        raise NotImplementedError

    def recolour(self) -> None:
        """Take the colours of the palette."""
        if self.numbers is not None:
            self.numbers.recolour()
        if self.shown is not None:
            self.draw(self.shown)


class SeparationTab(ResultTab):
    """Captured, single and multiple on one scale, zoomed together (Fig. 10)."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style)
        px = style.px
        bar = ttk.Frame(self.figure, style="Card.TFrame")
        bar.pack(fill="x", pady=(0, px(4)))
        self.root = tk.BooleanVar(self, value=True)
        tool(bar, style, "Fit", "0", self.fit).pack(side="left", padx=(0, px(4)))
        toggle(
            bar,
            style,
            "√ scale",
            "",
            self.root,
            self._rescale,
            "A square-root scale shows the weak light beside the beam",
        ).pack(side="left")
        self.words = ttk.Label(bar, text="", style="CardMono.TLabel")
        self.words.pack(side="right")
        self.linked = Linked()
        holder = ttk.Frame(self.figure, style="Card.TFrame")
        holder.pack(fill="both", expand=True)
        self.panes = [
            PicturePane(holder, style, linked=self.linked, name=name)
            for name in ("captured, one shift", "single", "multiple")
        ]
        holder.rowconfigure((0, 1), weight=1, uniform="row")
        holder.columnconfigure((0, 1), weight=1, uniform="column")
        for k, pane in enumerate(self.panes):
            pane.grid(row=k // 2, column=k % 2, sticky="nsew", padx=1, pady=1)
            pane.on_read = lambda pane=pane: self._read(pane)  # type: ignore[misc]
        self.profile = PlotPane(holder, style)
        self.profile.grid(row=1, column=1, sticky="nsew", padx=1, pady=1)

    def fit(self) -> None:
        """Show the whole pictures."""
        self.panes[0].fit()

    def draw(self, shown: Shown) -> None:
        """Show the three pictures."""
        pictures = (shown.captured, shown.single, shown.multiple)
        tops = [float(np.nanquantile(picture[::4, ::4], 0.999)) for picture in pictures]
        for pane, picture in zip(self.panes, pictures, strict=True):
            pane.look.low, pane.look.high = 0.0, max(*tops, 1e-9)
            pane.look.root = self.root.get()
            pane.recolour()
            pane.show(picture)
        self._draw_row(shown, shown.captured.shape[0] // 2)

    def _rescale(self) -> None:
        if self.shown is not None:
            self.draw(self.shown)

    def _read(self, pane: PicturePane) -> None:
        shown = self.shown
        if shown is None or pane.read_at is None:
            return
        col, row = pane.read_at
        x = shown.extent.left + (col + 0.5) / shown.captured.shape[1] * (
            shown.extent.right - shown.extent.left
        )
        values = [
            float(picture[row, col]) for picture in (shown.captured, shown.single, shown.multiple)
        ]
        self.words.configure(
            text=f"{x:6.1f} {shown.unit}  captured {values[0]:.4g}  single {values[1]:.4g}  "
            f"multiple {values[2]:.4g} /s"
        )
        for other in self.panes:
            if other is not pane:
                other.read_at = pane.read_at
                other.marks()
        self._draw_row(shown, row)

    def _draw_row(self, shown: Shown, row: int) -> None:
        looks = self.ui.palette.curves
        x = np.linspace(shown.extent.left, shown.extent.right, shown.single.shape[1])
        self.profile.show(
            Chart(
                curves=tuple(
                    Curve(
                        x=x,
                        y=picture[row].astype(np.float64),
                        look=(look[0], look[1], ""),
                        name=name,
                    )
                    for picture, look, name in (
                        (shown.captured, looks[4], "captured"),
                        (shown.single, looks[0], "single"),
                        (shown.multiple, looks[1], "multiple"),
                    )
                ),
                x_label=f"depth x ({shown.unit})",
                y_label=f"row {row}, counts/s",
            )
        )


class AttenuationTab(ResultTab):
    """Light against depth with and without separation, each with its exponential (Fig. 11)."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style)
        holder = ttk.Frame(self.figure, style="Card.TFrame")
        holder.pack(fill="both", expand=True)
        holder.rowconfigure(0, weight=3, uniform="row")
        holder.rowconfigure(1, weight=2, uniform="row")
        holder.columnconfigure(0, weight=1)
        self.light, self.misfit = PlotPane(holder, style), PlotPane(holder, style)
        self.light.grid(row=0, column=0, sticky="nsew")
        self.misfit.grid(row=1, column=0, sticky="nsew")

    def draw(self, shown: Shown) -> None:
        """Show the decays and what the exponentials leave."""
        if not shown.decays:
            self.say("This analysis stopped after the separation: there is no decay to show.")
            return
        looks, p = self.ui.palette.curves, self.ui.palette
        curves, rests = [], []
        deepest = max(d.fitted[1] for d in shown.decays)
        for k, decay in enumerate(shown.decays):
            of = looks[(4, 1)[k % 2]]
            curves.append(
                Curve(
                    x=decay.depth,
                    y=decay.value,
                    look=(of[0], (), of[2]),
                    points=True,
                    name=f"{decay.title}, measured",
                )
            )
            if decay.sigma_t:
                dashes = () if k or len(shown.decays) == 1 else looks[1][1]
                curves.append(
                    Curve(
                        x=decay.depth,
                        y=decay.fit,
                        look=(p.text, dashes, ""),
                        name=f"its exponential, σₜ = {decay.sigma_t} /{shown.unit}",
                    )
                )
                rests.append(self._rest(decay, (of[0], (), "")))
        self.light.show(
            Chart(
                curves=tuple(curves),
                log=True,
                x_range=(0.0, 1.3 * deepest),
                y_label="light (counts/s)",
                x_label="",
            )
        )
        self._draw_misfit(rests, 1.3 * deepest, shown.unit)

    def _draw_misfit(self, rests: list[Curve], reach: float, unit: str) -> None:
        p = self.ui.palette
        zero = Curve(
            x=np.array([0.0, reach]), y=np.zeros(2), look=(p.dim, (4.0, 4.0), ""), width=1.0
        )
        self.misfit.show(
            Chart(
                curves=(zero, *rests),
                x_range=(0.0, reach),
                y_range=self._reach(rests),
                y_label="measured less exponential, % of it",
                x_label=f"depth along the beam ({unit})",
            )
        )

    @staticmethod
    def _rest(decay: Decay, look: Any) -> Curve:
        inside = (decay.depth >= decay.fitted[0]) & (decay.depth <= decay.fitted[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            rest = 100.0 * (decay.value / decay.fit - 1.0)
            std = 100.0 * decay.std / decay.fit
        return Curve(
            x=decay.depth[inside],
            y=rest[inside],
            std=std[inside],
            look=look,
            name=decay.title,
            width=1.5,
        )

    @staticmethod
    def _reach(rests: list[Curve]) -> tuple[float, float]:
        values = np.concatenate([np.abs(c.y[np.isfinite(c.y)]) for c in rests] or [np.ones(1)])
        top = 1.15 * float(values.max()) if values.size else 1.0
        return -top, top


class ReportTab(ResultTab):
    """Every number with its uncertainty, every warning, and the export."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        export: Callable[[tuple[str, ...]], None],
        page: Callable[[], None],
    ) -> None:
        super().__init__(parent, style, numbers=False)
        px = style.px
        bar = ttk.Frame(self.figure, style="Card.TFrame")
        bar.pack(fill="x", pady=(0, px(4)))
        self.kinds: dict[str, tk.BooleanVar] = {}
        for kind, name in (("png", "PNG"), ("pdf", "PDF"), ("csv", "CSV"), ("nc", "NetCDF")):
            self.kinds[kind] = tk.BooleanVar(self, value=True)
            ttk.Checkbutton(bar, text=name, variable=self.kinds[kind]).pack(
                side="left", padx=(0, px(6))
            )
        self.button = tool(
            bar,
            style,
            "Export",
            "Ctrl+E",
            lambda: export(tuple(k for k, of in self.kinds.items() if of.get())),
            "Figures, curves and fields into a folder named after the session",
        )
        self.button.pack(side="left")
        self.page = tool(bar, style, "HTML report", "", page, "One page with everything, to send")
        self.page.pack(side="left", padx=px(4))
        self.done = ttk.Label(bar, text="", style="CardOk.TLabel")
        self.done.pack(side="left", padx=px(8))
        Tip(self.done, style, lambda: self.done.cget("text"))
        self.numbers_wide = Numbers(self.figure, style, quality=True)
        self.numbers_wide.pack(fill="both", expand=True)

    def draw(self, shown: Shown) -> None:
        """Show every number."""
        self.numbers_wide.show(shown)
        self.numbers_wide.recolour()
