"""What passes between the operator's window and the thread that owns the devices.

Light to import, so that the window shows before the solvers load.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
Counts = NDArray[np.uint16]
Level = Literal["info", "warn", "error"]
Show = Literal["white", "stripes", "cycle", "black", "off"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A frame as the camera gave it, (rows, cols) counts.

    Attributes
    ----------
    exposure_s, gain_db : as the camera reports them, else as it accepted them
    taken_s : when the host had it, on `time.monotonic`
    shows : what the projector showed
    """

    pixels: Counts
    exposure_s: float
    gain_db: float
    taken_s: float
    shows: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeSet:
    """The newest picture of every shift, reduced, to be separated and fitted at once.

    Attributes
    ----------
    counts : (n_shifts, rows, cols) float32, means of ``binned`` x ``binned`` px of the region
    black : (rows, cols) likewise, of the projector showing black
    setup : what a session says of camera, geometry, tank and stripes, as JSON
    taken_s : when the oldest of these pictures was taken, on `time.monotonic`
    plan_s : what the plan exposes every shift in all, s
    """

    counts: NDArray[np.float32]
    black: NDArray[np.float32]
    binned: int
    exposure_s: float
    setup: dict[str, Any]
    taken_s: float
    plan_s: float


class Newest(Generic[T]):
    """A box for one thing, in which the newest replaces what nobody has taken yet."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: T | None = None
        self.put_in = self.dropped = 0

    def put(self, thing: T) -> None:
        """Put a thing in; the one that was there is dropped, and counted."""
        with self._lock:
            self.dropped += self._held is not None
            self.put_in += 1
            self._held = thing

    def take(self) -> T | None:
        """Take what is there out; None if nothing new is."""
        with self._lock:
            held, self._held = self._held, None
            return held


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """One line for the log."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Working:
    """How far something long is; ``total`` 0 while that is unknown."""

    what: str
    done: int
    total: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """What went wrong, what is safe, and what the operator may do; empty text: it is over."""

    text: str
    safe: str = ""
    retry: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Connected:
    """The rig that is open, and what the window must know of it."""

    name: str
    camera: str
    projector: str
    simulated: bool
    shape: tuple[int, int]
    bits: int
    white_level: int
    black_level: float
    exposure_range_s: tuple[float, float]
    gain_range_db: tuple[float, float]
    region_px: tuple[int, int, int, int] | None
    mm_per_px: float | None
    lit_side: str
    beam_rows_px: tuple[float, float] | None
    can_show: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Disconnected:
    """No rig is open; why."""

    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Applied:
    """Camera settings as asked for and as the camera reports them back."""

    asked_exposure_s: float
    exposure_s: float
    asked_gain_db: float
    gain_db: float
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """One verdict of the preflight, with its remedy in the text."""

    name: str
    word: Literal["ok", "note", "refused"]
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """The plan as it stands: its shots, its price and whether it could run.

    ``groups`` are names with the shots' ids; ``patterns`` the projector's line by shot's id.
    """

    name: str
    period_px: int
    shifts: int
    bracket_s: tuple[float, ...]
    groups: tuple[tuple[str, tuple[str, ...]], ...]
    patterns: dict[str, NDArray[np.uint8]]
    seconds: dict[str, float]
    n_bytes: int
    free_bytes: int
    verdicts: tuple[Checked, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunTold:
    """What a run told: kind and text of the event, with the status after it."""

    kind: str
    text: str
    state: str
    step: str
    shot: str
    attempt: int
    saved: int
    total: int
    failures: int
    eta_s: float
    problem: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RunEnded:
    """How a run ended: completed, aborted, failed or refused; its folder if there is one."""

    state: str
    reason: str
    session: Path | None


Message = (
    Said | Working | Trouble | Connected | Disconnected | Applied | Planned | RunTold | RunEnded
)
Ask = Callable[[Any], None]  # of the `Station`, which is too heavy to be imported here


@dataclass
class Door:
    """Everything that passes between the window's thread and the devices' thread.

    The window puts questions in and polls the rest; nothing here blocks.
    """

    asked: queue.SimpleQueue[Ask] = field(default_factory=queue.SimpleQueue)
    told: queue.SimpleQueue[Message] = field(default_factory=queue.SimpleQueue)
    pictures: Newest[Picture] = field(default_factory=Newest)
    stripes: Newest[StripeSet] = field(default_factory=Newest)
    closing: threading.Event = field(default_factory=threading.Event)
    _command: Callable[[str], None] | None = None

    def ask(self, question: Ask) -> None:
        """Let the devices' thread do something, after what it was asked before."""
        self.asked.put(question)

    def command(self, word: str) -> None:
        """Command the run, at once: pause, resume, retry, skip-group, abort, abort-after-group."""
        command = self._command
        if command is not None:
            command(word)

    def listen(self, command: Callable[[str], None] | None) -> None:
        """Let commands go to a run; to none where there is no run."""
        self._command = command
