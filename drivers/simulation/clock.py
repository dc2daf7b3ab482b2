"""Time in the simulated world: it passes when somebody waits, at no cost."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count

from drivers.waiting import CancelToken


class VirtualClock:
    """A monotonic clock that advances only while somebody waits.

    What was ordered by `at` happens in its course, so that a test can press a key, pull a plug or
    cancel at any instant of a wait.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        self._ordered: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = count()

    def now_s(self) -> float:
        """Return seconds since the world began."""
        return self._now_s

    def at(self, instant_s: float, action: Callable[[], object]) -> None:
        """Order an action for an instant; one in the past happens at the next wait."""
        heapq.heappush(self._ordered, (instant_s, next(self._numbers), action))

    def sleep(self, seconds: float) -> None:
        """Let time pass; a negative wait is no wait."""
        self.wait_until(self._now_s + seconds, CancelToken())

    def wait_until(self, instant_s: float, cancel: CancelToken) -> None:
        """Let time pass until an instant; raise `CancelledError` where the token is set."""
        cancel.check()
        while self._ordered and self._ordered[0][0] <= max(instant_s, self._now_s):
            at_s, _, action = heapq.heappop(self._ordered)
            self._now_s = max(at_s, self._now_s)
            action()
            cancel.check()
        self._now_s = max(instant_s, self._now_s)
