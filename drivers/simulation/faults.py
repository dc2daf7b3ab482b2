"""Faults of simulated devices, scripted by shot and step, so that each can be had on demand."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

FaultKind = Literal[
    "drop",  # the sensor exposes, the frame never arrives
    "delay",  # the frame arrives late by ``seconds``
    "duplicate",  # the frame before is given out again, number and all
    "repeat-bytes",  # the pixels of the frame before under a new number
    "corrupt",  # no picture can be made of what arrived
    "flagged",  # a picture with the driver's error flag
    "gap",  # the sequence jumps by three
    "wrong-exposure",  # exposed ``factor`` times as long, and reported so
    "hidden-exposure",  # exposed ``factor`` times as long, and not reported
    "stuck-trigger",  # the trigger knows that it did not fire
    "silent-trigger",  # the trigger says that it fired, and did not
    "camera-lost",  # the camera is gone, and comes back when opened
    "projector-lost",  # the same of the projector
    "projector-late",  # the light changes ``seconds`` later than the receipt says
    "wrong-pattern",  # the projector keeps what it showed
    "disk-full",  # the disk takes nothing more until the run is resumed
    "kill",  # the process is killed, as by power or a segmentation fault
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault: what, at which shot and step, how often.

    ``shot`` and ``step`` None stand for any; ``times`` counts strikes, not attempts.
    """

    kind: FaultKind
    shot: str | None = None
    step: str | None = None
    times: int = 1
    seconds: float = 0.0
    factor: float = 2.0


class FaultScript:
    """Knows what is being done, and tells a device that asks whether its fault strikes now."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults = tuple(faults)
        self._left = [fault.times for fault in self._faults]
        self.shot = ""
        self.step = ""

    def notice(self, shot: str, step: str) -> None:
        """Hear which step of which shot begins; a scripted kill happens here."""
        self.shot, self.step = shot, step
        if self.strikes("kill") is not None:
            os.kill(os.getpid(), signal.SIGKILL)

    def strikes(self, kind: FaultKind) -> Fault | None:
        """Return the fault of this kind that strikes now, and count it; None if none does."""
        for k, fault in enumerate(self._faults):
            if (
                fault.kind == kind
                and self._left[k] > 0
                and fault.shot in (None, self.shot)
                and fault.step in (None, self.step)
            ):
                self._left[k] -= 1
                return fault
        return None
