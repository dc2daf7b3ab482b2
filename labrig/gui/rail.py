"""The day's six steps: buttons that lead to the right controls, ticked by rules, not by clicks."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from dataclasses import dataclass
from tkinter import ttk

from labrig.gui.style import Style
from labrig.gui.widgets import Card, Tip

STEPS = ("Connect", "Align, focus", "Expose", "Capture", "Analyse", "Review, export")
FOCUSED = 0.9  # of the sharpest seen, and so many readings of it
READINGS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Day:
    """What the rules of the steps look at."""

    connected: bool = False
    focus_share: float = 0.0
    focus_readings: int = 0
    exposure_fits: bool = False
    exposure_why: str = "no picture yet"
    capturing: bool = False
    session: str = ""
    session_whole: bool = False
    analysing: bool = False
    analysed: bool = False
    exported: bool = False


def judge(day: Day) -> list[tuple[bool, str]]:
    """Return of every step whether it is done, and what is missing if not."""
    focused = day.focus_readings >= READINGS and day.focus_share >= FOCUSED
    sharp = f"sharpness is {100 * day.focus_share:.0f} % of the best seen"
    return [
        (day.connected, "no rig is connected: Retry, or start with another --rig"),
        (
            day.connected and focused,
            sharp if day.focus_readings >= READINGS else "show stripes and focus",
        ),
        (day.connected and day.exposure_fits, day.exposure_why or "press A for automatic exposure"),
        (
            bool(day.session) and day.session_whole and not day.capturing,
            "capturing" if day.capturing else "press F5; the session must become complete",
        ),
        (
            day.analysed and not day.analysing,
            "analysing" if day.analysing else "no session is analysed yet",
        ),
        (day.exported, "nothing of this session was exported yet"),
    ]


def current(done: list[bool], day: Day) -> int:
    """Return the step that the operator is at: what runs, else the first that is not done."""
    if day.capturing:
        return 3
    if day.analysing:
        return 4
    return next((k for k, ok in enumerate(done) if not ok), len(done) - 1)


class Rail(Card):
    """Shows the steps."""

    def __init__(self, parent: tk.Misc, style: Style, go: Callable[[int], None]) -> None:
        super().__init__(parent, style, "Today")
        self.states: list[str] = ["later"] * len(STEPS)
        self._why = [""] * len(STEPS)
        self.buttons: list[ttk.Button] = []
        for k, name in enumerate(STEPS):
            button = ttk.Button(
                self.body,
                text=f"○  {k + 1}  {name}",
                style="Later.Step.TButton",
                command=lambda k=k: go(k),  # type: ignore[misc]
            )
            button.pack(fill="x")
            Tip(button, style, lambda k=k: self._why[k])  # type: ignore[misc]
            self.buttons.append(button)

    def show(self, day: Day) -> None:
        """Tick what the rules say is done."""
        judged = judge(day)
        at = current([ok for ok, _ in judged], day)
        for k, (ok, why) in enumerate(judged):
            state = "now" if k == at else "done" if ok else "later"
            self._why[k] = "done" if ok else why
            if state == self.states[k] and state != "now":
                continue
            self.states[k] = state
            symbol = "✓" if ok else "▶" if state == "now" else "○"
            self.buttons[k].configure(
                text=f"{symbol}  {k + 1}  {STEPS[k]}",
                style={"now": "Now", "done": "Done", "later": "Later"}[state] + ".Step.TButton",
            )
