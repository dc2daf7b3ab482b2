"""The simulated world: what the projector shows, and the light that then falls on the sensor."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulation.clock import VirtualClock
from drivers.simulation.faults import FaultScript
from drivers.simulation.lamp import Lamp
from drivers.waiting import Clock

Image = NDArray[np.uint8]
Electrons = NDArray[np.float64]
Light = Callable[[Image | None, float], Electrons]
"""From what the projector shows (None: off) and its black level to electrons/s on the sensor."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """What is to be seen from an instant on."""

    from_s: float
    image: Image | None
    covered: bool


@dataclass
class World:
    """Projector, sample and camera under one clock.

    Attributes
    ----------
    light : the sample's answer to a projector image; given by the rig, for a driver knows no optics
    projector_black : light of a black pixel as a share of a white one
    clock : virtual, or the host's own where a test measures real time
    lamp : brightness of the projector over time; ambient light has none of it
    fade_s : time constant with which one picture gives way to the next; 0 is at once
    faults : what shall go wrong; it also knows which shot is being taken
    """

    light: Light
    projector_black: float = 0.0
    clock: Clock = field(default_factory=VirtualClock)
    lamp: Lamp = field(default_factory=Lamp)
    fade_s: float = 0.0
    faults: FaultScript = field(default_factory=FaultScript)
    _shown: list[_Shown] = field(default_factory=lambda: [_Shown(-np.inf, None, False)])
    _on_edge: list[Callable[[float], None]] = field(default_factory=list)

    @property
    def covered(self) -> bool:
        """Whether the camera wears its cap."""
        return self._shown[-1].covered

    @covered.setter
    def covered(self, covered: bool) -> None:
        now, last = self.clock.now_s(), self._shown[-1]
        self._shown.append(_Shown(max(now, last.from_s), last.image, covered))

    def project(self, image: Image | None, *, at_s: float) -> None:
        """Let the projector's light change to ``image`` at an instant, not before the last one."""
        last = self._shown[-1]
        self._shown.append(_Shown(max(at_s, last.from_s), image, last.covered))

    @property
    def showing(self) -> tuple[Image | None, bool]:
        """What the projector shows at this instant, None if it is off; whether the cap is on."""
        now = self.clock.now_s()
        shown = self._shown[bisect_right(self._shown, now, key=lambda s: s.from_s) - 1]
        return shown.image, shown.covered

    def listen(self, camera: Callable[[float], None]) -> None:
        """Wire a camera's trigger input to the trigger box."""
        self._on_edge.append(camera)

    def edge(self, at_s: float) -> None:
        """Let the trigger box's line rise at an instant."""
        for camera in self._on_edge:
            camera(at_s)

    def expose(self, begin_s: float, exposure_s: float, row_time_s: float = 0.0) -> Electrons:
        """Return the electrons collected by an exposure, (rows, cols), without noise.

        A change of pattern within the exposure mixes both, as it does in a real camera. Row r
        of a rolling shutter begins ``r * row_time_s`` later.
        """
        dark = self.light(None, self.projector_black)
        delays_s = np.arange(dark.shape[0]) * row_time_s if row_time_s else np.zeros(1)
        total = np.zeros(dark.shape)
        begins_s = np.asarray(begin_s + delays_s, dtype=np.float64)
        first = bisect_right(self._shown, begin_s, key=lambda s: s.from_s) - 1
        for k in range(max(first - 1, 0), len(self._shown)):
            shown = self._shown[k]
            if shown.from_s >= begins_s[-1] + exposure_s:
                break
            if shown.covered:
                continue
            lit_s, seen_s = self._share(k, begins_s, exposure_s)
            if not (lit_s.any() or seen_s.any()):
                continue
            light = self.light(shown.image, self.projector_black)
            if lit_s is seen_s and (seen_s == exposure_s).all():
                return light * exposure_s
            total += lit_s[:, None] * (light - dark) + seen_s[:, None] * dark
        return total

    def _share(
        self, k: int, begins_s: NDArray[np.float64], exposure_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how long each row saw picture k: weighted by lamp and fading, and plainly, s."""
        start = self._shown[k].from_s
        stop = self._shown[k + 1].from_s if k + 1 < len(self._shown) else np.inf
        ends_s = begins_s + exposure_s
        low, high = np.maximum(begins_s, start), np.minimum(ends_s, stop)
        whole = (begins_s >= start) & (ends_s <= stop)
        # an undisturbed exposure must not depend on when it was: its rounding would
        seen = np.where(whole, exposure_s, np.maximum(high - low, 0.0))
        lit = seen
        if not self.lamp.steady:
            lit = np.array(
                [
                    self.lamp.integral_s(a, b) if b > a else 0.0
                    for a, b in zip(low, high, strict=True)
                ]
            )
        if self.fade_s > 0.0:
            lit = lit - self._fading(start, low, high) + self._fading(stop, begins_s, ends_s)
        return lit, seen

    def _fading(
        self, change_s: float, low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the seconds between low and high that belong to the picture before a change."""
        if not np.isfinite(change_s):
            return np.zeros_like(low)
        low, high = np.maximum(low, change_s), np.maximum(high, change_s)
        past = self.fade_s * (
            np.exp((change_s - low) / self.fade_s) - np.exp((change_s - high) / self.fade_s)
        )
        return np.where((change_s - low) / self.fade_s < -40.0, 0.0, past)
