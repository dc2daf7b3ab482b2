"""Keeps frames while the rig goes on: one writer thread behind a bounded queue."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.waiting import SLICE_S, CancelToken
from labrig.session.items import Item
from labrig.session.writer import SessionWriter

DEPTH = 16  # frames in memory at most; then the plan waits, for the scene is static
GROUP = 8  # frames that share one fsync of folder and journal when the queue has grown


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Failure:
    """The error of the disk, and what it kept from being saved."""

    error: Exception
    unsaved: tuple[Item, ...]


class Keeper:
    """Hands what is to be kept to a session's writer, in order, in groups when they queue up.

    After an error nothing more is written, and every call but `collect_failure` says nothing was
    kept, until the failure has been collected.
    """

    def __init__(self, writer: SessionWriter, *, depth: int = DEPTH) -> None:
        self.writer = writer
        self._depth = depth
        self._changed = threading.Condition()
        self._waiting: deque[Item] = deque()
        self._in_hand: Sequence[Item] = ()
        self._saved: deque[Item] = deque()
        self._failure: Failure | None = None
        self._ending = False
        self._thread = threading.Thread(target=self._work, name="labrig-keeper", daemon=True)
        self._thread.start()

    @property
    def failed(self) -> bool:
        """Whether the disk failed, and nobody has collected what it kept from being saved."""
        return self._failure is not None

    def put(self, item: Item, cancel: CancelToken) -> bool:
        """Queue what is to be kept; wait while the queue is full. False if the disk has failed."""
        with self._changed:
            while len(self._waiting) >= self._depth and self._failure is None:
                self._changed.wait(SLICE_S)
                cancel.check()
            if self._failure is not None:
                self._failure = Failure(
                    error=self._failure.error, unsaved=(*self._failure.unsaved, item)
                )
                return False
            self._waiting.append(item)
            self._changed.notify_all()
            return True

    def drain(self, timeout_s: float) -> bool:
        """Wait until all is on the disk; False if that did not come about in time."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._failure is not None or not (self._waiting or self._in_hand),
                timeout_s,
            )
            return self._failure is None and not (self._waiting or self._in_hand)

    def collect_saved(self) -> list[Item]:
        """Return what has been saved since the last call, in order."""
        with self._changed:
            saved = list(self._saved)
            self._saved.clear()
            return saved

    def collect_failure(self) -> Failure | None:
        """Return what went wrong, once; the keeper then tries again with what comes next."""
        with self._changed:
            failure, self._failure = self._failure, None
            self._changed.notify_all()
            return failure

    def stop(self, timeout_s: float) -> bool:
        """End the thread after what is queued; False if it did not end in time."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._ending or (self._waiting and self._failure is None)
                )
                if self._failure is not None or not self._waiting:
                    return
                n = min(len(self._waiting), GROUP)
                self._in_hand = [self._waiting.popleft() for _ in range(n)]
                self._changed.notify_all()
            self._keep(self._in_hand)

    def _keep(self, items: Sequence[Item]) -> None:
        try:
            self.writer.keep(items)
        except Exception as error:
            with self._changed:
                self._failure = Failure(error=error, unsaved=(*items, *self._waiting))
                self._waiting.clear()
                self._in_hand = ()
                self._changed.notify_all()
            return
        with self._changed:
            self._saved.extend(items)
            self._in_hand = ()
            self._changed.notify_all()
