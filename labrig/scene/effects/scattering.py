"""Scattering: once, many times, and into all directions alike or not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from analysis.phase_function import phase_function, power_removed
from labrig.models.effects import Word
from labrig.models.scene import MediumConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Parts


def scattering_evenly(medium: MediumConfig) -> MediumConfig:
    """Return the medium without preferred direction, each bounce keeping the light it keeps."""
    power = power_removed(medium.g, medium.phase)
    even = {"g": 0.0, "phase": "hg-plane", "sigma_s_per_mm": medium.sigma_s_per_mm * power}
    return medium.model_copy(update=even)


class Single(Effect[Word]):
    """The beam, scattered once towards the camera: what stripes are seen by."""

    cost = "a few operations for each pixel"

    def bound(self, about: Situation) -> Bound:  # noqa: ARG002
        """Return all of the light."""
        return Bound(math.inf, "without it there is no picture")

    def onto(self, parts: Parts) -> Parts:
        """Light the beam."""
        return replace(parts, single=True)


class Multiple(Effect[Word]):
    """Light scattered twice and more, order by order."""

    kind, cost = "transport", "the solution of transport, once"

    def bound(self, about: Situation) -> Bound:
        """Return the geometric series of what each bounce keeps at most."""
        kept = about.kept
        return Bound(2.0 * about.multiple_at_most, f"a bounce keeps at most {kept:.3g}")

    def onto(self, parts: Parts) -> Parts:
        """Let light scatter again."""
        return replace(parts, multiple=parts.scene.medium.sigma_s_per_mm > 0.0)


class Anisotropy(Effect[Word]):
    """Light keeps its direction with a mean cosine of g; without, it scatters evenly."""

    kind, cost = "transport", "moments of the light over direction"

    def bound(self, about: Situation) -> Bound:
        """Return by how much the orders can differ from those of even scattering.

        Each of the k - 1 scatterings of order k moves at most the share by which the phase
        functions differ.
        """
        medium = about.scene.medium
        if medium.sigma_s_per_mm == 0.0:
            return Bound(0.0, "nothing scatters again")
        theta = 2.0 * np.pi * (np.arange(4096) + 0.5) / 4096
        if abs(medium.g) == 1.0:
            return Bound(math.inf, f"g = {medium.g:g}")
        p = phase_function(theta, medium.g, medium.phase)
        even = power_removed(medium.g, medium.phase) / (2.0 * np.pi)
        moved = float(np.mean(np.abs(p - even)) * 2.0 * np.pi)
        # Relative to the even one: sum of (k - 1) kept^(k - 2) times what one scattering keeps.
        kept = about.kept
        if moved < 1e-12:
            return Bound(0.0, "g = 0 scatters evenly")
        size = math.inf if kept >= 1.0 else kept / (1.0 - kept) ** 2
        share = moved / power_removed(medium.g, medium.phase)
        return Bound(2.0 * share * size, f"g = {medium.g:g} moves {share:.2g} of a bounce")

    def onto(self, parts: Parts) -> Parts:
        """Keep the phase function of the scene."""
        return replace(parts, isotropic=False)
