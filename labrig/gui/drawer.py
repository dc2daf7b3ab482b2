"""What opens below the live picture: the profile, the live fit, or the run as it goes."""

from __future__ import annotations

import time
import tkinter as tk
from collections.abc import Callable
from tkinter import ttk

import numpy as np

from labrig.gui.curves import Chart, Curve
from labrig.gui.plot import PlotPane
from labrig.gui.style import Style
from labrig.gui.widgets import Tip
from labrig.station.door import Planned, RunTold
from labrig.station.shown import Fitted

OLD_S = 1.0  # a live result older than this is said to be old
COMMANDS = (
    ("pause", "Pause", "Stand still, dark, after this shot"),
    ("resume", "Go on", "Go on after a pause, with new references"),
    ("retry", "Retry", "Try the shot again that made the run pause"),
    ("skip-group", "Skip group", "Leave this group out; the session is then not complete"),
    ("abort-after-group", "Stop after group", "End when this group is complete"),
)


class Drawer(ttk.Frame):
    """Holds one of three panels, or none."""

    def __init__(self, parent: tk.Misc, style: Style, command: Callable[[str], None]) -> None:
        super().__init__(parent, style="Card.TFrame")
        self.ui = style
        self.open = ""
        self.plot = PlotPane(self, style, height=140)
        self.live = LiveFit(self, style)
        self.run = RunPanel(self, style, command)
        self._panels: dict[str, tk.Widget] = {
            "profile": self.plot,
            "decomposition": self.live,
            "run": self.run,
        }

    def show(self, what: str) -> None:
        """Open a panel in place of the other; "" closes."""
        if what == self.open:
            return
        for panel in self._panels.values():
            panel.pack_forget()
        self.open = what
        if not what:
            self.pack_forget()
            return
        self._panels[what].pack(fill="both", expand=True)
        self.pack(side="bottom", fill="x", pady=(self.ui.px(4), 0))

    def profile(self, depth: np.ndarray, counts: np.ndarray, black: float, unit: str) -> None:
        """Show light along the beam above black."""
        p = self.ui.palette
        look = (p.curves[1][0] if p.name == "dark" else p.curves[0][0], (), "")
        light = np.maximum(counts - black, 0.0)
        self.plot.show(
            Chart(
                curves=(Curve(x=depth, y=light, look=look),),
                x_label=f"depth along the beam ({unit})",
                y_label="raw counts above black (DN), mean across the beam",
                log=True,
                legend=False,
            )
        )

    def recolour(self) -> None:
        """Take the colours of the palette."""
        self.plot.redraw()
        self.live.recolour()
        self.run.redraw()


