"""The simulated world: what the projector shows, and the light that then falls on the sensor."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulation.clock import VirtualClock

Image = NDArray[np.uint8]
Light = Callable[[Image | None, float], NDArray[np.float64]]
"""From what the projector shows (None: off) and its black level to electrons/s on the sensor."""


@dataclass
class World:
    """Projector, sample and camera under one clock.

    Attributes
    ----------
    light : the sample's answer to a projector image; given by the rig, for a driver knows no optics
    projector_black : light of a black pixel as a share of a white one
    covered : the camera wears its cap
    """

    light: Light
    projector_black: float = 0.0
    clock: VirtualClock = field(default_factory=VirtualClock)
    covered: bool = False
    _changes_s: list[float] = field(default_factory=lambda: [-np.inf])
    _shown: list[Image | None] = field(default_factory=lambda: [None])

    def project(self, image: Image | None, *, at_s: float) -> None:
        """Let the projector's light change to ``image`` at an instant, not before the last one."""
        self._changes_s.append(max(at_s, self._changes_s[-1]))
        self._shown.append(image)

    def expose(self, begin_s: float, end_s: float) -> NDArray[np.float64]:
        """Return the electrons collected between two instants, (rows, cols), without noise.

        A change of pattern within the exposure mixes both, as it does in a real camera.
        """
        first = bisect_right(self._changes_s, begin_s) - 1
        total: NDArray[np.float64] | None = None
        for k in range(first, len(self._shown)):
            start = max(self._changes_s[k], begin_s)
            stop = min(self._changes_s[k + 1] if k + 1 < len(self._shown) else end_s, end_s)
            if stop <= start:
                continue
            electrons = self.light(self._shown[k], self.projector_black) * (stop - start)
            total = electrons if total is None else total + electrons
        if total is None:
            total = np.zeros_like(self.light(None, self.projector_black))
        return np.zeros_like(total) if self.covered else total
