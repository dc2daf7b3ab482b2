"""Scattered light that comes back: from the lit face, and from walls that are not black."""

from __future__ import annotations

import math
from dataclasses import replace

from labrig.models.effects import InternalReflectionConfig, WallsConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Parts


def _sent_back(about: Situation, reflectance: float) -> float:
    """Return a bound of what walls change that give back a share of the light at most.

    Unfolded at the walls, light goes on in mirrored tanks: a bounce then keeps at most
    albedo times the phase function's power, and each is changed by at most the share.
    """
    medium = about.scene.medium.record()
    kept = about.kept / max(-math.expm1(-medium.sigma_t_per_mm * _longest(about)), 1e-300)
    return math.inf if kept >= 1.0 else reflectance * kept / (1.0 - kept) ** 2


def _longest(about: Situation) -> float:
    return math.hypot(about.scene.tank.depth_mm, about.scene.tank.width_mm)


class InternalReflection(Effect[InternalReflectionConfig]):
    """The lit face reflects scattered light from inside (Fresnel), beyond the critical angle all.

    The face is a bare surface to air; a thin pane between changes the critical angle in nothing.
    """

    kind = "transport"
    cost = "an answer of its own, whose paths are folded at the face"

    def bound(self, about: Situation) -> Bound:
        """Return what it changes if the face sent all light back."""
        if self.parameters.index == 1.0 or about.scene.medium.sigma_s_per_mm == 0.0:
            return Bound(0.0, "nothing turns back")
        return Bound(2.0 * _sent_back(about, 1.0), "as if all light turned back")

    def onto(self, parts: Parts) -> Parts:
        """Give the face its index."""
        return replace(parts, face_index=self.parameters.index)


class Walls(Effect[WallsConfig]):
    """The other walls are mirrors of a reflectance, for the beam and for what it scatters."""

    kind = "transport"
    cost = "an answer of its own, whose paths are folded at the walls"

    def bound(self, about: Situation) -> Bound:
        """Return what of beam and scattered light comes back at most."""
        own = self.parameters.reflectance
        if own == 0.0:
            return Bound(0.0, "the walls are black")
        beam = about.scene.beam_inside()
        way = about.scene.tank.depth_mm
        if beam.angle_deg:
            sine = abs(math.sin(math.radians(beam.angle_deg)))
            aside = min(beam.from_mm, about.scene.tank.width_mm - beam.to_mm)
            way = min(way, max(aside, 0.0) / sine)
        left = math.exp(-about.scene.medium.sigma_t_per_mm * way)
        beam_back = own * left / (1.0 - own * left)
        scattered = 0.0
        if about.scene.medium.sigma_s_per_mm:
            scattered = 2.0 * (1.0 + beam_back) * _sent_back(about, own)
        return Bound(2.0 * beam_back + scattered, f"walls give back {own:g}")

    def onto(self, parts: Parts) -> Parts:
        """Give the walls their reflectance."""
        return replace(parts, wall_reflectance=self.parameters.reflectance)