class LiveFit(ttk.Frame):
    """Extinction, scattering and asymmetry of every new set, with their age and how sure."""

    def __init__(self, parent: tk.Misc, style: Style) -> None:
        super().__init__(parent, style="Card.TFrame")
        self.ui = style
        px = style.px
        self.fitted: Fitted | None = None
        self.count = 0
        left = ttk.Frame(self, style="Card.TFrame")
        left.pack(side="left", fill="y", padx=(px(4), px(8)))
        self.rows: dict[str, tuple[ttk.Label, ttk.Label]] = {}
        for k, (key, name) in enumerate(
            (("sigma_t", "σₜ extinction"), ("sigma_s", "σₛ scattering"), ("g", "g asymmetry"))
        ):
            ttk.Label(left, text=name, style="CardSmall.TLabel").grid(
                row=k, column=0, sticky="w", padx=(0, px(8))
            )
            value = ttk.Label(left, text="—", style="Number.TLabel", width=8)
            value.grid(row=k, column=1, sticky="w")
            sure = ttk.Label(left, text="", style="CardSmall.TLabel", width=14)
            sure.grid(row=k, column=2, sticky="w")
            self.rows[key] = (value, sure)
        self.age = ttk.Label(left, text="", style="CardSmall.TLabel", width=40)
        self.age.grid(row=3, column=0, columnspan=3, sticky="w", pady=(px(2), 0))
        self.bar = tk.Canvas(left, height=px(5), width=px(120), highlightthickness=0)
        self.bar.grid(row=4, column=0, columnspan=3, sticky="ew", pady=px(2))
        self.why = ttk.Label(
            left,
            text="Cycling stripes are fitted as they come.",
            style="CardSmall.TLabel",
            wraplength=px(290),
            justify="left",
        )
        self.why.grid(row=5, column=0, columnspan=3, sticky="w")
        self.plot = PlotPane(self, style, height=164)
        self.plot.pack(side="left", fill="both", expand=True)

    def show(self, fitted: Fitted) -> None:
        """Show a new result."""
        self.fitted = fitted
        self.count += 1
        for key, (value, sure) in self.rows.items():
            found = getattr(fitted, key)
            if found is None:
                value.configure(text="—")
                sure.configure(text="not determined")
                continue
            unit = "" if key == "g" else f" /{fitted.unit}"
            value.configure(text=f"{found[0]:.4f}" if key != "g" else f"{found[0]:.3f}")
            sure.configure(text=f"± {found[1]:.1g}{unit}")
        self.why.configure(text=fitted.why or "± noise and model error, together")
        self._draw()
        self.tell_age()

    def tell_age(self) -> None:
        """Say how old the result is; an old one is marked so."""
        fitted = self.fitted
        if fitted is None:
            return
        age_s = time.monotonic() - fitted.taken_s
        old = age_s > OLD_S
        p = self.ui.palette
        self.age.configure(
            text=f"{'! old: ' if old else '● '}{age_s:.1f} s since its first picture",
            style="CardWarn.TLabel" if old else "CardOk.TLabel",
        )
        width, height = self.bar.winfo_width(), self.bar.winfo_height()
        self.bar.configure(background=p.field)
        self.bar.delete("all")
        share = min(age_s / OLD_S, 1.0)
        self.bar.create_rectangle(
            0, 0, width * share, height, fill=p.warn if old else p.ok, outline=""
        )

    def recolour(self) -> None:
        """Take the colours of the palette."""
        self._draw()

    def _draw(self) -> None:
        fitted, p = self.fitted, self.ui.palette
        if fitted is None:
            self.plot.show(
                Chart(
                    x_label="depth along the beam",
                    y_label="light of the first bounces",
                    legend=False,
                )
            )
            return
        curves = [
            Curve(x=fitted.bounce_depth, y=line, look=look, name=f"bounce {k}")
            for k, (line, look) in enumerate(zip(fitted.bounces, p.curves, strict=False), start=1)
        ]
        if fitted.depth.size:
            curves.append(
                Curve(
                    x=fitted.depth,
                    y=fitted.single,
                    look=(p.text, (), "o"),
                    points=True,
                    name="measured",
                )
            )
        top = float(fitted.bounces.max()) if fitted.bounces.size else 0.0
        deepest = 0.0
        if fitted.sigma_t is not None and fitted.depth.size:
            deepest = min(6.0 / fitted.sigma_t[0], float(fitted.depth[-1]))
        self.plot.show(
            Chart(
                curves=tuple(curves),
                x_label=f"depth along the beam ({fitted.unit})",
                y_label="light (counts/s)",
                log=True,
                y_range=(2e-3 * top, 8.0 * top) if top > 0.0 else None,
                x_range=(0.0, deepest) if deepest else None,
            )
        )


