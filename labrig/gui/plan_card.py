"""The controls at the right, below: what the projector shows, the plan, its price, and Capture."""

from __future__ import annotations

import math
import tkinter as tk
from collections.abc import Callable
from tkinter import ttk

import numpy as np
from PIL import Image, ImageTk

from labrig.gui.images import stripes
from labrig.gui.style import Style
from labrig.gui.widgets import Card, NumberField, Tip, by_one, number
from labrig.station.door import Planned, Show

SHOWS: dict[str, Show] = {
    "white": "white",
    "stripes": "stripes",
    "stripes, cycling": "cycle",
    "black": "black",
    "lamp off": "off",
}


class PatternCard(Card):
    """What is projected now, and the stripes and bracket of the plan."""

    def __init__(
        self,
        parent: tk.Misc,
        style: Style,
        *,
        show: Callable[[Show], None],
        change: Callable[..., None],
    ) -> None:
        super().__init__(parent, style, "Pattern")
        px = style.px
        self._style, self._change = style, change
        self._period = 12
        self.canvas = tk.Canvas(self.body, height=px(26), width=px(180), highlightthickness=0)
        self.canvas.pack(fill="x", pady=(0, px(4)))
        self._item = self.canvas.create_image(0, 0, anchor="nw")
        self._photo: ImageTk.PhotoImage | None = None
        self._choice(show)
        self._stripes()
        self.bracket = NumberField(
            self.body, style, label="Bracket", unit="ms", commit=self._bracket_typed
        )
        self.bracket.pack(fill="x", pady=px(1))
        Tip(self.bracket.entry, style, "Exposures of every pattern; the shortest must clip nothing")

    def _choice(self, show: Callable[[Show], None]) -> None:
        style = self._style
        row = ttk.Frame(self.body, style="Card.TFrame")
        row.pack(fill="x", pady=style.px(1))
        ttk.Label(row, text="Show", style="Card.TLabel", width=8).pack(side="left")
        self.chosen = tk.StringVar(self, value="stripes")
        self.box = ttk.Combobox(
            row,
            textvariable=self.chosen,
            values=list(SHOWS),
            state="readonly",
            width=10,
            font=style.font(),
        )
        self.box.pack(side="left", fill="x", expand=True)
        self.box.bind("<<ComboboxSelected>>", lambda _e: show(SHOWS[self.chosen.get()]))
        Tip(
            self.box,
            style,
            "What the projector shows between captures; cycling stripes are "
            "separated and fitted live (D)",
        )

    def _stripes(self) -> None:
        style, px = self._style, self._style.px
        pair = ttk.Frame(self.body, style="Card.TFrame")
        pair.pack(fill="x", pady=px(1))
        self.period = NumberField(
            pair,
            style,
            label="Period",
            commit=lambda t: self._whole("period_px", t),
            step=by_one,
            width=3,
        )
        self.shifts = NumberField(
            pair,
            style,
            label="Shifts",
            commit=lambda t: self._whole("shifts", t),
            step=by_one,
            width=3,
            label_width=6,
        )
        self.period.pack(side="left", fill="x", expand=True)
        self.shifts.pack(side="left", fill="x", expand=True, padx=(px(6), 0))
        Tip(
            self.period.entry,
            style,
            "Lit and dark together, projector px; a simulated tank takes "
            "a while to answer another period",
        )

    def planned(self, plan: Planned) -> None:
        """Show the plan as it holds."""
        self._period = plan.period_px
        self.period.hold(str(plan.period_px))
        self.shifts.hold(str(plan.shifts))
        self.bracket.hold(" ".join(f"{1e3 * e:.4g}" for e in plan.bracket_s))

    def able(self, shows: tuple[str, ...]) -> None:
        """Offer what the projector can show."""
        self.box.configure(values=[name for name, what in SHOWS.items() if what in shows])

    def choose(self, what: Show) -> None:
        """Show what is projected."""
        self.chosen.set(next(name for name, of in SHOWS.items() if of == what))

    def preview(self, line: np.ndarray | None) -> None:
        """Show what the projector shows, one line of it."""
        width, height = self.canvas.winfo_width(), self.canvas.winfo_height()
        if width < 10 or height < 4:
            return
        picture = stripes(line, width, height, self._period)
        self._photo = ImageTk.PhotoImage(Image.fromarray(picture), master=self.canvas)
        self.canvas.itemconfigure(self._item, image=self._photo)

    def enable(self, *, on: bool) -> None:
        """Let the plan be changed, or not while it runs."""
        for field in (self.period, self.shifts, self.bracket):
            field.enable(on=on)
        self.box.state(["!disabled" if on else "disabled"])
        if on:
            self.box.state(["readonly"])

    def _whole(self, name: str, text: str) -> None:
        field = self.period if name == "period_px" else self.shifts
        try:
            value = int(number(text))
        except ValueError:
            field.refuse()
            return
        self._change(**{name: value})

    def _bracket_typed(self, text: str) -> None:
        try:
            values = tuple(number(part) / 1e3 for part in text.split())
        except ValueError:
            self.bracket.refuse()
            return
        if not values or min(values) <= 0.0 or not all(math.isfinite(v) for v in values):
            self.bracket.refuse()
            return
        self._change(bracket_s=tuple(sorted(values)))


