"""A disk that runs full when the simulated world's script says so."""

from __future__ import annotations

import errno
import os

from drivers.simulation.faults import FaultScript
from labrig.session.disk import Disk


class SimulatedDisk(Disk):
    """Takes nothing more once the fault "disk-full" has struck, for as many writes as it says."""

    def __init__(self, faults: FaultScript) -> None:
        self._faults = faults

    def _write(self, descriptor: int, content: memoryview) -> int:
        if self._faults.strikes("disk-full"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super()._write(descriptor, content)
