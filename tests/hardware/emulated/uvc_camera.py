"""A USB video class camera whose exposure takes effect a few frames late, as real ones do."""

from __future__ import annotations

import io
import struct
import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from emulated.usb_device import Setup, UsbDevice, configuration, interface

TAIL = bytes.fromhex("00001000800000aa00389b71")
FORMATS = {1: (b"Y800" + TAIL, 1), 2: (b"Y16 " + TAIL, 2)}
MJPEG = 3
CAMERA_TERMINAL, AUTO_EXPOSURE, EXPOSURE_TIME = 1, 2, 4
MANUAL, APERTURE_PRIORITY = 1, 8
SET_CUR, GET_CUR, GET_MIN, GET_MAX, GET_RES, GET_LEN, GET_INFO, GET_DEF = (
    *(0x01, 0x81, 0x82, 0x83, 0x84),
    *(0x85, 0x86, 0x87),
)
UNIT_S = 100e-6
PROBE, COMMIT = 1, 2
BULK_IN = 1

Light = Callable[[], NDArray[np.float64]]


class UvcCamera(UsbDevice):
    """Y800, Y16 and MJPEG over bulk; manual exposure in units of 100 us.

    ``light()`` is counts a second of the 8-bit scale, (rows, cols); ``delay`` is how many whole
    frames still have the old exposure after a new one was set.
    """

    product_id = 0x00CA
    device_class = (0xEF, 2, 1)
    strings = ("labrig", "emulated UVC camera", "UVC0001")

    def __init__(
        self, light: Light, *, width: int = 320, height: int = 240, fps: int = 10, delay: int = 2
    ) -> None:
        super().__init__()
        self._light, self._size, self._delay = light, (width, height), delay
        self._interval = int(1e7 / fps)
        self._lock = threading.Lock()
        self._run = 0
        self._chosen, self._payload, self._toggle = 1, b"", 0
        self._auto, self._exposure = APERTURE_PRIORITY, 156
        self._pipeline: deque[int] = deque([156] * (delay + 1), maxlen=delay + 1)
        self.exposures: list[float] = []  # of every frame sent, s
        self.config = self._descriptors()

    def control(self, setup: Setup, sent: bytes) -> bytes | None:
        """Answer the class requests of the video interfaces."""
        if setup.index & 0xFF == 1:
            return self._stream_control(setup, sent)
        if setup.index >> 8 != CAMERA_TERMINAL:
            return None
        if setup.value >> 8 == AUTO_EXPOSURE:
            return self._auto_exposure(setup, sent)
        return self._exposure_time(setup, sent) if setup.value >> 8 == EXPOSURE_TIME else None

    def bulk_in(self, endpoint: int, length: int) -> bytes | None:
        """Return the next piece of a frame."""
        with self._lock:
            if not self._payload:
                return None
            piece, self._payload = self._payload[:length], self._payload[length:]
            return piece

    def clear_halt(self, endpoint: int) -> None:
        """Stop streaming: this is how the host ends a bulk stream."""
        with self._lock:
            self._run += 1
            self._payload = b""

    def _auto_exposure(self, setup: Setup, sent: bytes) -> bytes | None:
        if setup.request == SET_CUR:
            self._auto = sent[0]
            return b""
        answers = {
            GET_CUR: self._auto,
            GET_DEF: APERTURE_PRIORITY,
            GET_RES: MANUAL | APERTURE_PRIORITY,
            GET_INFO: 3,
            GET_MIN: MANUAL,
            GET_MAX: APERTURE_PRIORITY,
        }
        return bytes([answers[setup.request]]) if setup.request in answers else b"\1\0"

    def _exposure_time(self, setup: Setup, sent: bytes) -> bytes | None:
        if setup.request == SET_CUR:
            if self._auto != MANUAL:
                return None
            self._exposure = int.from_bytes(sent, "little")
            return b""
        if setup.request == GET_INFO:
            return b"\3"
        if setup.request == GET_LEN:
            return b"\4\0"
        values = {GET_CUR: self._exposure, GET_DEF: 156, GET_MIN: 1, GET_MAX: 10000, GET_RES: 1}
        return struct.pack("<I", values[setup.request])

    def _stream_control(self, setup: Setup, sent: bytes) -> bytes | None:
        if setup.request == SET_CUR:
            self._chosen = min(max(sent[2], 1), MJPEG)
            if setup.value >> 8 == COMMIT:
                with self._lock:
                    self._run += 1
                    run = self._run
                threading.Thread(target=self._stream, args=(run,), daemon=True).start()
            return b""
        width, height = self._size
        n_bytes = width * height * FORMATS.get(self._chosen, FORMATS[1])[1]
        probe = struct.pack(
            "<HBBIHHHHHII", 1, self._chosen, 1, self._interval, 0, 0, 0, 0, 0, n_bytes, n_bytes + 2
        )
        if setup.request in (GET_CUR, GET_MIN, GET_MAX, GET_DEF):
            return probe
        return {GET_INFO: b"\3", GET_LEN: struct.pack("<H", len(probe))}.get(setup.request)

    def _stream(self, run: int) -> None:
        while run == self._run:
            self._pipeline.append(self._exposure)
            exposure_s = self._pipeline[0] * UNIT_S
            picture = self._encoded(np.clip(self._light() * exposure_s, 0, 255))
            with self._lock:
                if run != self._run:
                    return
                self._toggle ^= 1
                self._payload = bytes([2, 0x82 | self._toggle]) + picture
                self.exposures.append(exposure_s)
            self.ready()
            end = time.monotonic() + 5.0
            while self._payload and run == self._run and time.monotonic() < end:
                time.sleep(0.002)
            time.sleep(self._interval * 1e-7)

    def _encoded(self, counts: NDArray[np.float64]) -> bytes:
        if self._chosen == MJPEG:
            out = io.BytesIO()
            Image.fromarray(np.rint(counts).astype(np.uint8)).save(out, "JPEG", quality=95)
            return out.getvalue()
        kind, scale = ("u1", 1) if self._chosen == 1 else ("<u2", 257)
        return np.rint(counts * scale).astype(kind).tobytes()

    def _descriptors(self) -> bytes:
        width, height = self._size
        header = struct.pack("<BBBHHIBB", 13, 0x24, 1, 0x0100, 40, 1000000, 1, 1)
        terminal = struct.pack(
            "<BBBBHBBHHHB3s", 18, 0x24, 2, CAMERA_TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3, b"\x0a\0\0"
        )
        output = struct.pack("<BBBBHBBB", 9, 0x24, 3, 3, 0x0101, 0, CAMERA_TERMINAL, 0)
        control = header + terminal + output
        control = control[:5] + struct.pack("<H", len(control)) + control[7:]
        described = b""
        for index, (guid, n_bytes) in FORMATS.items():
            size, bits = width * height * n_bytes, 8 * n_bytes
            described += struct.pack(
                "<BBBBB16sBBBBBB", 27, 0x24, 4, index, 1, guid, bits, 1, 0, 0, 0, 0
            )
            described += self._frame_descriptor(5, size)
        described += struct.pack("<11B", 11, 0x24, 6, MJPEG, 1, 0, 1, 0, 0, 0, 0)
        described += self._frame_descriptor(7, width * height)
        head = struct.pack(
            *("<BBBBHBBBBBBBBBB", 16, 0x24, 1, MJPEG, 16 + len(described), 0x81, 0, 3),
            *(0, 0, 0, 1, 0, 0, 0),
        )
        association = struct.pack("<8B", 8, 11, 0, 2, 0x0E, 3, 0, 0)
        body = association + interface(0, [], (0x0E, 1, 0), control)
        body += interface(1, [0x81], (0x0E, 2, 0), head + described)
        return configuration(2, body)

    def _frame_descriptor(self, kind: int, size: int) -> bytes:
        width, height = self._size
        return struct.pack(
            *("<BBBBBHHIIIIBI", 30, 0x24, kind, 1, 0, width, height, size * 80, size * 80),
            *(size, self._interval, 1, self._interval),
        )
