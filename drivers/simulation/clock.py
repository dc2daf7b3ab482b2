"""Time in the simulated world: it passes when somebody waits, at no cost."""

from __future__ import annotations


class VirtualClock:
    """A monotonic clock that advances only by ``sleep``."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """Return seconds since the world began."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Let time pass; a negative wait is no wait."""
        self._now_s += max(seconds, 0.0)
