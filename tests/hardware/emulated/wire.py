"""A serial wire between a box and a driver that can be cut, garbled, held up and slowed."""

from __future__ import annotations

import os
import select
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

Spoil = Callable[[bytes], bytes]


class Wire:
    """Carries bytes between the pty of a box and a pty of its own, through a fault.

    ``spoil`` is applied to what the box sends, which waits while ``flows`` is not set, and ``baud``
    is the one speed at which bytes survive: at another they arrive as noise.
    """

    def __init__(self, box_port: str, *, baud: int = 115200) -> None:
        self.spoil: Spoil = lambda piece: piece
        self.flows = threading.Event()
        self.flows.set()
        self._baud = baud
        self._box = os.open(box_port, os.O_RDWR | os.O_NOCTTY)
        self._far, self._near = os.openpty()
        tty.setraw(self._near)
        self.port = os.ttyname(self._near)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Cut the wire: the port hangs up, as a USB adapter does when it is pulled out."""
        self._stop.set()
        self.flows.set()
        self._thread.join(timeout=5)
        for descriptor in (self._near, self._far, self._box):
            with suppress(OSError):
                os.close(descriptor)

    def _at_speed(self, piece: bytes) -> bytes:
        found = termios.tcgetattr(self._near)[5]
        wanted = getattr(termios, f"B{self._baud}")
        return piece if found == wanted else bytes(byte ^ 0xA5 for byte in piece)

    def _carry(self) -> None:
        while not self._stop.is_set():
            ready = select.select([self._box, self._far], [], [], 0.02)[0]
            if self._far in ready:
                os.write(self._box, self._at_speed(os.read(self._far, 4096)))
            if self._box in ready:
                piece = self.spoil(self._at_speed(os.read(self._box, 4096)))
                self.flows.wait()
                os.write(self._far, piece)
