"""What a plan would see of a scene, and with what noise, without capturing anything.

Light is that of the plane model, from the same few formulas as the fit; noise is that of the
rig's camera under the merge of the plan's bracket.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.separation import square_contrast
from analysis.spectrum import CONTRAST_ERROR, StripeWave, white_light
from analysis.stripe_aware import stripe_answer
from analysis.stripe_problem import Observed
from analysis.transport.eigenmodes import plane_light
from labrig.errors import PlanError
from labrig.models.plan import Plan, StripesPattern
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import bracket_of
from labrig.scene.filled import refuse_layer
from labrig.steps.joint import N_WAVES, depth_bins

Array = NDArray[np.float64]

FINE_WAVES = 24  # of the picture that the noise is taken from
SATURATED = 0.95  # of the white level: brighter counts are not used


def expect(scene: Scene, rig: Rig, plan: Plan) -> Observed:
    """Return the waves that the analysis of such a capture would be given.

    Side walls are left out: they change the light by percents, and its noise by less.

    Raises
    ------
    PlanError
        If the rig's scale is unknown, or the plan has no stripes.
    """
    refuse_layer(scene, "the expected accuracy of a capture")
    pixel_mm = rig.geometry.mm_per_px
    if pixel_mm is None:
        msg = f"rig {rig.name!r}: geometry.mm_per_px is needed to tell what it would see."
        raise PlanError(msg)
    noise = _Noise(scene, rig, plan)
    medium, tank, beam = scene.medium.record(), scene.tank.record(), scene.beam.record()
    rows, cols = round(tank.width_mm / pixel_mm), round(tank.depth_mm / pixel_mm)
    bins = depth_bins(cols, pixel_mm, medium.sigma_t_per_mm)
    y, irradiance = beam.profile_points()
    fine_y = np.linspace(y[0], y[-1], 2001)
    light = np.interp(fine_y, y, irradiance)
    across_mm = float(np.sum(light) * (fine_y[1] - fine_y[0]))
    origin = 0.5 * rows * pixel_mm
    q = np.asarray(2.0 * np.pi * np.arange(FINE_WAVES + 1) / (rows * pixel_mm), dtype=np.float64)
    profile = (np.exp(-1j * np.outer(q, fine_y - origin)) @ light) / light.sum()
    slope = math.tan(math.radians(beam.angle_deg))
    answer = np.stack(
        [
            plane_light(
                medium,
                bins.x_mm,
                depth_mm=tank.depth_mm,
                wavenumber_per_mm=float(w),
                angle_deg=beam.angle_deg,
            )
            for w in q
        ]
    )
    counts = scene.light.peak_e_per_s * noise.gain_dn_per_e
    moment = counts * across_mm * profile[:, None] * answer
    moment = moment * np.exp(-1j * slope * np.outer(q, bins.x_mm))
    heights = np.asarray((np.arange(rows) + 0.5) * pixel_mm - origin, dtype=np.float64)
    white = _picture(moment, q, heights, rows * pixel_mm)

    black = noise.of(rig.projector.black_level * white, noise.repeats("black"))
    stripes, variances = [], []
    for pattern, repeats in _stripes_of(plan):
        wave = 2.0 * math.pi / (pattern.period_px * rig.projection.mm_per_px)
        n = pattern.shifts
        size = stripe_answer(medium, wave, bins.x_mm, depth_mm=tank.depth_mm, slope=slope)
        blur = math.exp(-0.5 * (2.0 * math.pi * rig.projection.blur_px / pattern.period_px) ** 2)
        c1 = square_contrast(0.5) * blur * float(np.sinc(wave * pixel_mm / (2.0 * math.pi)))
        direct = np.minimum(counts * size, white)  # of lit against dark stripes
        leak = rig.projector.black_level * white
        lit = noise.of(0.5 * (white + direct) + leak, repeats)
        dark = noise.of(0.5 * (white - direct) + leak, repeats)
        variance = 0.5 * (lit + dark) / np.diff(bins.first)
        variances.append(4.0 * variance / n)
        stripes.append(
            StripeWave(
                wavenumber_per_mm=wave,
                slope=slope,
                amplitude=_where_seen(counts * across_mm * c1 * size, variance),
                std=pixel_mm * np.sqrt(np.nansum(2.0 * variance / n, axis=0)),
                profile=profile[1 : N_WAVES + 1],
                profile_std=np.full(N_WAVES, 1e-4),
                contrast=c1 if n >= 6 else None,
                contrast_std=CONTRAST_ERROR,
            )
        )
    of_white = np.mean(variances, axis=0) / len(variances)
    of_white = of_white + 4.0 * black / np.diff(bins.first)
    seen = white_light(white, of_white, pixel_mm, q[: N_WAVES + 1])
    whole = _where_seen(np.ones(bins.x_mm.size), of_white)
    return Observed(
        x_mm=bins.x_mm,
        white=replace(seen, moment=moment[: N_WAVES + 1] * whole),
        stripes=tuple(stripes),
        depth_mm=tank.depth_mm,
    )


class _Noise:
    """Variance of a merged picture, (counts/s)^2, under the plan's bracket."""

    def __init__(self, scene: Scene, rig: Rig, plan: Plan) -> None:
        camera = rig.camera
        if camera.gain_dn_per_e is None or camera.read_noise_e is None:
            msg = f"rig {rig.name!r}: measure the camera's gain_dn_per_e and read_noise_e."
            raise PlanError(msg)
        self._plan = plan
        self.gain_dn_per_e = camera.gain_dn_per_e
        self._floor = (camera.gain_dn_per_e * camera.read_noise_e) ** 2 + 1.0 / 12.0
        self._room = SATURATED * camera.white_level_dn - camera.black_level_dn
        self._ambient = scene.light.ambient_e_per_s * self.gain_dn_per_e
        self._seconds = bracket_of(plan, rig)

    def repeats(self, role: str) -> int:
        return sum(s.repeats for s in self._plan.sets if s.role == role) or 1

    def of(self, light: Array, repeats: int) -> Array:
        """Return the variance of pixels of a brightness (counts/s); NaN where all saturate."""
        bright = np.maximum(light, 0.0) + self._ambient
        weight = np.zeros_like(bright)
        for t in self._seconds:
            usable = bright * t < self._room
            weight += usable * repeats * t**2 / (self.gain_dn_per_e * bright * t + self._floor)
        return np.where(weight > 0.0, 1.0 / np.where(weight > 0.0, weight, 1.0), np.nan)


def _picture(moment: NDArray[np.complex128], q: Array, heights: Array, height_mm: float) -> Array:
    """Return the light (rows, n_x) whose waves are given; what the cut series undershoots is 0."""
    wave = np.exp(1j * np.outer(heights, q)) * np.where(q > 0.0, 2.0, 1.0)
    taper = np.sinc(q / (q[-1] + q[1]))  # against the ringing of the cut series
    return np.asarray(np.maximum(((wave * taper) @ moment).real / height_mm, 0.0))


def _where_seen(values: Array, variance: Array) -> Array:
    """Return values (n_x,) with NaN where any row (rows, n_x) has no variance."""
    return np.where(np.isfinite(variance).all(axis=0), values, np.nan)


def _stripes_of(plan: Plan) -> list[tuple[StripesPattern, int]]:
    """Return the stripes of a plan, and how often each is repeated."""
    found = [(s.pattern, s.repeats) for s in plan.sets if isinstance(s.pattern, StripesPattern)]
    if not found:
        msg = f"plan {plan.name!r} holds no stripes; nothing can be measured with it."
        raise PlanError(msg)
    return found
