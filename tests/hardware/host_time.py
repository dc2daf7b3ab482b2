"""What other processes, or the host of a virtual machine, took of a test's time.

Drivers keep deadlines to milliseconds; a machine that lets nobody run for 40 ms does not. On every
core a process sleeps 2 ms at a time and notes what came on top. What a test then demands is of the
time that was its own.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

NAP_S = 0.002
WATCH = f"""
import os, sys, time
os.sched_setaffinity(0, {{int(sys.argv[1])}})
with open(sys.argv[2], "a") as notes:
    print(time.monotonic(), 0.0, file=notes, flush=True)
    while os.getppid() == int(sys.argv[3]):
        begin = time.monotonic()
        time.sleep({NAP_S})
        end = time.monotonic()
        if end - begin > 2 * {NAP_S}:
            print(end, end - begin - {NAP_S}, file=notes, flush=True)
"""


@cache
def _watched() -> tuple[Path, ...]:
    folder = Path(tempfile.mkdtemp(prefix="host-time-"))
    notes = []
    for core in sorted(os.sched_getaffinity(0)):
        path = folder / f"core-{core}"
        child = subprocess.Popen(
            [sys.executable, "-S", "-c", WATCH, str(core), str(path), str(os.getpid())]
        )
        atexit.register(child.kill)
        notes.append(path)
    while not all(path.exists() and path.stat().st_size for path in notes):
        time.sleep(0.01)
    return tuple(notes)


def taken_s(begin_s: float, end_s: float) -> float:
    """Return how long cores let nobody run between two instants, all together."""
    time.sleep(5 * NAP_S)  # the last note may be on its way
    total = 0.0
    for path in _watched():
        for line in path.read_text().splitlines():
            woke_s, late_s = map(float, line.split())
            total += max(min(end_s, woke_s) - max(begin_s, woke_s - late_s), 0.0)
    return total


def own_s(begin_s: float) -> float:
    """Return the seconds since an instant, less what was taken."""
    end_s = time.monotonic()
    return end_s - begin_s - taken_s(begin_s, end_s)


_watched()  # a test must not wait for it
