"""All bounces at once in depth alone: the sum of the series, exact in depth.

A medium that is homogeneous between two walls has as many modes exp(-lambda x) as directions.
What stripes or white light add up to over all bounces is then the solution of two small linear
systems: no grid in depth, no number of bounces, and the same cost at every albedo. The orders one
by one are in `plane`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.light_field import equal_angles
from analysis.medium import Medium, Phase
from analysis.phase_function import Array, phase_function, scattering_moments
from analysis.transport.blas import BLAS

ComplexArray = NDArray[np.complex128]

NEGLIGIBLE = 1e-12  # moments of the phase function below this share of the first scatter nothing
LARGEST_ALBEDO = 1.0 - 1e-9  # at one, two modes of uniform light are the same


@dataclass(frozen=True, slots=True)
class _Modes:
    """Decaying modes, as even and odd light of the forward and of the backward directions.

    Attributes
    ----------
    rate : (m,), lambda, its real part positive
    forward, backward : (m, m), columns: a mode's light in directions of positive and negative
        cosine; a mode that grows has them exchanged
    """

    rate: ComplexArray
    forward: ComplexArray
    backward: ComplexArray


def plane_light(
    medium: Medium,
    x_mm: Array,
    *,
    depth_mm: float,
    wavenumber_per_mm: float = 0.0,
    angle_deg: float = 0.0,
    n_theta: int = 64,
) -> ComplexArray:
    """Return A(x; q), the fluence of all bounces of a beam that enters as exp(i q y), (n_x,).

    ``cos(theta) dL/dx + (sigma_t + i q sin(theta)) L = integral p (L + L_1) dtheta'`` between black
    walls at 0 and ``depth_mm``, plus the ballistic ``exp(-(sigma_t + i q sin(theta_0)) x /
    cos(theta_0))``; an amplitude of exp(i q (y - x tan(theta_0))), one where the beam enters.

    Written for the part of L that is even in theta and i times the part that is odd, the operator
    is real; for the sum and the difference of opposite cosines it is a square (as in discrete
    ordinates, Stamnes 1988), and its eigenvalues lambda^2 are those of a matrix of half the size.

    Parameters
    ----------
    x_mm : depths, any order
    wavenumber_per_mm : q = 2 pi / period of the stripes; zero for uniform light
    n_theta : directions at equal steps; stripes are resolved down to a depth of n_theta / q

    Raises
    ------
    AnalysisError
        If ``n_theta`` is no multiple of four from 16 on.
    """
    if n_theta < 16 or n_theta % 4:
        msg = f"{n_theta} directions: a multiple of four from 16 on is needed."
        raise AnalysisError(msg)
    slant = math.radians(angle_deg)
    sigma_t, q = medium.sigma_t_per_mm, wavenumber_per_mm
    rate = (sigma_t + 1j * q * math.sin(slant)) / math.cos(slant)
    turn = np.exp(1j * q * math.tan(slant) * x_mm)
    if medium.sigma_s_per_mm == 0.0:
        return np.asarray(np.exp(-rate * x_mm) * turn)
    with BLAS.limit(limits=1):
        same, cross, cos_t, from_beam = _operator(medium, q, slant, n_theta)
        together, apart = same + cross, same - cross
        inverse = np.asarray(np.linalg.inv(together), dtype=np.float64)
        modes = _decaying_modes(together, apart, inverse, cos_t)
        forward, backward = _following_the_beam(apart, inverse, cos_t, rate, from_beam)
        rising, falling = _matched(modes, forward, backward, rate, depth_mm)
        # The fluence is the even light of all directions; each stands for two.
        half = cos_t.size // 2
        seen = 2.0 * (2.0 * np.pi / n_theta)
        of_mode = seen * (modes.forward + modes.backward)[:half].sum(axis=0)
        of_beam = 1.0 + seen * (forward + backward)[:half].sum()
        decay = np.exp(-np.outer(x_mm, modes.rate)) * of_mode
        growth = np.exp(-np.outer(depth_mm - x_mm, modes.rate)) * of_mode
        light = of_beam * np.exp(-rate * x_mm) + decay @ falling + growth @ rising
    return np.asarray(light * turn)


def _operator(
    medium: Medium, q: float, slant: float, n_theta: int
) -> tuple[Array, Array, Array, tuple[ComplexArray, ComplexArray]]:
    """Return what removes and scatters light, and what the beam scatters into it.

    (m, m) within a hemisphere and across, m = n_theta / 2; cos(theta) (m,); the source of the
    forward and of the backward hemisphere (m,), each the even light of a quadrant, then the odd.
    """
    theta, within, over = _scattering(medium.g, medium.phase, n_theta)
    sigma_s, n = min(medium.sigma_s_per_mm, LARGEST_ALBEDO * medium.sigma_t_per_mm), theta.size
    same, cross = -sigma_s * within, sigma_s * over
    same[np.diag_indices(2 * n)] += medium.sigma_t_per_mm
    across = np.diag(q * np.sin(theta))
    same[:n, n:] -= across
    same[n:, :n] += across

    def source(of: Array) -> ComplexArray:
        above = sigma_s * phase_function(of - slant, medium.g, medium.phase)
        below = sigma_s * phase_function(-of - slant, medium.g, medium.phase)
        return np.concatenate([0.5 * (above + below), -0.5j * (above - below)])

    return same, cross, np.tile(np.cos(theta), 2), (source(theta), source(np.pi - theta))


@lru_cache(maxsize=8)  # one medium is asked for at several wavenumbers
def _scattering(g: float, phase: Phase, n_theta: int) -> tuple[Array, Array, Array]:
    """Return the angles of a quadrant (n,), what is scattered within a hemisphere, and across.

    The matrices are (2 n, 2 n), of the even light, then the odd, for a coefficient of one.
    """
    theta = equal_angles(n_theta)[: n_theta // 4]  # 0 .. pi/2
    basis, weights = scattering_moments(
        g,
        phase,
        np.concatenate([theta, -theta, np.pi - theta, theta - np.pi]),
        n_orders=n_theta // 2,
        negligible=NEGLIGIBLE,
    )
    n = theta.size
    rows = basis[:, :n].T * (weights * (2.0 * np.pi / n_theta))
    up, down, up_back, down_back = (rows @ basis[:, k * n : (k + 1) * n] for k in range(4))
    within, over = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    within[:n, :n], within[n:, n:] = up + down, up - down
    over[:n, :n], over[n:, n:] = up_back + down_back, up_back - down_back
    return theta, within, over


def _decaying_modes(together: Array, apart: Array, inverse: Array, cos_t: Array) -> _Modes:
    """Solve ``cos t' = -together d, cos d' = -apart t`` for the sum t and the difference d."""
    square = (together / cos_t[:, None]) @ (apart / cos_t[:, None])
    value, total = np.linalg.eig(square)
    rate = np.sqrt(value.astype(np.complex128))
    rate = np.where(rate.real < 0.0, -rate, rate)
    difference = inverse @ (cos_t[:, None] * total) * rate
    return _Modes(rate, 0.5 * (total + difference), 0.5 * (total - difference))


def _following_the_beam(
    apart: Array,
    inverse: Array,
    cos_t: Array,
    rate: complex,
    source: tuple[ComplexArray, ComplexArray],
) -> tuple[ComplexArray, ComplexArray]:
    """Return the light that decays as the beam does, which the beam feeds, (m,) each way.

    ``apart t - rate cos d`` is the sum of the sources, ``together d - rate cos t`` the difference.
    """
    plus, minus = source[0] + source[1], source[0] - source[1]
    matrix = apart - rate**2 * (cos_t[:, None] * inverse * cos_t)
    total = np.linalg.solve(matrix, plus + rate * cos_t * (inverse @ minus))
    difference = inverse @ (minus + rate * cos_t * total)
    return np.asarray(0.5 * (total + difference)), np.asarray(0.5 * (total - difference))


def _matched(
    modes: _Modes, forward: ComplexArray, backward: ComplexArray, rate: complex, depth_mm: float
) -> tuple[ComplexArray, ComplexArray]:
    """Return the amplitudes of growing and decaying modes by which no light enters at a wall."""
    left = np.exp(-modes.rate * depth_mm)
    at_wall = backward * np.exp(-rate * depth_mm)
    even = np.linalg.solve(modes.forward + modes.backward * left, -(forward + at_wall))
    odd = np.linalg.solve(modes.forward - modes.backward * left, -(forward - at_wall))
    return np.asarray(0.5 * (even - odd)), np.asarray(0.5 * (even + odd))
