"""An X server of the test's own, with two named outputs and a frame buffer to look into."""

from __future__ import annotations

import mmap
import os
import struct
import subprocess
import time
from pathlib import Path

import numpy as np
from deadlines import far
from numpy.typing import NDArray

from emulated.needs import need

DESKTOP = (0xC0, 0x80, 0x40)


class FrameBuffer:
    """What an X server shows, read from the file it keeps its picture in."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._memory = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)

    def grab(self, x: int, width: int, height: int) -> NDArray[np.uint8]:
        """Return a part of the top rows, (rows, cols, 3) red, green, blue."""
        fields = struct.unpack_from(">25I", self._memory)
        rows, stride, offset = fields[5], fields[12], fields[0] + 12 * fields[19]
        whole = np.frombuffer(self._memory, np.uint8, rows * stride, offset).reshape(rows, -1, 4)
        return whole[:height, x : x + width, 2::-1].copy()

    def close(self) -> None:
        """Let the file go."""
        self._memory.close()
        self._file.close()


class XServer:
    """Xvfb with a bright desktop of two outputs side by side, ``LEFT`` and ``PROJ``."""

    def __init__(
        self, folder: Path, *, left: tuple[int, int] = (320, 240), right: tuple[int, int]
    ) -> None:
        need("Xvfb", "xrandr", "xsetroot", package="xvfb x11-xserver-utils")
        self.left, self.right = left, right
        width, height = left[0] + right[0], max(left[1], right[1])
        read, write = os.pipe()
        self._process = subprocess.Popen(
            # Without -noreset the outputs are forgotten when the last client leaves.
            f"Xvfb -displayfd {write} -screen 0 {width}x{height}x24 -noreset -nolisten tcp"
            f" -fbdir {folder}".split(),
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as answer:
            self.display = f":{answer.readline().strip()}"
        self.path = folder / "Xvfb_screen0"
        self._frame = FrameBuffer(self.path)
        self._xrandr("LEFT", *left, 0, "screen")
        self._xrandr("PROJ", *right, left[0], "none")
        colour = "#{:02x}{:02x}{:02x}".format(*DESKTOP)
        self.run("xsetroot", "-solid", colour)

    def run(self, *command: str) -> None:
        """Run an X program on this display."""
        subprocess.run(command, check=True, env={**os.environ, "DISPLAY": self.display})

    def grab(self, output: str = "PROJ") -> NDArray[np.uint8]:
        """Return what an output shows, (rows, cols, 3) red, green, blue."""
        width, height = self.right if output == "PROJ" else self.left
        return self._frame.grab(self.left[0] if output == "PROJ" else 0, width, height)

    def shows_desktop(self, output: str = "PROJ") -> bool:
        """Return whether an output shows its bright desktop, but for the pointer's 16 x 16 px."""
        return int((self.grab(output) != DESKTOP).any(axis=2).sum()) <= 256

    def await_black(self) -> bool:
        """Return whether PROJ goes black by itself."""
        end = far()
        while time.monotonic() < end:
            if not self.grab().any():
                return True
            time.sleep(0.01)
        return False

    def stop(self) -> None:
        """End the server."""
        self._process.terminate()
        self._process.wait(timeout=60)
        self._frame.close()

    def _xrandr(self, name: str, width: int, height: int, x: int, output: str) -> None:
        geometry = f"{width}/{width // 4}x{height}/{height // 4}+{x}+0"
        self.run("xrandr", "--setmonitor", name, geometry, output)
