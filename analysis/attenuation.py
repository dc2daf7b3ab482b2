"""Extinction from the decay of light along the beam (Eq. 9)."""

from __future__ import annotations

import math
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
GLARE_DEPTHS = 8  # columns over which light may not rise
ROWS_TOGETHER = 8  # rows drawn as one: a lens couples neighbours
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
    ended_by : why no deeper light was used
    row_std : (scale_c, sigma_t), from the scatter of what each row of the picture alone would
        move the fit by: the bootstrap over rows, in the limit of many draws. It must agree with
        the covariance where nothing but the camera's noise differs from row to row
    """

    scale_c: float
    sigma_t_per_mm: float
    covariance: Array
    chi2_per_dof: float
    rms_relative: float
    depth_range_mm: tuple[float, float]
    ended_by: str
    row_std: tuple[float, float]

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
        standard deviations or one percent of its maximum for good, is mostly not detected, or
        rises again, as the glare of a far wall does

    Raises
    ------
    AnalysisError
        If there is no signal, fewer than four depths remain, or the light does not decay.
    """
    use, ended_by = _chosen(profile, depth_range_mm)
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
        ended_by=ended_by,
        row_std=_scatter_of_rows(profile.rows[:, use], model, to_c @ inverse @ found.jac.T / std),
    )


def _scatter_of_rows(rows: NDArray[np.float32], model: Array, pull: Array) -> tuple[float, float]:
    """Return the std of (scale_c, sigma_t) by the scatter of the rows' own pulls.

    ``pull`` (2, n_depths) is what a change of the profile does to the answer. Neighbouring rows
    are drawn together, eight at a time.
    """
    off = np.where(np.isfinite(rows), rows - model, 0.0)
    n = off.shape[0] // ROWS_TOGETHER
    if n < 4:
        return math.nan, math.nan
    blocks = off[: n * ROWS_TOGETHER].reshape(n, ROWS_TOGETHER, -1).mean(axis=1)
    moved = pull @ blocks.T
    of_c, of_sigma_t = moved.std(axis=1, ddof=1) / math.sqrt(n)
    return float(of_c), float(of_sigma_t)


def _chosen(
    profile: DepthProfile, wanted: tuple[float, float] | None
) -> tuple[NDArray[np.bool_], str]:
    """Return the depths to fit, and why they end."""
    depth, value = profile.depth_mm, profile.value
    ends = {
        f"light sinks below {SIGNAL_SNR:g} standard deviations": value <= SIGNAL_SNR * profile.std,
        f"light sinks below {100 * SIGNAL_SHARE:g} % of its maximum": value
        <= SIGNAL_SHARE * np.nanmax(value),
        "single scattering is mostly not detected": profile.detected_share < DETECTED_SHARE,
        "light rises again towards the far wall": _rising(profile),
    }
    lost = np.any(list(ends.values()), axis=0)
    if lost.all():
        msg = "no signal: light along the beam is nowhere five times its standard deviation."
        raise AnalysisError(msg)
    if wanted is None:
        behind = np.flatnonzero(lost & (np.arange(lost.size) > np.argmax(value)))
        end = int(behind[0]) if behind.size else lost.size
        use = np.arange(lost.size) < end
        named = [why for why, where in ends.items() if end < lost.size and where[end]]
        ended_by = named[0] if named else "the picture ends"
    else:
        use, ended_by = (depth >= wanted[0]) & (depth <= wanted[1]), "asked for"
    if use.sum() < 4:
        msg = (
            f"{int(use.sum())} depths are left to fit c and sigma_t; "
            "widen the depth range or take longer exposures."
        )
        raise AnalysisError(msg)
    return np.asarray(use), ended_by


def _rising(profile: DepthProfile) -> NDArray[np.bool_]:
    """Return where light exceeds, significantly, what it has been ``GLARE_DEPTHS`` before.

    Behind its maximum only: in a layer, light first rises where it is scattered sharply forward.
    """
    before = np.roll(profile.value, GLARE_DEPTHS)
    noise = np.hypot(profile.std, np.roll(profile.std, GLARE_DEPTHS))
    found = profile.value > 1.02 * before + SIGNAL_SNR * noise
    found[: GLARE_DEPTHS + int(np.nanargmax(profile.value))] = False
    return np.asarray(found)