class RunPanel(ttk.Frame):
    """The groups of a run, coloured by attempts; what is shown beside what is seen; commands."""

    def __init__(self, parent: tk.Misc, style: Style, command: Callable[[str], None]) -> None:
        super().__init__(parent, style="Card.TFrame")
        self.ui = style
        px = style.px
        row = ttk.Frame(self, style="Card.TFrame")
        row.pack(side="bottom", fill="x", pady=(px(4), 0))
        self.buttons: dict[str, ttk.Button] = {}
        for word, name, tip in COMMANDS:
            button = ttk.Button(
                row,
                text=name,
                style="Tool.TButton",
                command=lambda word=word: command(word),  # type: ignore[misc]
            )
            button.pack(side="left", padx=(0, px(4)))
            Tip(button, style, tip)
            self.buttons[word] = button
        self.problem = ttk.Label(row, text="", style="CardWarn.TLabel")
        self.problem.pack(side="left", padx=px(8))
        self.canvas = tk.Canvas(self, height=px(112), width=px(200), highlightthickness=0)
        self.canvas.pack(fill="both", expand=True)
        self.canvas.bind("<Configure>", lambda _e: self.redraw())
        self.plan: Planned | None = None
        self.attempts: dict[str, int] = {}
        self.saved: set[str] = set()
        self.told: RunTold | None = None

    def begin(self, plan: Planned) -> None:
        """Show a plan of which nothing is taken yet."""
        self.plan, self.attempts, self.saved, self.told = plan, {}, set(), None
        self.problem.configure(text="")
        self.redraw()

    def tell(self, told: RunTold) -> None:
        """Follow the run."""
        self.told = told
        if told.shot:
            self.attempts[told.shot] = max(told.attempt, self.attempts.get(told.shot, 0))
        if told.kind == "saved":
            self.saved.add(told.text)
        if told.kind == "problem":
            self._say(f"! {told.text}")
        takes = {
            "running": {"pause", "skip-group", "abort-after-group"},
            "arming": {"pause", "abort-after-group"},
            "recovering": {"pause", "skip-group", "abort-after-group"},
            "paused": {"resume", "retry", "skip-group", "abort-after-group"},
        }.get(told.state, set())
        for word, button in self.buttons.items():
            button.state(["!disabled" if word in takes else "disabled"])

    def _say(self, text: str) -> None:
        """Say a problem, cut to the room there is; the log has it whole."""
        font = self.ui.font()
        room = self.winfo_width() - sum(b.winfo_reqwidth() for b in self.buttons.values())
        room -= self.ui.px(48)
        while text and font.measure(f"{text}…") > room:
            text = text[: -max(len(text) // 12, 1)]
            if font.measure(f"{text}…") <= room:
                text += "…"
                break
        self.problem.configure(text=text)

    def redraw(self) -> None:
        """Draw a cell for every shot, a row for every group."""
        canvas, p, px = self.canvas, self.ui.palette, self.ui.px
        canvas.configure(background=p.card)
        canvas.delete("all")
        if self.plan is None:
            return
        groups = self.plan.groups
        width, height = canvas.winfo_width(), canvas.winfo_height()
        longest = max((len(ids) for _, ids in groups), default=1)
        font = self.ui.font("small")
        line = font.metrics("linespace")
        per_column = max((height - px(2)) // (line + px(3)), 1)
        n_columns = -(-len(groups) // per_column)
        names = [name.removesuffix("-r0") for name, _ in groups]
        name_px = max(font.measure(name) for name in names) + px(8)
        cell = min(px(16), max((width // n_columns - name_px - px(12)) // longest, px(4)))
        column_px = name_px + longest * (cell + px(2)) + px(14)
        now = self.told.shot if self.told else ""
        for k, (_name, ids) in enumerate(groups):
            x, y = (k // per_column) * column_px, (k % per_column) * (line + px(3))
            canvas.create_text(
                x,
                y + line // 2,
                text=names[k],
                anchor="w",
                font=font,
                fill=p.text if now in ids else p.dim,
            )
            for n, shot in enumerate(ids):
                left = x + name_px + n * (cell + px(2))
                self._cell(left, y + 1, cell, line - 2, shot, now=shot == now)

    def _cell(self, left: int, top: int, width: int, height: int, shot: str, *, now: bool) -> None:
        p, canvas = self.ui.palette, self.canvas
        tries = self.attempts.get(shot, 0)
        done = shot in self.saved
        colour = p.field if not done else p.ok if tries <= 1 else p.warn if tries == 2 else p.bad
        canvas.create_rectangle(
            left,
            top,
            left + width,
            top + height,
            fill=colour,
            outline=p.accent if now else p.line,
            width=self.ui.px(2) if now else 1,
        )
        if tries > 1:
            canvas.create_text(
                left + width // 2,
                top + height // 2,
                text=str(tries),
                font=self.ui.font("small"),
                fill=p.on_accent if done else p.text,
            )
