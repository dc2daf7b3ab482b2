"""Messages between a driver and a process of its own: a line of JSON, then bytes if it says so."""

from __future__ import annotations

import json
import os
import select
import time
from contextlib import suppress
from typing import Any

from drivers.errors import DeadlineError, DeviceLostError
from drivers.waiting import SLICE_S, CancelToken


def write_message(
    descriptor: int,
    message: dict[str, Any],
    payload: bytes = b"",
    *,
    deadline_s: float | None = None,
) -> None:
    """Write one message; a deadline needs a descriptor that does not block.

    Raises
    ------
    DeadlineError
        If the other side did not take all of it; it then has a part.
    """
    head = json.dumps({**message, "payload": len(payload)}).encode() + b"\n"
    for piece in (head, payload):
        view = memoryview(piece)
        while view:
            if (
                deadline_s is not None
                and not select.select(
                    [], [descriptor], [], max(deadline_s - time.monotonic(), 0.0)
                )[1]
            ):
                msg = "the other process took no bytes before the deadline."
                raise DeadlineError(msg)
            with suppress(BlockingIOError):
                view = view[os.write(descriptor, view) :]


class MessageReader:
    """Reads messages from a pipe, whole."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._received = bytearray()

    def read(self) -> tuple[dict[str, Any], bytes] | None:
        """Return the next message, waiting as long as it takes; None when the other side ended."""
        while (end := self._received.find(b"\n")) < 0:
            if not self._more():
                return None
        message = json.loads(self._received[:end])
        del self._received[: end + 1]
        length = message.pop("payload")
        while len(self._received) < length:
            if not self._more():
                return None
        payload = bytes(self._received[:length])
        del self._received[:length]
        return message, payload

    def next(self) -> dict[str, Any]:
        """Return the next message, which has no bytes; raise `DeviceLostError` at the end."""
        received = self.read()
        if received is None:
            msg = "the other process has ended."
            raise DeviceLostError(msg)
        return received[0]

    def pending(self) -> bool:
        """Return whether bytes were received that `read` has not returned."""
        return bool(self._received)

    def await_bytes(self, *, deadline_s: float, cancel: CancelToken) -> None:
        """Return when there is something to read; raise `DeadlineError` or `CancelledError`."""
        while not self._received:
            cancel.check()
            left_s = deadline_s - time.monotonic()
            ready = select.select([self._descriptor], [], [], min(max(left_s, 0.0), SLICE_S))[0]
            if ready:
                if not self._more():
                    msg = "the other process has ended."
                    raise DeviceLostError(msg)
            elif left_s <= 0.0:
                msg = "the other process did not answer before the deadline."
                raise DeadlineError(msg)

    def _more(self) -> bool:
        piece = os.read(self._descriptor, 1 << 20)
        self._received += piece
        return bool(piece)
