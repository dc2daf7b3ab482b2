"""Separates and fits a set of live stripes on reduced pictures, by the steps of any analysis."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Medium
from analysis.phase_function import UNRESOLVED
from analysis.stripe_aware import StripeAware, fit_stripe_aware
from analysis.transport.ordinates import solve_on
from calibration.errors import CalibrationError
from labrig.config import parse
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.reporting.views import followed
from labrig.station.door import StripeSet
from labrig.station.shown import Fitted
from labrig.steps.decay import Decay, attenuate
from labrig.steps.joint import (
    G_ASSUMED,
    G_UNKNOWN,
    OFF_MODEL,
    fit_seen,
    refuse_near_walls,
    std_of_g,
    walls_of,
)
from labrig.steps.record import scale_c_of
from labrig.steps.rectify import Pictures
from labrig.steps.separation import separate
from labrig.steps.waves import Seen, observe

Array = NDArray[np.float64]
NODES = 49  # of the reduced grid of the bounces, along the depth
LEAST_DIRECTIONS = 28  # of that grid
SHOWN = 6  # bounces
SAME_STDS = 4.0  # between two sets of one sample, at most
CONFIG = Analysis.model_validate({"schema": "labrig-analysis/1"})


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """A joint fit; ``g_unknown`` if g was held because the light does not tell it."""

    fit: StripeAware
    g_unknown: bool

    @property
    def std(self) -> Array:
        """Standard deviations of sigma_t, sigma_s and g: the camera's noise and the model's error.

        (3,)
        """
        return np.sqrt(np.diag(self.fit.covariance + self.fit.model_covariance))

    def is_near(self, medium: Medium) -> bool:
        """Whether a medium is the same sample: walls and contrast are then those of it too."""
        found = self.fit.medium
        moves = np.array(
            [
                found.sigma_t_per_mm - medium.sigma_t_per_mm,
                found.sigma_s_per_mm - medium.sigma_s_per_mm,
                found.g - medium.g,
            ]
        )
        return bool(np.all(np.abs(moves) < SAME_STDS * self.std))

    @property
    def why(self) -> str:
        """What must be said of it."""
        said = []
        if self.g_unknown:
            said.append(f"g is not determined: too little multiple light; {G_ASSUMED:g} is taken.")
        elif self.fit.at_limit:
            said.append("The fit stands at the end of its range: σₛ and g are not determined.")
        if self.fit.chi2_per_dof > OFF_MODEL:
            times = math.sqrt(self.fit.chi2_per_dof)
            said.append(f"The light misses the model by {times:.1f} times noise and model error.")
        return " ".join(said)


def decompose(found: StripeSet, before: Fitted | None = None) -> Fitted:
    """Return extinction, scattering, asymmetry and the first bounces of a live set.

    They are those of stripes and white light fitted together, as in `labrig.steps.joint`. A fit
    that holds is where that of the next set begins: side walls and contrast are then those of the
    medium before, so that they settle from set to set.

    What stops the fit is said in ``why``; what was found before stands. ``plan_std`` is the
    standard deviation of sigma_t that the whole plan would leave, which exposes every shift
    ``plan_s``: the noise falls, the model's own error stays.
    """
    begun = time.process_time()
    setup = parse(found.setup, Setup, source="live")
    pictures = _pictures(found, setup)
    fitted = Fitted(unit=pictures.unit, taken_s=found.taken_s)
    try:
        separated = separate(pictures, setup, CONFIG)
        decay = attenuate(separated, pictures, setup, CONFIG)
        single = decay.single
        fitted = replace(fitted, depth=single.depth_mm, single=single.value, **_by_single(decay))
        joint = _fit(pictures, setup, decay, before)
        fitted = replace(fitted, **_values(joint, found), **_bounces(joint.fit, decay))
    except (AnalysisError, AnalysisRefusedError, CalibrationError) as error:
        fitted = replace(fitted, why=" ".join(str(error).split()))
    return replace(fitted, cpu_s=time.process_time() - begun)


def _by_single(decay: Decay) -> dict[str, Any]:
    """Return what Eq. 9 says, which stands until the joint fit does."""
    of = decay.attenuation
    std = math.sqrt(of.covariance[1, 1] * max(of.chi2_per_dof, 1.0))
    return {"sigma_t": (of.sigma_t_per_mm, std)}


def _values(joint: _Found, found: StripeSet) -> dict[str, Any]:
    medium, std = joint.fit.medium, joint.std
    noise, model = (float(of[0, 0]) for of in (joint.fit.covariance, joint.fit.model_covariance))
    return {
        "sigma_t": (medium.sigma_t_per_mm, float(std[0])),
        "sigma_s": (medium.sigma_s_per_mm, float(std[1])),
        "g": None if joint.g_unknown else (medium.g, float(std[2])),
        "holds": not joint.why,
        "plan_std": math.sqrt(noise * found.exposure_s / found.plan_s + model),
        "why": joint.why,
    }


def _fit(pictures: Pictures, setup: Setup, decay: Decay, before: Fitted | None) -> _Found:
    """Fit from nothing, or from what the set before has found."""
    guess, phase = decay.attenuation.sigma_t_per_mm, CONFIG.phase
    refuse_near_walls(decay.tank, guess)
    seen = observe(pictures, setup, guess, decay.tank)
    walls = walls_of(decay, seen.observed)
    if before is not None and before.holds and before.sigma_t and before.sigma_s and before.g:
        near = Medium(
            sigma_t_per_mm=before.sigma_t[0],
            sigma_s_per_mm=before.sigma_s[0],
            g=before.g[0],
            phase=phase,
        )
        again = _Found(fit=_fit_near(seen, near, walls(near)), g_unknown=False)
        if not again.why and again.is_near(near):
            return again
    fit = fit_seen(seen, guess, phase, walls, profile=False)
    if std_of_g(fit) <= G_UNKNOWN:
        return _Found(fit=fit, g_unknown=False)
    return _Found(fit=fit_seen(seen, guess, phase, walls, g=G_ASSUMED), g_unknown=True)


def _fit_near(seen: Seen, near: Medium, losses: NDArray[np.complex128]) -> StripeAware:
    """Fit from a medium that is nearly right already, with the contrast and walls it makes."""
    contrasts = seen.contrasts(near)
    stripes = tuple(
        replace(stripe, contrast=c1, contrast_std=std)
        for stripe, (c1, std) in zip(seen.observed.stripes, contrasts, strict=True)
    )
    return fit_stripe_aware(
        replace(seen.observed, stripes=stripes),
        sigma_t_per_mm=near.sigma_t_per_mm,
        phase=near.phase,
        side_walls=lambda _: losses,
        near=near,
    )


def _bounces(fit: StripeAware, decay: Decay) -> dict[str, Any]:
    """Return the first bounces along the beam, on a coarse grid."""
    medium = fit.medium
    n_theta = LEAST_DIRECTIONS
    while abs(medium.g) ** (n_theta // 2) > UNRESOLVED:
        n_theta += 32
    cell_mm = decay.tank.depth_mm / (NODES - 1)
    grid = Grid.covering(decay.tank, cell_mm=cell_mm, n_theta=n_theta)
    solved = solve_on(medium, decay.beam, grid, n_bounces=SHOWN, light_field=False)
    depth, light = followed(
        solved.fluence,
        x=grid.x_mm,
        y=grid.y_mm,
        rows=(decay.beam.from_mm, decay.beam.to_mm),
        angle_rad=math.radians(decay.beam.angle_deg),
    )
    return {"bounce_depth": depth, "bounces": scale_c_of(fit, decay) * light}


def _pictures(found: StripeSet, setup: Setup) -> Pictures:
    camera, n = setup.camera, found.binned
    gain = camera.gain_dn_per_e or math.nan
    read_noise_dn = gain * (camera.read_noise_e or math.nan)

    def variance(counts: NDArray[np.float32]) -> NDArray[np.float32]:
        light = np.maximum(counts - camera.black_level_dn, 0.0)
        raw = gain * light + read_noise_dn**2 + 1.0 / 12.0
        return np.asarray(raw / (n * found.exposure_s) ** 2, dtype=np.float32)

    net = (found.counts - found.black) / np.float32(found.exposure_s)
    scale = setup.geometry.mm_per_px
    black = (found.black - camera.black_level_dn) / found.exposure_s
    return Pictures(
        stripes=net.astype(np.float32),
        stripes_variance=variance(found.counts),
        white=None,
        white_variance=None,
        black=black.astype(np.float64),
        black_variance=variance(found.black).astype(np.float64),
        leak=None,
        position_px=None,
        captured=found.counts[0].astype(np.float64),
        beam_angle_deg=None,
        pixel=n * (scale or 1.0),
        unit="px" if scale is None else "mm",
        saturated_fraction=float(np.mean(~np.isfinite(net))),
        notes=(),
    )
