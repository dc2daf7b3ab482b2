"""A GigE Vision camera on the loopback interface whose picture Python computes.

Run as ``python -m emulated.gige_camera SERIAL MODULE:FACTORY ARGUMENT``: the factory is called with
the argument and returns ``scene(exposure_s, rows, cols)``, light as a share of full scale.
"""

from __future__ import annotations

import ctypes as ct
import fcntl
import importlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Scene = Callable[[float, int, int], NDArray[np.float64]]
FULL_SCALE_EXPOSURE_S = 0.02
WIDTH_REGISTER, HEIGHT_REGISTER = 0x100, 0x104
MONO16 = 0x01100007
DARK_SHARE = 0.02


def stripes_scene(_argument: str) -> Scene:
    """Return stripes of eight pixels that fill the scale in 20 ms."""

    def scene(exposure_s: float, rows: int, cols: int) -> NDArray[np.float64]:
        lit = np.arange(cols) // 8 % 2 * exposure_s / FULL_SCALE_EXPOSURE_S
        return np.broadcast_to(lit + DARK_SHARE, (rows, cols))

    return scene


def serve(serial: str, scene: Scene) -> None:
    """Be the camera until the process is ended."""
    import gi  # noqa: PLC0415 - only in the camera's own process

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis  # noqa: PLC0415

    lib = ct.CDLL("libaravis-0.8.so.0")
    lib.arv_buffer_get_data.restype = ct.c_void_p
    lib.arv_buffer_get_data.argtypes = [ct.c_void_p, ct.POINTER(ct.c_size_t)]
    filler = ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p, ct.c_uint32, ct.c_uint32, ct.c_uint32)
    lib.arv_fake_camera_set_fill_pattern.argtypes = [ct.c_void_p, filler, ct.c_void_p]
    camera = Aravis.GvFakeCamera.new("127.0.0.1", serial)
    fake = camera.get_fake_camera()

    def register(address: int) -> int:
        return int(fake.read_register(address)[-1])

    @filler
    def fill(buffer, _user, exposure_us, _gain, pixel_format):
        exposure_s = exposure_us * 1e-6
        time.sleep(exposure_s)
        full, kind = (65535, "<u2") if pixel_format == MONO16 else (255, "u1")
        rows, cols = register(HEIGHT_REGISTER), register(WIDTH_REGISTER)
        light = np.clip(scene(exposure_s, rows, cols), 0.0, 1.0)
        counts = np.ascontiguousarray(np.rint(light * full), dtype=kind)
        size = ct.c_size_t()
        where = lib.arv_buffer_get_data(buffer, ct.byref(size))
        ct.memmove(where, counts.ctypes.data, counts.nbytes)

    # Through gi the callback would be freed after this call and never run.
    lib.arv_fake_camera_set_fill_pattern(hash(fake), fill, None)
    sys.stdout.write("serving\n" if camera.is_running() else "no network\n")
    sys.stdout.flush()
    while True:
        time.sleep(60)


class GigeCamera:
    """The camera in a process of its own, for with its client in one process it may hang.

    GigE Vision has one port and the loopback interface one address, so a second camera would
    answer for the first: this machine has one at a time, others wait.
    """

    def __init__(self, serial: str, scene: str = "emulated.gige_camera:stripes_scene", *args: str):
        self._lock = (Path(tempfile.gettempdir()) / "labrig-emulated-gige.lock").open("a")
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        self._command = [sys.executable, "-m", "emulated.gige_camera", serial, scene, *args]
        self.serial = serial
        try:
            self.plug()
        except BaseException:
            self._lock.close()  # or the next one would wait for it for ever
            raise

    def plug(self) -> None:
        """Start the camera."""
        folder = str(Path(__file__).resolve().parents[1])
        self._process = subprocess.Popen(
            self._command,
            env={**os.environ, "PYTHONPATH": folder},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        assert answer == "serving\n", f"the emulated GigE camera said {answer!r}"

    def unplug(self) -> None:
        """Take the camera away; harmless if done twice."""
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def stop(self) -> None:
        """Take it away for good: another may be plugged in."""
        self.unplug()
        self._lock.close()


if __name__ == "__main__":
    module, _, factory = sys.argv[2].partition(":")
    make = getattr(importlib.import_module(module), factory)
    serve(sys.argv[1], make(sys.argv[3] if len(sys.argv) > 3 else ""))
