"""Scattering coefficient and asymmetry from the multiple scattering (Eq. 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from analysis.attenuation import Attenuation
from analysis.bounces import BounceTable, tabulate
from analysis.errors import AnalysisError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Inversion:
    """The bounces that best explain the multiple scattering.

    Attributes
    ----------
    covariance : (2, 2) of (sigma_s, g), statistical: camera noise, and the noise of sigma_t and c
    residual : (n_y, n_x), picture less model, in camera units; NaN where not fitted
    rms_relative : rms of the residual over rms of the picture
    last_bounce_share : light of the last bounce computed, as a share of the multiple scattering
    at_limit : g or the albedo stopped at the end of its range: no minimum was found inside
    """

    sigma_s_per_mm: float
    g: float
    covariance: Array
    residual: Array
    rms_relative: float
    last_bounce_share: float
    at_limit: bool


def invert(
    multiple: Array, variance: Array, attenuation: Attenuation, table: BounceTable
) -> Inversion:
    """Minimise ``|| I_M - c sum_(k>=2) sigma_s^(k-1) phi_k^(g) ||`` over sigma_s and g (Eq. 10).

    ``I_k = c sigma_s^(k-1) phi_k``: the camera looks along the normal and sees every direction in
    the plane at pi/2, so one factor c serves all orders. It holds sigma_s p(pi/2), source power
    and camera gain, and is the c of Eq. 9; this gauge makes sigma_s absolute.

    Parameters
    ----------
    multiple, variance : (n_y, n_x) on the table's grid, camera units; NaN where unknown.
        Nodes on the walls are left out, their cells being halves.

    Raises
    ------
    AnalysisError
        If there is no multiple scattering to fit.
    """
    use = np.isfinite(multiple)
    use[[0, -1], :] = use[:, [0, -1]] = False
    picture = multiple[use]
    if picture.size < 16 or not picture.any():
        msg = "the multiple scattering holds no light; sigma_s and g cannot be determined."
        raise AnalysisError(msg)
    c = attenuation.scale_c
    power = float(np.sqrt(np.mean(picture**2)))
    low, high = float(table.g_nodes.min()), float(table.g_nodes.max())

    def residual(parameters: Array) -> Array:
        albedo, g = parameters
        return (c * table.multiple(g, albedo)[use] - picture) / power

    found = least_squares(
        residual, [0.5, 0.5 * (low + high)], bounds=([1e-6, low], [1.0, high]), x_scale=[0.3, 0.3]
    )
    albedo, g = (float(v) for v in found.x)
    jacobian = _jacobian(table, albedo, g)[:, use] * c
    covariance = _covariance(jacobian, variance[use], attenuation, table, (albedo, g), use)
    model = c * table.multiple(g, albedo)
    orders = table.at(g)
    last = albedo ** (orders.shape[0] - 1) * orders[-1].sum()
    sigma_t = table.sigma_t_per_mm
    return Inversion(
        sigma_s_per_mm=albedo * sigma_t,
        g=g,
        covariance=covariance,
        residual=np.where(use, multiple - model, np.nan),
        rms_relative=float(np.sqrt(np.mean((picture - model[use]) ** 2)) / power),
        last_bounce_share=float(last / table.multiple(g, albedo).sum()),
        at_limit=bool(np.any(found.active_mask != 0)),
    )


def _jacobian(table: BounceTable, albedo: float, g: float) -> Array:
    """Return the derivatives of the multiple scattering by albedo and g, (2, n_y, n_x)."""
    step = 1e-4
    by_albedo = table.multiple(g, albedo + step) - table.multiple(g, albedo - step)
    by_g = table.multiple(g + step, albedo) - table.multiple(g - step, albedo)
    return np.stack([by_albedo, by_g]) / (2.0 * step)


def _covariance(
    jacobian: Array,
    variance: Array,
    attenuation: Attenuation,
    table: BounceTable,
    at: tuple[float, float],
    use: NDArray[np.bool_],
) -> Array:
    """Carry camera noise, and the covariance of (c, sigma_t), to (sigma_s, g).

    The fit is unweighted, so its covariance is J+ V J+^T, not the inverse normal matrix.
    """
    albedo, g = at
    gain = np.linalg.pinv(jacobian.T)  # (2, n): what a change of the picture does to the answer
    step = 1e-3
    sigma_t = table.sigma_t_per_mm
    nearby = tabulate(
        sigma_t * (1.0 + step),
        table.beam,
        table.grid,
        phase=table.phase,
        n_bounces=table.fluence.shape[1],
        g_range=(g - 1e-3, g + 1e-3),
        n_g=1,
    )
    here = table.multiple(g, albedo)[use]
    by_sigma_t = attenuation.scale_c * (nearby.multiple(g, albedo)[use] - here) / (step * sigma_t)
    by_c_and_sigma_t = -gain @ np.stack([here, by_sigma_t], axis=1)
    to_sigma_s = np.diag([sigma_t, 1.0])
    carried = to_sigma_s @ by_c_and_sigma_t
    carried[0, 1] += albedo  # sigma_s = albedo sigma_t
    noise = to_sigma_s @ (gain * variance) @ gain.T @ to_sigma_s
    return np.asarray(noise + carried @ attenuation.covariance @ carried.T)
