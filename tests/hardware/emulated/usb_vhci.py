"""Plugs an emulated device into the kernel's virtual USB host controller (module vhci-hcd).

The kernel speaks the USB/IP protocol over one end of a socket pair; no network, no tools.
"""

from __future__ import annotations

import errno
import queue
import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path

from emulated.usb_device import Setup, UsbDevice

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
SUBMIT, UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
HIGH_SPEED = 3
FREE_PORT = "004"


class VirtualPort:
    """Where a device is plugged into the virtual controller."""

    def __init__(self, device: UsbDevice) -> None:
        self._device = device
        self._pending: list[tuple[int, int, int]] = []
        self._lock = threading.RLock()
        self._events: queue.Queue[bool] = queue.Queue()
        device.ready = lambda: self._events.put(True)
        self._near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        for work in (self._serve, self._pump):
            threading.Thread(target=work, daemon=True).start()
        lines = [line.split() for line in (CONTROLLER / "status").read_text().splitlines()[1:]]
        self._port = next(int(f[1]) for f in lines if f[0] == "hs" and f[2] == FREE_PORT)
        (CONTROLLER / "attach").write_text(f"{self._port} {far.fileno()} 1 {HIGH_SPEED}")
        far.close()

    def unplug(self) -> None:
        """Take the device out."""
        with suppress(OSError):
            (CONTROLLER / "detach").write_text(str(self._port))
        self._events.put(False)
        with suppress(OSError):
            self._near.shutdown(socket.SHUT_RDWR)
        self._near.close()

    def _serve(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                head = self._receive(48)
                command, number, _, to_host, endpoint = struct.unpack_from(">5I", head)
                if command == SUBMIT:
                    length = struct.unpack_from(">i", head, 24)[0]
                    sent = b"" if to_host else self._receive(length)
                    self._submit(number, endpoint, bool(to_host), length, head[40:48], sent)
                else:
                    self._unlink(number, struct.unpack_from(">I", head, 20)[0])

    def _submit(
        self, number: int, endpoint: int, to_host: bool, length: int, setup: bytes, sent: bytes
    ) -> None:
        if endpoint == 0:
            asked = Setup.parse(setup)
            answer = self._device.setup(asked, sent)
            if answer is None:
                self._return(number, -errno.EPIPE, b"", 0)
            elif asked.to_host:
                self._return(number, 0, answer[: asked.length], len(answer[: asked.length]))
            else:
                self._return(number, 0, b"", len(sent))
        elif to_host:
            with self._lock:
                self._pending.append((number, endpoint, length))
            self._events.put(True)
        else:
            taken = self._device.bulk_out(endpoint, sent)
            self._return(number, 0 if taken else -errno.EPIPE, b"", len(sent) if taken else 0)

    def _unlink(self, number: int, victim: int) -> None:
        with self._lock:
            hit = [p for p in self._pending if p[0] == victim]
            self._pending = [p for p in self._pending if p[0] != victim]
            status = -errno.ECONNRESET if hit else 0
            self._near.sendall(struct.pack(">5Ii24x", RET_UNLINK, number, 0, 0, 0, status))

    def _pump(self) -> None:
        while self._events.get():
            with self._lock, suppress(OSError):
                for pending in list(self._pending):
                    number, endpoint, length = pending
                    answer = self._device.bulk_in(endpoint, length)
                    if answer is not None:
                        self._pending.remove(pending)
                        self._return(number, 0, answer, len(answer))

    def _return(self, number: int, status: int, content: bytes, length: int) -> None:
        head = struct.pack(">5I5i8x", RET_SUBMIT, number, 0, 0, 0, status, length, 0, 0, 0)
        with self._lock:
            self._near.sendall(head + content)

    def _receive(self, n: int) -> bytes:
        got = b""
        while len(got) < n:
            piece = self._near.recv(n - len(got))
            if not piece:
                raise EOFError
            got += piece
        return got
