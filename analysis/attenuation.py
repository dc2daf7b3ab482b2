"""Extinction from the decay of light along the beam (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from analysis.errors import AnalysisError
from analysis.profile import DepthProfile

Array = NDArray[np.float64]

SIGNIFICANT = 3.0  # standard deviations by which sigma_t must exceed zero
SIGNAL_SNR = 5.0  # depths darker than this many standard deviations end the fit
DETECTED_SHARE = 0.5  # and depths where most pixels show no single scattering
SIGNAL_SHARE = 0.01  # and so do depths darker than this share of the brightest


@dataclass(frozen=True, slots=True, kw_only=True)
class Attenuation:
    """The fit of c exp(-sigma_t d).

    Attributes
    ----------
    covariance : (2, 2) of (scale_c, sigma_t), statistical, from the weights and the Jacobian
    chi2_per_dof : mean squared residual in standard deviations; one if the model holds
    rms_relative : rms of the residual as a share of the fit
    depth_range_mm : first and last depth used
    """

    scale_c: float
    sigma_t_per_mm: float
    covariance: Array
    chi2_per_dof: float
    rms_relative: float
    depth_range_mm: tuple[float, float]

    def at(self, depth_mm: Array) -> Array:
        """Return c exp(-sigma_t d)."""
        return np.asarray(self.scale_c * np.exp(-self.sigma_t_per_mm * depth_mm))


def fit_attenuation(
    profile: DepthProfile, depth_range_mm: tuple[float, float] | None = None
) -> Attenuation:
    """Fit ``argmin_(c, sigma_t) || s(d) - c exp(-sigma_t d) ||`` with weights 1 / std^2 (Eq. 9).

    Parameters
    ----------
    depth_range_mm : fitted depths; else from the face down to where the signal sinks below five
        standard deviations or one percent of its maximum for good, or is mostly not detected

    Raises
    ------
    AnalysisError
        If there is no signal, fewer than four depths remain, or the light does not decay.
    """
    use = _chosen(profile, depth_range_mm)
    depth, value = profile.depth_mm[use], profile.value[use]
    std = np.maximum(profile.std[use], 1e-9 * np.abs(value).max())

    def residual(parameters: Array) -> Array:
        log_c, sigma_t = parameters
        return np.asarray((np.exp(log_c - sigma_t * depth) - value) / std)

    def jacobian(parameters: Array) -> Array:
        log_c, sigma_t = parameters
        model = np.exp(log_c - sigma_t * depth) / std
        return np.stack([model, -depth * model], axis=1)

    span = depth[-1] - depth[0]
    ends = np.log(np.maximum(value[[0, -1]], 1e-3 * value.max()))
    start = np.array([ends[0], max((ends[0] - ends[1]) / span, 1e-6 / span)])
    found = least_squares(residual, start, jac=jacobian, x_scale=[1.0, 1.0 / span], method="lm")
    scale_c, sigma_t = float(np.exp(found.x[0])), float(found.x[1])
    inverse = np.linalg.pinv(found.jac.T @ found.jac)
    std_t = float(np.sqrt(inverse[1, 1]))
    if not (np.isfinite(found.x).all() and sigma_t > SIGNIFICANT * std_t):
        msg = (
            f"light does not decay along the beam (sigma_t = {sigma_t:.3g} +- {std_t:.2g}); "
            "is lit_side right, and is the sample a scattering tank?"
        )
        raise AnalysisError(msg)
    to_c = np.diag([scale_c, 1.0])
    model = scale_c * np.exp(-sigma_t * depth)
    return Attenuation(
        scale_c=scale_c,
        sigma_t_per_mm=sigma_t,
        covariance=to_c @ inverse @ to_c,
        chi2_per_dof=float(np.sum(found.fun**2) / max(depth.size - 2, 1)),
        rms_relative=float(np.sqrt(np.mean((value / model - 1.0) ** 2))),
        depth_range_mm=(float(depth[0]), float(depth[-1])),
    )


def _chosen(profile: DepthProfile, wanted: tuple[float, float] | None) -> NDArray[np.bool_]:
    depth, value = profile.depth_mm, profile.value
    seen = value > np.maximum(SIGNAL_SNR * profile.std, SIGNAL_SHARE * np.nanmax(value))
    seen &= profile.detected_share >= DETECTED_SHARE
    if not seen.any():
        msg = "no signal: light along the beam is nowhere five times its standard deviation."
        raise AnalysisError(msg)
    if wanted is None:
        lost = np.flatnonzero(~seen & (np.arange(seen.size) > np.argmax(value)))
        use = np.arange(seen.size) < (lost[0] if lost.size else seen.size)
    else:
        use = (depth >= wanted[0]) & (depth <= wanted[1])
    if use.sum() < 4:
        msg = (
            f"{int(use.sum())} depths are left to fit c and sigma_t; "
            "widen the depth range or take longer exposures."
        )
        raise AnalysisError(msg)
    return np.asarray(use)