class CaptureCard(Card):
    """What the plan costs, whether it could run, and the button that runs it."""

    def __init__(self, parent: tk.Misc, style: Style, capture: Callable[[], None]) -> None:
        super().__init__(parent, style, "")
        px = style.px
        self.cost = ttk.Label(self.body, text="", style="Card.TLabel")
        self.cost.pack(anchor="w")
        self.expected = ttk.Label(self.body, text="", style="CardSmall.TLabel")
        self.verdict = ttk.Label(self.body, text="", style="CardOk.TLabel")
        self.verdict.pack(anchor="w", fill="x")
        self._verdicts = ""
        Tip(self.verdict, style, lambda: self._verdicts)
        Tip(self.cost, style, lambda: self._seconds)
        self._seconds = ""
        self.button = ttk.Button(
            self.body, text="Capture session  F5", style="Main.TButton", command=capture
        )
        self.button.pack(fill="x", pady=(px(4), 0))
        Tip(self.button, style, lambda: self._why)
        self._why = ""

    def planned(self, plan: Planned, uncertainty: float) -> None:
        """Show price and verdicts; ``uncertainty`` of sigma_t per mm, NaN while unknown."""
        total = sum(plan.seconds.values())
        shots = sum(len(ids) for _, ids in plan.groups)
        self.cost.configure(text=f"{shots} shots · {total:.0f} s · {plan.n_bytes / 1e6:.0f} MB")
        if not math.isnan(uncertainty):
            self.expected.configure(text=f"expected σₜ ± {uncertainty:.1g} /mm")
            self.expected.pack(anchor="w", after=self.cost)
        parts = "\n".join(f"{n.replace('_', ' ')}: {s:.1f} s" for n, s in plan.seconds.items())
        self._seconds = f"{parts}\nσₜ ± is what the plan will leave, by the live fit (D)"
        refused = [v for v in plan.verdicts if v.word == "refused"]
        noted = [v for v in plan.verdicts if v.word == "note"]
        self._verdicts = "\n".join(f"{v.word}: {v.text}" for v in plan.verdicts)
        if refused:
            text, look = f"✕ refused: {refused[0].name}", "CardBad.TLabel"
        elif noted:
            text, look = f"! {len(noted)} to know: {noted[0].name}", "CardWarn.TLabel"
        else:
            text, look = "✓ preflight passed", "CardOk.TLabel"
        self.verdict.configure(text=text, style=look)

    def able(self, why: str) -> None:
        """Let it be captured, or say why not."""
        self._why = why or "Runs the plan into a new session"
        self.button.state(["disabled" if why else "!disabled"])
