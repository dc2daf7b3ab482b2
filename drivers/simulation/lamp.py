"""A projector's lamp over time: it warms up, drifts and flickers."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """Brightness as a share of the nominal one.

    ``(1 - cold_share exp(-t/warmup_s)) (1 + drift_per_h t/h) (1 + flicker sin(2 pi f t))``, of
    which the products of two small terms are left out.
    """

    cold_share: float = 0.0
    warmup_s: float = 60.0
    drift_per_h: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 100.0

    @property
    def steady(self) -> bool:
        """Whether it is always one."""
        return not (self.cold_share or self.drift_per_h or self.flicker)

    def integral_s(self, begin_s: float, end_s: float) -> float:
        """Return the brightness integrated between two instants since the lamp was lit."""
        turn = 2.0 * math.pi * self.flicker_hz
        warming = self.warmup_s * (
            math.exp(-begin_s / self.warmup_s) - math.exp(-end_s / self.warmup_s)
        )
        return (
            end_s
            - begin_s
            - self.cold_share * warming
            + self.drift_per_h / 3600.0 * (end_s**2 - begin_s**2) / 2.0
            + self.flicker * (math.cos(turn * begin_s) - math.cos(turn * end_s)) / turn
        )
