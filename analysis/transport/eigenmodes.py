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
from analysis.phase_function import Array, fourier_coefficients
from analysis.transport.blas import on_one_thread

ComplexArray = NDArray[np.complex128]

LARGEST_ALBEDO = 1.0 - 1e-9  # at one, two modes of uniform light are the same


@dataclass(frozen=True, slots=True)
class _Quadrant:
    """Directions of one quadrant, by which all four are known, and what they scatter.

    The moments of the phase function beyond those that the directions resolve are those of a
    forward spike, and what a spike scatters is not scattered (Wiscombe 1977, delta-M).

    Attributes
    ----------
    theta_rad, weight_rad : (n,)
    even, odd : (n_orders, n), cos(m theta) and sin(m theta)
    moment : (n_orders,), less the spike's
    spike : part of the phase function that is forward
    """

    theta_rad: Array
    weight_rad: Array
    even: Array
    odd: Array
    moment: Array
    spike: float


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
    equal_steps: bool = False,
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
    n_theta : directions
    equal_steps : by these, stripes are resolved down to a depth of about n_theta / q with the
        fewest directions. Else the points of Gauss in every quadrant, which suit light that jumps
        at 90 degrees, as all that is nearly uniform does near a wall

    Raises
    ------
    AnalysisError
        If ``n_theta`` is no multiple of four from 16 on.
    """
    if n_theta < 16 or n_theta % 4:
        msg = f"{n_theta} directions: a multiple of four from 16 on is needed."
        raise AnalysisError(msg)
    slant = math.radians(angle_deg)
    q = wavenumber_per_mm
    turn = np.exp(1j * q * math.tan(slant) * x_mm)
    if medium.sigma_s_per_mm == 0.0:
        return np.asarray(np.exp(-medium.sigma_t_per_mm * x_mm / math.cos(slant)) + 0j)
    quadrant = _quadrant(medium.g, medium.phase, n_theta, equal_steps)
    sigma_s = min(medium.sigma_s_per_mm, LARGEST_ALBEDO * medium.sigma_t_per_mm)
    sigma_t = medium.sigma_t_per_mm - sigma_s * quadrant.spike
    rate = (sigma_t + 1j * q * math.sin(slant)) / math.cos(slant)
    with on_one_thread():
        same, cross = _operator(quadrant, sigma_t, sigma_s, q)
        from_beam = _source(quadrant, sigma_s, slant)
        n = quadrant.theta_rad.size
        if q == 0.0:  # even and odd light do not mix, and the fluence is even
            same, cross, from_beam = same[:n, :n], cross[:n, :n], from_beam[:, :n]
        cos_t = np.resize(np.cos(quadrant.theta_rad), same.shape[0])
        together, apart = same + cross, same - cross
        inverse = np.asarray(np.linalg.inv(together), dtype=np.float64)
        modes = _decaying_modes(together, apart, inverse, cos_t)
        forward, backward = _following_the_beam(apart, inverse, cos_t, rate, from_beam)
        rising, falling = _matched(modes, forward, backward, rate, depth_mm)
        # The fluence is the even light of all directions; each stands for two.
        seen = 2.0 * quadrant.weight_rad
        of_mode = seen @ (modes.forward + modes.backward)[:n]
        of_beam = 1.0 + seen @ (forward + backward)[:n]
        decay = np.exp(-np.outer(x_mm, modes.rate)) * of_mode
        growth = np.exp(-np.outer(depth_mm - x_mm, modes.rate)) * of_mode
        light = of_beam * np.exp(-rate * x_mm) + decay @ falling + growth @ rising
    return np.asarray(light * turn)


@lru_cache(maxsize=8)  # one medium is asked for at several wavenumbers
def _quadrant(g: float, phase: Phase, n_theta: int, equal_steps: bool) -> _Quadrant:
    n = n_theta // 4
    if equal_steps:
        theta, weight, n_orders = (
            equal_angles(n_theta)[:n],
            np.full(n, 2.0 * np.pi / n_theta),
            2 * n,
        )
    else:
        point, share = np.polynomial.legendre.leggauss(n)
        theta, weight = 0.25 * np.pi * (point + 1.0), 0.25 * np.pi * share
        n_orders = 3 * n // 2  # more, they do not tell apart
    moment = fourier_coefficients(g, phase, n_orders + 1)
    spike = float(moment[-1]) if g > 0.0 else 0.0
    m = np.arange(n_orders)[:, None]
    return _Quadrant(
        theta, weight, np.cos(m * theta), np.sin(m * theta), moment[:-1] - spike, spike
    )


def _weights(quadrant: _Quadrant, sigma_s: float) -> Array:
    """Return how strongly light of each moment is scattered, (n_orders,)."""
    weight = quadrant.moment * (sigma_s / np.pi)
    weight[0] *= 0.5
    return np.asarray(weight)


def _operator(quadrant: _Quadrant, sigma_t: float, sigma_s: float, q: float) -> tuple[Array, Array]:
    """Return what removes and scatters light within a hemisphere, and across, (2 n, 2 n).

    First the even light of a quadrant, then the odd.
    """
    n, even, odd = quadrant.theta_rad.size, quadrant.even, quadrant.odd
    seen = 2.0 * quadrant.weight_rad
    weight = _weights(quadrant, sigma_s)
    turned = weight * (-1.0) ** np.arange(weight.size)  # cos(m (pi - theta))
    same, cross = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    within, over = (even.T * weight) @ even * seen, (even.T * turned) @ even * seen
    # What the quadrature loses of the scattered light stays in its direction.
    lost = (
        sigma_s * quadrant.moment[0] - quadrant.weight_rad @ (within + over) / quadrant.weight_rad
    )
    same[:n, :n], same[n:, n:] = -within, -(odd.T * weight) @ odd * seen
    cross[:n, :n], cross[n:, n:] = over, -(odd.T * turned) @ odd * seen
    same[np.diag_indices(2 * n)] += sigma_t - np.tile(lost, 2)
    across = q * np.sin(quadrant.theta_rad)
    same[np.arange(n), np.arange(n, 2 * n)] -= across
    same[np.arange(n, 2 * n), np.arange(n)] += across
    return same, cross


def _source(quadrant: _Quadrant, sigma_s: float, slant: float) -> ComplexArray:
    """Return what the beam scatters into the forward and the backward hemisphere, (2, 2 n)."""
    m = np.arange(quadrant.moment.size)
    turned = (-1.0) ** m
    even = _weights(quadrant, sigma_s) * np.cos(m * slant)
    odd = -1j * _weights(quadrant, sigma_s) * np.sin(m * slant)
    return np.stack(
        [
            np.concatenate([even @ quadrant.even, odd @ quadrant.odd]),
            np.concatenate([(even * turned) @ quadrant.even, -(odd * turned) @ quadrant.odd]),
        ]
    )


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
    source: ComplexArray,
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
