"""Where light enters: refraction and loss at the pane, and the spreading of the beam behind it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labrig.models.effects import DivergenceConfig, FresnelConfig, RefractionConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Array, Parts


class Refraction(Effect[RefractionConfig]):
    """The beam turns at the face by Snell's law; a plane pane between changes nothing of that."""

    name, kind, cost = "refraction", "transport", "an answer of its own for a slanted beam"

    def bound(self, about: Situation) -> Bound:
        """Return how far the stripes would be displaced at the far wall without it."""
        # Without it the beam would go straight in.
        inside = about.scene.beam_inside().angle_deg
        shift = about.scene.tank.depth_mm * abs(math.tan(math.radians(inside)))
        scale = 1.0 + about.multiple_at_most
        return Bound(scale * about.of_shift(shift), f"{inside:.3f} degrees inside")

    def onto(self, parts: Parts) -> Parts:
        """Turn the beam."""
        inside = parts.scene.beam_inside()
        return replace(parts, scene=parts.scene.model_copy(update={"beam": inside}))


class Fresnel(Effect[FresnelConfig]):
    """Both surfaces of the pane reflect (Fresnel's equations, unpolarised light)."""

    name, cost = "fresnel", "a factor"

    def transmission(self, inside_deg: float) -> float:
        """Return the share of the light that enters the liquid in a direction."""
        own = self.parameters
        outside = math.asin(min(own.index * abs(math.sin(math.radians(inside_deg))), 1.0))
        glass = math.asin(math.sin(outside) / own.glass_index)
        inside = abs(math.radians(inside_deg))
        front = reflectances(1.0, own.glass_index, outside, glass)
        back = reflectances(own.glass_index, own.index, glass, inside)
        # To and fro within the pane, incoherently.
        through = [(1.0 - a) * (1.0 - b) / (1.0 - a * b) for a, b in zip(front, back, strict=True)]
        return 0.5 * sum(through)

    def bound(self, about: Situation) -> Bound:
        """Return the share of the light that is lost."""
        lost = 1.0 - self.transmission(about.scene.beam_inside().angle_deg)
        return Bound(lost, f"{100 * lost:.2f} % turn back")

    def onto(self, parts: Parts) -> Parts:
        """Dim the light that enters."""
        through = self.transmission(parts.scene.beam.angle_deg)
        return replace(parts, transmission=parts.transmission * through)


class Divergence(Effect[DivergenceConfig]):
    """The beam spreads from a point; its light thins out as its tubes widen.

    The single scattering follows each ray. The scattered light is that of the parallel beam,
    stretched and thinned out likewise: right where it has not gone far from where it scattered.
    """

    name, cost = "divergence", "a ray for each pixel in place of one for each row"

    def _distance_mm(self, about: Situation | Parts) -> float:
        half = 0.5 * (about.scene.beam.to_mm - about.scene.beam.from_mm)
        spread = math.tan(math.radians(self.parameters.half_angle_deg))
        return half / spread if spread else math.inf

    def bound(self, about: Situation) -> Bound:
        """Return the displacement of the stripes and the thinning at the far wall."""
        half = 0.5 * (about.scene.beam.to_mm - about.scene.beam.from_mm)
        widening = about.scene.tank.depth_mm / self._distance_mm(about)
        change = about.of_shift(half * widening) + 2.0 * widening
        return Bound(
            change * (1.0 + about.multiple_at_most) if widening else 0.0,
            f"{100 * widening:.2g} % wider at the far wall",
        )

    def onto(self, parts: Parts) -> Parts:
        """Let the beam spread."""
        return replace(parts, divergence_mm=self._distance_mm(parts))


def reflectances(
    n_from: float, n_to: float, angle_from: float, angle_to: float
) -> tuple[float, float]:
    """Return Fresnel's power reflectances of either polarisation, s and p; angles in rad."""
    a, b = math.cos(angle_from), math.cos(angle_to)
    s = (n_from * a - n_to * b) / (n_from * a + n_to * b)
    p = (n_from * b - n_to * a) / (n_from * b + n_to * a)
    return s * s, p * p


def internal_reflectance(index: float, cosine: Array) -> Array:
    """Return the unpolarised reflectance of the liquid's surface to air from inside.

    Parameters
    ----------
    cosine : of the angle to the normal; beyond the critical angle all light turns back
    """
    a = np.abs(cosine)
    sine = index * np.sqrt(np.maximum(1.0 - a**2, 0.0))
    b = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    s = ((index * a - b) / (index * a + b)) ** 2
    p = ((index * b - a) / (index * b + a)) ** 2
    return np.asarray(np.where(sine >= 1.0, 1.0, 0.5 * (s + p)))
