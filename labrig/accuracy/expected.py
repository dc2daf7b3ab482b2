"""What a plan would see of a scene, and with what noise, without capturing anything.

Light is that of the plane model, from the same few formulas as the fit; noise is that of the
rig's camera under the merge of the plan's bracket.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from analysis.separation import square_contrast
from analysis.spectrum import CONTRAST_ERROR, Bins, StripeWave, white_light
from analysis.stripe_aware import stripe_answer
from analysis.stripe_problem import Observed
from analysis.transport.eigenmodes import plane_light
from labrig.errors import PlanError
from labrig.models.plan import Plan, StripesPattern
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import bracket_of
from labrig.scene.filled import refuse_layer
from labrig.steps.waves import N_WAVES, depth_bins

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
    light = _light(scene, pixel_mm, scene.light.peak_e_per_s * noise.gain_dn_per_e)
    black = noise.of(rig.projector.black_level * light.white, noise.repeats("black"))
    seen_stripes = [
        _wave(pattern, light, scene, rig, partial(noise.of, repeats=repeats))
        for pattern, repeats in _stripes_of(plan)
    ]
    variances = [variance for _, variance in seen_stripes]
    pixels = np.diff(light.bins.first)
    of_white = np.mean(variances, axis=0) / len(variances) + 4.0 * black / pixels
    seen = white_light(light.white, of_white, pixel_mm, light.q[: N_WAVES + 1])
    whole = _where_seen(np.ones(light.bins.x_mm.size), of_white)
    return Observed(
        x_mm=light.bins.x_mm,
        white=replace(seen, moment=light.moment[: N_WAVES + 1] * whole),
        stripes=tuple(wave for wave, _ in seen_stripes),
        depth_mm=scene.tank.depth_mm,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Light:
    """White light without noise, counts/s: its waves ``moment`` (n_q, n_x), its picture ``white``.

    ``profile`` holds the beam's waves, one at q = 0; ``counts`` is what the beam's axis would give
    at the face, ``across_mm`` the beam's width weighted by its irradiance.
    """

    bins: Bins
    q: Array
    profile: NDArray[np.complex128]
    across_mm: float
    slope: float
    counts: float
    pixel_mm: float
    moment: NDArray[np.complex128]
    white: Array


def _light(scene: Scene, pixel_mm: float, counts: float) -> _Light:
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
    moment = counts * across_mm * profile[:, None] * answer
    moment = moment * np.exp(-1j * slope * np.outer(q, bins.x_mm))
    heights = np.asarray((np.arange(rows) + 0.5) * pixel_mm - origin, dtype=np.float64)
    return _Light(
        bins=bins,
        q=q,
        profile=profile,
        across_mm=across_mm,
        slope=slope,
        counts=counts,
        pixel_mm=pixel_mm,
        moment=moment,
        white=_picture(moment, q, heights, rows * pixel_mm),
    )


def _wave(
    pattern: StripesPattern,
    light: _Light,
    scene: Scene,
    rig: Rig,
    variance_of: Callable[[Array], Array],
) -> tuple[StripeWave, Array]:
    """Return the wave of stripes, and the variance (rows, n_x) that they leave of white light."""
    x_mm, pixels, projection = light.bins.x_mm, np.diff(light.bins.first), rig.projection
    wave = 2.0 * math.pi / (pattern.period_px * projection.mm_per_px)
    medium, depth_mm = scene.medium.record(), scene.tank.depth_mm
    size = stripe_answer(medium, wave, x_mm, depth_mm=depth_mm, slope=light.slope)
    blur = math.exp(-0.5 * (2.0 * math.pi * projection.blur_px / pattern.period_px) ** 2)
    c1 = square_contrast(0.5) * blur * float(np.sinc(wave * light.pixel_mm / (2.0 * math.pi)))
    direct = np.minimum(light.counts * size, light.white)  # of lit against dark stripes
    leak = rig.projector.black_level * light.white
    lit = variance_of(0.5 * (light.white + direct) + leak)
    dark = variance_of(0.5 * (light.white - direct) + leak)
    variance = 0.5 * (lit + dark) / pixels
    of_sum = 2.0 * variance / pattern.shifts
    seen = StripeWave(
        wavenumber_per_mm=wave,
        slope=light.slope,
        amplitude=_where_seen(light.counts * light.across_mm * c1 * size, variance),
        std=light.pixel_mm * np.sqrt(np.nansum(of_sum, axis=0)),
        profile=light.profile[1 : N_WAVES + 1],
        profile_std=np.full(N_WAVES, 1e-4),
        contrast=c1 if pattern.shifts >= 6 else None,
        contrast_std=CONTRAST_ERROR,
    )
    return seen, 4.0 * variance / pattern.shifts


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
