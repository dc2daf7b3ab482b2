"""The projector's image: gamma, leak of black pixels, blur, and blur that grows with depth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labrig.models.effects import BlurConfig, DefocusConfig, GammaConfig, LeakConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Array, Parts
from labrig.scene.stripes import LAST


class Gamma(Effect[GammaConfig]):
    """Light of a grey level is its gamma-th power; black and white stay what they are."""

    cost = "a power for each projector column"

    def bound(self, about: Situation) -> Bound:
        """Return the largest change of a level that the plan shows."""
        gamma = self.parameters.gamma
        change = max((abs(level**gamma - level) for level in about.levels), default=0.0)
        return Bound(2.0 * change, "levels of the plan change by at most half of this")

    def onto(self, parts: Parts) -> Parts:
        """Bend the projector's levels."""
        gamma = self.parameters.gamma

        def bent(levels: Array) -> Array:
            return np.asarray(levels**gamma)

        return replace(parts, transfer=bent)


class Leak(Effect[LeakConfig]):
    """A black pixel shines with a share of a white one."""

    cost = "nothing"

    def _share(self, about: Situation | Parts) -> float:
        share = self.parameters.share
        return about.rig.projector.black_level if share is None else share

    def bound(self, about: Situation) -> Bound:
        """Return the share itself: added where stripes are dark, which is half of them."""
        share = self._share(about)
        worst = 2.0 if about.periods_px else 0.0
        return Bound(worst * share, f"{share:g} of white wherever stripes are dark")

    def onto(self, parts: Parts) -> Parts:
        """Light the black pixels."""
        return replace(parts, black_level=self._share(parts))


class Blur(Effect[BlurConfig]):
    """A Gaussian blurs projector pixels: wave h of stripes falls by exp(-(h q s)^2 / 2)."""

    cost = "an error function at every edge of a stripe"

    def _sigma_px(self, about: Situation | Parts) -> float:
        sigma = self.parameters.sigma_px
        return about.rig.projection.blur_px if sigma is None else sigma

    def bound(self, about: Situation) -> Bound:
        """Return the rms of what the waves of the finest stripes lose."""
        sigma_px = self._sigma_px(about)
        period_px = about.finest_mm / about.rig.projection.mm_per_px
        return Bound(
            lost_by(sigma_px, period_px), f"edges of {period_px:g} px, {sigma_px:g} px soft"
        )

    def onto(self, parts: Parts) -> Parts:
        """Blur the projected light."""
        return replace(parts, blur_px=self._sigma_px(parts))


class Defocus(Effect[DefocusConfig]):
    """The blur grows with depth, as the projector is sharp at the face only."""

    kind = "transport"
    cost = "33 blurs in place of one, and an answer of its own"

    def bound(self, about: Situation) -> Bound:
        """Return what waves lose at the far wall."""
        most_px = self.parameters.px_per_mm * about.scene.tank.depth_mm
        period_px = about.finest_mm / about.rig.projection.mm_per_px
        # The growing part adds to the blur at the face; alone it changes no less.
        return Bound(lost_by(2.0 * most_px, period_px), f"{most_px:g} px more at the far wall")

    def onto(self, parts: Parts) -> Parts:
        """Let the blur grow."""
        return replace(parts, defocus_px_per_mm=self.parameters.px_per_mm)


def lost_by(sigma_px: float, period_px: float) -> float:
    """Return the relative rms change of half-lit stripes that are blurred."""
    turn = 2.0 * math.pi / period_px
    odd = np.arange(1, 40 * LAST, 2)
    lost = 1.0 - np.exp(-0.5 * (turn * odd * sigma_px) ** 2)
    return math.sqrt(float(np.sum(2.0 * (lost / (math.pi * odd)) ** 2)) / 0.25)
