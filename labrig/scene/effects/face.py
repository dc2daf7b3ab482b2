"""Where light enters: refraction and loss at the pane, and the spreading of the beam behind it."""

from __future__ import annotations

import math
from dataclasses import replace

from labrig.models.effects import DivergenceConfig, FresnelConfig, RefractionConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.fresnel import reflectances
from labrig.scene.parts import Parts


class Refraction(Effect[RefractionConfig]):
    """The beam turns at the face by Snell's law; a plane pane between changes nothing of that."""

    kind, cost = "transport", "an answer of its own for a slanted beam"

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

    cost = "a factor"

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

    cost = "a ray for each pixel in place of one for each row"

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
