"""The projector's lamp: uneven across the beam, drifting, flickering with the colour wheel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from drivers.simulation.lamp import Lamp
from labrig.models.effects import ColourWheelConfig, LampDriftConfig, LampShapeConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Parts

POINTS = 33  # of the parabola, straight in between: its error is falloff / 4000


class LampShape(Effect[LampShapeConfig]):
    """The beam falls from its middle to its edges as a parabola."""

    kind, cost = "transport", "an answer of its own"

    def bound(self, about: Situation) -> Bound:  # noqa: ARG002
        """Return the light missing at the edges: nothing loses a larger share."""
        falloff = self.parameters.falloff
        return Bound(falloff, f"edges are darker by {falloff:g}")

    def onto(self, parts: Parts) -> Parts:
        """Multiply the beam's profile by the parabola."""
        beam = parts.scene.beam
        y = np.linspace(beam.from_mm, beam.to_mm, POINTS)
        if beam.profile is not None:
            y = np.union1d(y, [height for height, _ in beam.profile])
        middle, half = 0.5 * (beam.from_mm + beam.to_mm), 0.5 * (beam.to_mm - beam.from_mm)
        shape = 1.0 - self.parameters.falloff * ((y - middle) / half) ** 2
        irradiance = shape * np.interp(y, *beam.record().profile_points())
        profile = tuple(zip(y.tolist(), irradiance.tolist(), strict=True))
        lit = beam.model_copy(update={"profile": profile})
        return replace(parts, scene=parts.scene.model_copy(update={"beam": lit}))


class LampDrift(Effect[LampDriftConfig]):
    """The lamp warms up and drifts."""

    kind, cost = "lamp", "a closed integral for each exposure"

    def _lamp(self, rig_lamp: Lamp) -> Lamp:
        given = {k: v for k, v in self.parameters.model_dump().items() if v is not None}
        return replace(rig_lamp, flicker=0.0, **given)

    def bound(self, about: Situation) -> Bound:
        """Return how far the lamp is from one at most while the session lasts."""
        lamp = self._lamp(Lamp(**about.rig.simulation.lamp.model_dump()))
        hours = (about.duration_s + 1.0) / 3600.0
        most = lamp.cold_share + abs(lamp.drift_per_h) * hours
        why = f"the lamp leaves its brightness by {most:.2g} within {about.duration_s:.0f} s"
        return Bound(most, why)

    def onto(self, parts: Parts) -> Parts:
        """Let the lamp drift, without its flicker."""
        own = self._lamp(Lamp(**parts.rig.simulation.lamp.model_dump()))
        return replace(parts, lamp=replace(own, flicker=parts.lamp.flicker))


class ColourWheel(Effect[ColourWheelConfig]):
    """Light flickers as sin(2 pi f t), and an exposure sees its mean."""

    kind, cost = "lamp", "a closed integral for each exposure"

    def _flicker(self, about: Situation | Parts) -> tuple[float, float]:
        own, rig = self.parameters, about.rig.simulation.lamp
        return (
            rig.flicker if own.flicker is None else own.flicker,
            rig.flicker_hz if own.flicker_hz is None else own.flicker_hz,
        )

    def bound(self, about: Situation) -> Bound:
        """Return the largest mean of the sine over the shortest exposure: 1 / (pi f t)."""
        flicker, hz = self._flicker(about)
        mean = min(1.0, 1.0 / (math.pi * hz * about.exposures_s[0]))
        if not flicker:
            return Bound(0.0, "the light does not flicker")
        most = flicker * mean
        why = f"{mean:.2g} of the flicker is left of it by {about.exposures_s[0]:g} s at {hz:g} Hz"
        return Bound(most, why)

    def onto(self, parts: Parts) -> Parts:
        """Let the light flicker."""
        flicker, hz = self._flicker(parts)
        return replace(parts, lamp=replace(parts.lamp, flicker=flicker, flicker_hz=hz))
