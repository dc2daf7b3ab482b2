"""Light that is not the projector's, and what a lens does to a picture: blur and vignetting."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from labrig.models.effects import AmbientConfig, LensBlurConfig, VignettingConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.effects.projector import lost_by
from labrig.scene.parts import Array, Parts

EDGE = 0.2337  # integral of the square of a step less the step blurred, over its sigma


class Ambient(Effect[AmbientConfig]):
    """Even light on the whole sensor, projector or not."""

    cost = "nothing"

    def _rate(self, about: Situation | Parts) -> float:
        own = self.parameters.e_per_s
        return about.scene.light.ambient_e_per_s if own is None else own

    def bound(self, about: Situation) -> Bound:
        """Return it as a share of the dimmest picture."""
        rate = self._rate(about)
        return Bound(about.of_rms(rate), f"{rate:g} electrons/s everywhere")

    def onto(self, parts: Parts) -> Parts:
        """Add it."""
        return replace(parts, ambient_e_per_s=self._rate(parts))


class LensBlur(Effect[LensBlurConfig]):
    """The lens images a point as a Gaussian; light is moved, not lost."""

    cost = "two passes over the picture"

    def bound(self, about: Situation) -> Bound:
        """Return what stripes lose, and the edges of beam and face."""
        sigma_px = self.parameters.sigma_px
        pixel_mm = about.rig.geometry.mm_per_px or 1.0
        stripes = lost_by(sigma_px, about.finest_mm / pixel_mm)
        beam, sigma_mm = about.scene.beam, sigma_px * pixel_mm
        lit_mm = beam.to_mm - beam.from_mm
        sigma_t = max(about.scene.medium.sigma_t_per_mm, 1.0 / about.scene.tank.depth_mm)
        edges = EDGE * sigma_mm * (2.0 / lit_mm + 2.0 * sigma_t)
        bound = (stripes + 2.0 * math.sqrt(edges)) * (1.0 + about.multiple_at_most)
        return Bound(bound if sigma_px else 0.0, f"edges {sigma_px:g} px soft")

    def onto(self, parts: Parts) -> Parts:
        """Blur the picture."""
        sigma_px = self.parameters.sigma_px

        def blurred(seen: Array) -> Array:
            return np.asarray(gaussian_filter(seen, sigma_px, mode="nearest", truncate=6.0))

        return replace(parts, optics=(*parts.optics, blurred))


class Vignetting(Effect[VignettingConfig]):
    """Light falls as cos^4 of the angle to the lens' axis, which hits the sensor's middle."""

    cost = "a factor for each pixel"

    def bound(self, about: Situation) -> Bound:  # noqa: ARG002
        """Return the loss in the corners."""
        lost = 1.0 - math.cos(math.radians(self.parameters.half_field_deg)) ** 4
        return Bound(lost, f"corners are darker by {lost:.2g}")

    def onto(self, parts: Parts) -> Parts:
        """Dim the picture away from its middle."""
        rows, cols = parts.rig.camera.rows, parts.rig.camera.cols
        gain = falling(rows, cols, self.parameters.half_field_deg)

        def dimmed(seen: Array) -> Array:
            return seen * gain

        return replace(parts, optics=(*parts.optics, dimmed))


def radius(rows: int, cols: int) -> tuple[Array, Array]:
    """Return rows and columns from the sensor's middle, in half diagonals: (rows, 1), (1, cols)."""
    half = 0.5 * math.hypot(rows, cols)
    y = (np.arange(rows) - 0.5 * (rows - 1)) / half
    x = (np.arange(cols) - 0.5 * (cols - 1)) / half
    return np.asarray(y[:, None]), np.asarray(x[None, :])


def falling(rows: int, cols: int, half_field_deg: float) -> Array:
    """Return cos^4 of the angle to the axis, (rows, cols)."""
    y, x = radius(rows, cols)
    steep = math.tan(math.radians(half_field_deg))
    return np.asarray((1.0 + steep**2 * (x**2 + y**2)) ** -2.0)
