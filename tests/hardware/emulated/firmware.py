"""The trigger's reference firmware, compiled for this host and running behind a pty."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
SKETCH = HERE.parents[2] / "drivers" / "trigger" / "firmware" / "labrig_trigger"
SHIM = HERE / "firmware_shim"
TRIGGER_PIN = 8


@dataclass(frozen=True)
class Edge:
    """One edge of an output pin on the host's monotonic clock."""

    pin: int
    high: bool
    at_s: float


def compile_firmware(folder: Path) -> Path:
    """Return the program made of the sketch and the shim; warnings are errors."""
    program = folder / "firmware_host"
    flags = ["-Wall", "-Wextra", "-Werror", "-O1", f"-I{SHIM}", f"-I{SKETCH}"]
    sketch = ["-include", "Arduino.h", "-x", "c++", str(SKETCH / "labrig_trigger.ino")]
    others = [*map(str, sorted(SKETCH.glob("*.cpp"))), str(SHIM / "host.cpp")]
    subprocess.run(["g++", *flags, *sketch, *others, "-o", str(program)], check=True)
    return program


class Box:
    """A trigger box: its port, the edges of its pins, and hands on its wires."""

    def __init__(self, program: Path, *, micros_at_start: int = 0) -> None:
        self._process = subprocess.Popen(
            [str(program), str(micros_at_start)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        assert self._process.stdout is not None
        self.port = self._process.stdout.readline().strip()
        assert self.port.startswith("/dev/pts/")

    def strobe(self) -> None:
        """Give an edge on the wire from the camera's strobe."""
        self._tell("s")

    def sync(self) -> None:
        """Give an edge on the wire from the projector's sync."""
        self._tell("y")

    def answer_pulses(self) -> None:
        """From now on the camera answers every pulse with a strobe."""
        self._tell("e")

    def halt(self) -> None:
        """Stop the processor: the port stays, nothing answers."""
        self._tell("h")
        time.sleep(0.02)

    def unplug(self) -> list[Edge]:
        """Take the box away; return the edges its pins made."""
        self._process.kill()
        return self._edges()

    def stop(self) -> list[Edge]:
        """End the program in good order; return the edges its pins made."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        return self._edges()

    def _tell(self, order: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(order)
        self._process.stdin.flush()

    def _edges(self) -> list[Edge]:
        assert self._process.stdout is not None
        if self._process.stdout.closed:
            return []
        with self._process.stdout as out:
            lines = [line.split() for line in out]
        self._process.wait(timeout=60)
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        return [
            Edge(pin=int(pin), high=level == "1", at_s=int(at_us) * 1e-6)
            for pin, level, at_us in lines
        ]
