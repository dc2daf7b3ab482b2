"""Discrete ordinates: every bounce from the one before by short characteristics (Eqs. 1, 4).

L_2 is the closed form; each later order is swept along every direction through the grid, with
cubic interpolation across the sweep and a parabolic source along the ray.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numba import njit

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium
from analysis.phase_function import UNRESOLVED, Array, convolution_matrix, phase_function
from analysis.transport.beam import ballistic_fluence, second_bounce


def solve(medium: Medium, beam: Beam, grid: Grid, *, n_bounces: int) -> BounceField:
    """Return fluence and light field of bounces 1 .. n_bounces in the tank of ``grid``.

    Raises
    ------
    AnalysisError
        As `march` does.
    """
    fluence = np.empty((n_bounces, grid.n_y, grid.n_x))
    light_field = np.empty((max(n_bounces - 1, 0), grid.n_y, grid.n_x, grid.n_theta))
    fluence[0] = ballistic_fluence(
        grid.x_mm, grid.y_mm, sigma_t_per_mm=medium.sigma_t_per_mm, beam=beam
    )
    for k, radiance in enumerate(march(medium, beam, grid, n_bounces=n_bounces), start=2):
        weight = medium.albedo ** (k - 1)
        fluence[k - 1] = weight * fluence_of(radiance)
        light_field[k - 2] = weight * np.moveaxis(radiance, 0, -1)
    return BounceField(
        medium=medium, beam=beam, grid=grid, fluence=fluence, light_field=light_field
    )


def march(medium: Medium, beam: Beam, grid: Grid, *, n_bounces: int) -> Iterator[Array]:
    """Yield L_k of bounces k = 2 .. n_bounces for an albedo of one, (n_theta, n_y, n_x) each.

    ``w . grad L_k + sigma_t L_k = sigma_t integral p(theta - theta') L_(k-1)(theta') dtheta'``
    with black walls. Marching at sigma_s = sigma_t keeps high orders from over- or underflowing;
    the true L_k is this one times (sigma_s / sigma_t)^(k-1). The array yielded is overwritten by
    the next bounce.

    Raises
    ------
    AnalysisError
        If fewer than two bounces are asked for, the beam leaves the tank's face, or the angles
        cannot resolve the phase function (g^(n_theta/2) above one percent).
    """
    if n_bounces < 2:
        msg = f"n_bounces = {n_bounces}: at least two are needed for multiple scattering."
        raise AnalysisError(msg)
    beam.within(grid.tank)
    unresolved = abs(medium.g) ** (grid.n_theta // 2)
    if unresolved > UNRESOLVED:
        msg = (
            f"{grid.n_theta} angles cannot resolve g = {medium.g} "
            f"(|g|^(n/2) = {unresolved:.2g} > {UNRESOLVED}); use more angles."
        )
        raise AnalysisError(msg)
    sigma_t = medium.sigma_t_per_mm
    theta = grid.theta_rad
    scatter = sigma_t * convolution_matrix(medium.g, medium.phase, grid.n_theta)
    from_beam = phase_function(theta - math.radians(beam.angle_deg), medium.g, medium.phase)
    radiance = second_bounce(grid, beam, sigma_t_per_mm=sigma_t, weight=sigma_t * from_beam)
    yield radiance
    for _ in range(3, n_bounces + 1):
        source = scatter @ radiance.reshape(grid.n_theta, -1)
        sweep(source, theta, grid, sigma_t, radiance)
        yield radiance


def fluence_of(radiance: Array) -> Array:
    """Return the integral of a light field (n_theta, n_y, n_x) over direction."""
    return np.asarray((2.0 * np.pi / radiance.shape[0]) * radiance.sum(axis=0))


def sweep(source: Array, theta_rad: Array, grid: Grid, sigma_t_per_mm: float, out: Array) -> None:
    """Carry ``source`` (n_theta, n_y * n_x) along its directions into ``out``, in place.

    ``out`` (n_theta, n_y, n_x) is the radiance set out by the source per mm of path, attenuated
    on its way, with nothing entering through the walls.
    """
    x, y = grid.x_mm, grid.y_mm
    _sweep(
        source.reshape(grid.n_theta, -1),
        theta_rad,
        (grid.n_y, grid.n_x),
        (y[1] - y[0], x[1] - x[0]),
        sigma_t_per_mm,
        out.reshape(grid.n_theta, -1),
    )


@njit(cache=True, nogil=True)
def _cubic_weights(
    position: float,
) -> tuple[float, float, float, float]:
    """Return the Lagrange weights of nodes 0, 1, 2, 3 for a point at ``position``."""
    a, b, c, d = position, position - 1.0, position - 2.0, position - 3.0
    return -b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0


@njit(cache=True, nogil=True)
def _interpolate(line: Array, start: int, stride: int, n: int, position: float) -> float:
    """Return the cubic through a strided line of n nodes at a fractional node position."""
    first = min(max(math.floor(position) - 1, 0), n - 4)
    w0, w1, w2, w3 = _cubic_weights(position - first)
    at = start + first * stride
    near: float = w0 * line[at] + w1 * line[at + stride]
    far: float = w2 * line[at + 2 * stride] + w3 * line[at + 3 * stride]
    return near + far


@njit(cache=True, nogil=True)
def _exponential_moments(tau: float) -> tuple[float, float, float]:
    """Return the integrals of x^k exp(-tau x) over 0 .. 1 for k = 0, 1, 2."""
    if tau < 0.3:
        # The closed forms cancel here; the series reaches rounding in a dozen terms.
        e0, e1, e2, term = 0.0, 0.0, 0.0, 1.0
        for n in range(14):
            e0 += term / (n + 1)
            e1 += term / (n + 2)
            e2 += term / (n + 3)
            term *= -tau / (n + 1)
        return e0, e1, e2
    left = math.exp(-tau)
    e0 = (1.0 - left) / tau
    e1 = (e0 - left) / tau
    return e0, e1, (2.0 * e1 - left) / tau


@njit(cache=True, nogil=True)
def _sweep(
    source: Array,
    theta: Array,
    shape: tuple[int, int],
    pitch: tuple[float, float],
    sigma_t: float,
    out: Array,
) -> None:
    """March each direction line by line; a line lies across the axis the ray crosses first."""
    n_y, n_x = shape
    h_y, h_x = pitch
    for n in range(theta.size):
        cos_t, sin_t = math.cos(theta[n]), math.sin(theta[n])
        step_x, step_y = (1 if cos_t > 0.0 else -1), (n_x if sin_t > 0.0 else -n_x)
        start = (0 if cos_t > 0.0 else n_x - 1) + (0 if sin_t > 0.0 else (n_y - 1) * n_x)
        if abs(cos_t) * h_y >= abs(sin_t) * h_x:
            shift, path = abs(sin_t / cos_t) * h_x / h_y, h_x / abs(cos_t)
            _march(source[n], start, (step_x, step_y), (n_x, n_y), shift, path, sigma_t, out[n])
        else:
            shift, path = abs(cos_t / sin_t) * h_y / h_x, h_y / abs(sin_t)
            _march(source[n], start, (step_y, step_x), (n_y, n_x), shift, path, sigma_t, out[n])


@njit(cache=True, nogil=True)
def _march(
    source: Array,
    start: int,
    strides: tuple[int, int],
    counts: tuple[int, int],
    shift: float,
    path: float,
    sigma_t: float,
    out: Array,
) -> None:
    """Fill one direction. Rays reach node (p, q) from line p - 1 at q - shift, 0 <= shift <= 1.

    Node (p, q) of ``out`` and ``source`` is at start + p * strides[0] + q * strides[1].
    """
    along, across = strides
    n_lines, n_nodes = counts
    tau = sigma_t * path
    left = math.exp(-tau)
    e0, e1, e2 = _exponential_moments(tau)
    # The point lies between the middle two of the four nodes q-2 .. q+1.
    w0, w1, w2, w3 = _cubic_weights(2.0 - shift)
    for q in range(n_nodes):
        out[start + q * across] = 0.0
    for p in range(1, n_lines):
        here = start + p * along
        back, ahead = here - along, here + along
        out[here] = 0.0
        for q in range(1, n_nodes):
            node = here + q * across
            behind = back + q * across
            s_p = source[node]
            if 2 <= q < n_nodes - 1:
                far, near, beyond = behind - 2 * across, behind - across, behind + across
                l_u = w0 * out[far] + w1 * out[near] + w2 * out[behind] + w3 * out[beyond]
                s_u = (
                    w0 * source[far] + w1 * source[near] + w2 * source[behind] + w3 * source[beyond]
                )
            else:
                l_u = _interpolate(out, back, across, n_nodes, q - shift)
                s_u = _interpolate(source, back, across, n_nodes, q - shift)
            if p < n_lines - 1 and q < n_nodes - 1:
                if 0 < q < n_nodes - 2:
                    mirror = ahead + q * across
                    s_d = (
                        w3 * source[mirror - across]
                        + w2 * source[mirror]
                        + w1 * source[mirror + across]
                        + w0 * source[mirror + 2 * across]
                    )
                else:
                    s_d = _interpolate(source, ahead, across, n_nodes, q + shift)
                emitted = (e0 - e2) * s_p + 0.5 * (e1 + e2) * s_u + 0.5 * (e2 - e1) * s_d
            elif p > 1 and q >= 2:
                # At the walls the light leaves by, the parabola leans on the ray's past.
                s_uu = _interpolate(source, back - along, across, n_nodes, q - 2.0 * shift)
                emitted = (
                    (e0 - 1.5 * e1 + 0.5 * e2) * s_p
                    + (2.0 * e1 - e2) * s_u
                    + 0.5 * (e2 - e1) * s_uu
                )
            else:
                emitted = (e0 - e1) * s_p + e1 * s_u
            value = left * l_u + path * emitted
            if value < 0.0 or l_u < 0.0 or emitted < 0.0:
                # Cubic and parabola may undershoot beside an edge; linear cannot.
                lower = behind - across
                l_u = shift * out[lower] + (1.0 - shift) * out[behind]
                s_u = shift * source[lower] + (1.0 - shift) * source[behind]
                value = left * l_u + path * ((e0 - e1) * s_p + e1 * s_u)
            out[node] = value
