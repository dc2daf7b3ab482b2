"""A trigger box on USB: the reference firmware behind bulk endpoints."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from emulated.firmware import Box
from emulated.usb_device import Setup, UsbDevice, configuration, interface

QUIET = 1
SAFE_LINE = b"0 safe*D0\n"


class UsbTriggerDevice(UsbDevice):
    """Lines to bulk OUT 1 reach the firmware, its answers come from bulk IN 1."""

    config = configuration(1, interface(0, [0x81, 0x01], (0xFF, 0, 0)))

    def __init__(self, program: Path, *, serial: str = "T0001") -> None:
        super().__init__()
        self.strings = ("labrig", "emulated trigger", serial)
        self.mute = False
        self.stalled = False
        self.box = Box(program)
        self._port = os.open(self.box.port, os.O_RDWR | os.O_NOCTTY)
        self._answers = bytearray()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def control(self, setup: Setup, sent: bytes) -> bytes | None:
        """Obey the one vendor request."""
        if setup.kind == 0x40 and setup.request == QUIET:
            os.write(self._port, SAFE_LINE)
            return b""
        return None

    def bulk_out(self, endpoint: int, sent: bytes) -> bool:
        """Carry a line to the firmware."""
        if self.stalled:
            return False
        if not self.mute:
            os.write(self._port, sent)
        return True

    def bulk_in(self, endpoint: int, length: int) -> bytes | None:
        """Return what the firmware said."""
        if not self._answers:
            return None
        piece = bytes(self._answers[:length])
        del self._answers[: len(piece)]  # no more: another thread adds to them
        return piece

    def clear_halt(self, endpoint: int) -> None:
        """Take bytes again."""
        self.stalled = False

    def stop(self) -> None:
        """End the firmware."""
        self.box.unplug()
        # Closed while it is listened to, its number would go to the next box, whose answers this
        # listener would then take.
        self._listener.join(timeout=5.0)
        assert not self._listener.is_alive()
        os.close(self._port)

    def _listen(self) -> None:
        while True:
            try:
                piece = os.read(self._port, 4096)
            except OSError:
                return
            if not piece:
                return
            self._answers += piece
            self.ready()
