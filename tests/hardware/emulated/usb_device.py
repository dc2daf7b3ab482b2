"""A USB device in Python: descriptors, control requests, bulk endpoints.

It is plugged in by `emulated.usb_umockdev` (libusb in this process) or by `emulated.usb_vhci` (the
kernel of a virtual machine).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

DEVICE, CONFIGURATION, STRING = 1, 2, 3
HIGH_SPEED_BULK = 512


@dataclass(frozen=True)
class Setup:
    """The eight bytes that begin a control transfer."""

    kind: int
    request: int
    value: int
    index: int
    length: int

    @classmethod
    def parse(cls, raw: bytes) -> Setup:
        """Return the fields of eight bytes."""
        return cls(*struct.unpack("<BBHHH", raw))

    @property
    def to_host(self) -> bool:
        """Whether data flow to the host."""
        return bool(self.kind & 0x80)


def interface(
    number: int, endpoints: list[int], kind: tuple[int, int, int], extra: bytes = b""
) -> bytes:
    """Return the descriptor of an interface with bulk endpoints."""
    head = struct.pack("<9B", 9, 4, number, 0, len(endpoints), *kind, 0)
    tails = [struct.pack("<BBBBHB", 7, 5, e, 2, HIGH_SPEED_BULK, 0) for e in endpoints]
    return head + extra + b"".join(tails)


def configuration(n_interfaces: int, body: bytes) -> bytes:
    """Return a configuration descriptor around its interfaces."""
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), n_interfaces, 1, 0, 0x80, 250) + body


class UsbDevice:
    """What all emulated devices share; a subclass answers `control`, `bulk_out` and `bulk_in`."""

    vendor_id = 0x1209
    product_id = 0x0001
    device_class = (0xFF, 0, 0)
    strings: tuple[str, ...] = ("labrig", "emulated device", "E0001")
    config = b""

    def __init__(self) -> None:
        self.ready: Callable[[], None] = lambda: None  # called when a bulk IN may be answered

    def device_descriptor(self) -> bytes:
        """Return the 18 bytes that say what it is."""
        numbers = (self.vendor_id, self.product_id, 0x0100)
        return struct.pack(
            "<BBHBBBBHHHBBBB", 18, 1, 0x0200, *self.device_class, 64, *numbers, 1, 2, 3, 1
        )

    def setup(self, setup: Setup, sent: bytes) -> bytes | None:
        """Answer a control transfer; None stalls."""
        if setup.kind == 0x80 and setup.request == 6:
            return self._descriptor(setup.value >> 8, setup.value & 0xFF)
        if setup.kind in (0x80, 0x81, 0x82) and setup.request == 0:
            return b"\0\0"
        if setup.kind < 3 and setup.request in (1, 3, 9, 11):
            if setup.request == 1 and setup.kind == 2:
                self.clear_halt(setup.index)
            return b""
        return self.control(setup, sent)

    def control(self, setup: Setup, sent: bytes) -> bytes | None:
        """Answer a request of its own class; None stalls."""
        return None

    def bulk_out(self, endpoint: int, sent: bytes) -> bool:
        """Take bytes; False stalls."""
        return False

    def bulk_in(self, endpoint: int, length: int) -> bytes | None:
        """Return bytes; None if there are none yet."""
        return None

    def clear_halt(self, endpoint: int) -> None:
        """Begin anew after a stall."""

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == DEVICE:
            return self.device_descriptor()
        if kind == CONFIGURATION:
            return self.config
        if kind == STRING and index == 0:
            return struct.pack("<BBH", 4, 3, 0x0409)
        if kind == STRING and index <= len(self.strings):
            text = self.strings[index - 1].encode("utf-16le")
            return struct.pack("<BB", len(text) + 2, 3) + text
        return None
