"""What carries the lines of a trigger box: a serial line or the bulk endpoints of a USB device."""

from __future__ import annotations

from typing import Protocol

from drivers.waiting import CancelToken

LONGEST_LINE = 256  # a device that sends more without an end of line speaks another protocol


class LineChannel(Protocol):
    """Lines of bytes in both directions, whole or not at all."""

    @property
    def name(self) -> str:
        """Where it leads, for messages."""

    def open(self) -> dict[str, str]:
        """Connect; return what the system knows of the device: ``model`` and ``serial``."""

    def close(self) -> None:
        """Disconnect; harmless if done twice, never raises."""

    def send(self, line: bytes, *, deadline_s: float, cancel: CancelToken) -> None:
        """Send one line, its end included."""

    def receive(self, *, deadline_s: float, cancel: CancelToken) -> bytes:
        """Return the next line without its end; raise `DeadlineError` if none came whole."""

    def quiet(self) -> bool:
        """Ask for silence beside the lines, where there is such a way; return whether there is."""


def take_line(received: bytearray) -> bytes | None:
    """Remove the first whole line from what was received and return it; None if none is whole."""
    end = received.find(b"\n")
    if end < 0:
        if len(received) > LONGEST_LINE:
            received.clear()
        return None
    line = bytes(received[:end]).rstrip(b"\r")
    del received[: end + 1]
    return line
