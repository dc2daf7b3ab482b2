"""How devices wait: against a deadline on one clock, and never deaf to a cancel."""

from __future__ import annotations

import threading
import time
from typing import Protocol

from drivers.errors import CancelledError

SLICE_S = 0.1  # the longest time that a wait may be deaf to a cancel


class CancelToken:
    """Set once by any thread, seen by every wait; a new wait on a set token raises at once."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._reason = ""

    def cancel(self, reason: str) -> None:
        """Ask every wait on this token to end; the first reason stays."""
        if not self._event.is_set():
            self._reason = reason
            self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether the token was set."""
        return self._event.is_set()

    def check(self) -> None:
        """Go on, or raise.

        Raises
        ------
        CancelledError
            If the token was set, with its reason.
        """
        if self._event.is_set():
            raise CancelledError(self._reason)

    def wait(self, seconds: float) -> None:
        """Wait in real time, ended at once by a cancel; raise `CancelledError` then."""
        self._event.wait(max(seconds, 0.0))
        self.check()


class Clock(Protocol):
    """The one clock of a rig: monotonic, in seconds, with an arbitrary zero."""

    def now_s(self) -> float:
        """Return the present instant."""

    def wait_until(self, instant_s: float, cancel: CancelToken) -> None:
        """Return at an instant, or at once if it is past; raise `CancelledError` if cancelled."""


class MonotonicClock:
    """The host's CLOCK_MONOTONIC, in which V4L2 also stamps its frames."""

    def now_s(self) -> float:
        """Return the present instant."""
        return time.monotonic()

    def wait_until(self, instant_s: float, cancel: CancelToken) -> None:
        """Return at an instant, or at once if it is past; raise `CancelledError` if cancelled."""
        cancel.check()
        while (left_s := instant_s - time.monotonic()) > 0.0:
            cancel.wait(left_s)
