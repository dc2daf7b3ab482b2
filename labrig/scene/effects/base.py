"""What every effect is: a change to the simulated world, and a bound on what it changes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Generic, Literal, TypeVar

import numpy as np

from analysis.phase_function import power_removed
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.scene.parts import Parts

P = TypeVar("P")
Kind = Literal["light", "transport", "lamp", "sensor"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """What a bound is about: scene and rig, and the lit pictures that a plan takes of them.

    Attributes
    ----------
    periods_px : of the stripes
    levels : of the projector's pixels, 0 .. 1, that the patterns show
    exposures_s : of the plan, ascending
    duration_s : of the whole session, at least
    """

    scene: Scene
    rig: Rig
    periods_px: tuple[int, ...]
    levels: tuple[float, ...]
    exposures_s: tuple[float, ...]
    duration_s: float

    @property
    def finest_mm(self) -> float:
        """Period of the finest stripes in the tank; the beam's width without stripes."""
        beam = self.scene.beam
        periods = [n * self.rig.projection.mm_per_px for n in self.periods_px]
        return min([*periods, beam.to_mm - beam.from_mm])

    @property
    def dimmest_e_per_s(self) -> float:
        """Rms over the sensor of the single scattering alone, under the stripes: no less is seen.

        Below it for a beam that leaves the tank, whose light is counted to the wall it hits.
        """
        scene, rig = self.scene, self.rig
        beam = scene.beam_inside()
        slant = math.radians(beam.angle_deg)
        reach = scene.tank.depth_mm
        if slant:
            reach = min(reach, scene.tank.width_mm / (2.0 * abs(math.tan(slant))))
        rate = 2.0 * scene.medium.sigma_t_per_mm / math.cos(slant)
        along = reach if rate == 0.0 else -math.expm1(-rate * reach) / rate
        y, irradiance = beam.record().profile_points()
        across = float(np.trapezoid(irradiance**2, y))
        pixel_mm = rig.geometry.mm_per_px or 1.0
        area = rig.camera.rows * rig.camera.cols * pixel_mm**2
        share = 0.25 if self.periods_px else 1.0  # stripes blurred to an even grey
        return scene.light.peak_e_per_s * math.sqrt(share * along * across / area)

    @property
    def kept(self) -> float:
        """Share of the light that a bounce keeps at most: of what scatters inside the tank."""
        medium, tank = self.scene.medium.record(), self.scene.tank
        longest = math.hypot(tank.depth_mm, tank.width_mm)
        inside = -math.expm1(-medium.sigma_t_per_mm * longest)
        return medium.albedo * power_removed(medium.g, medium.phase) * inside

    @property
    def multiple_at_most(self) -> float:
        """Bound of all multiple scattering, rms over that of the single.

        Order k is the beam moved about and weighted, with weights that add up to at most
        kept^(k-1); moving leaves an rms as it is (Minkowski).
        """
        return math.inf if self.kept >= 1.0 else self.kept / (1.0 - self.kept)

    def of_rms(self, electrons_per_s: float) -> float:
        """Return light as a share of the dimmest picture's rms; unbounded if that is dark."""
        if electrons_per_s == 0.0:
            return 0.0
        dimmest = self.dimmest_e_per_s
        return electrons_per_s / dimmest if dimmest > 0.0 else math.inf

    def of_shift(self, shift_mm: float) -> float:
        """Return the relative rms change of stripes, or a beam's edges, that move by a length.

        Of a picture that is 0 or 1 with two edges a period, 2 shift / period of the places
        change by one, and half of all are one.
        """
        return min(2.0 * math.sqrt(max(shift_mm, 0.0) / self.finest_mm), 1.5)


@dataclass(frozen=True, slots=True)
class Bound:
    """How much an effect changes a lit picture at most, relative rms, and why."""

    value: float
    why: str


class Effect(Generic[P]):
    """An effect with its parameters.

    Attributes
    ----------
    kind : what must be computed anew to see what it changes
    cost : what it costs, in words
    """

    kind: ClassVar[Kind] = "light"
    cost: ClassVar[str]

    def __init__(self, parameters: P) -> None:
        self.parameters = parameters

    def bound(self, about: Situation) -> Bound:
        """Return how much it changes a lit picture at most; zero where there is nothing to do."""
        raise NotImplementedError

    def onto(self, parts: Parts) -> Parts:
        """Return the world with this effect."""
        raise NotImplementedError
