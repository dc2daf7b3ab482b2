"""Transport in depth alone, for light that is uniform along the face or striped as exp(i q y).

A modulation keeps its form at every order, so that it costs a complex extinction
``sigma_t + i q sin(theta)`` and nothing more: what a stripe pattern keeps of each bounce is a
calculation of a hundredth of the tank's cost. It holds in the middle of a beam many stripes and
mean free paths wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.medium import Medium
from analysis.phase_function import Array, phase_function, scattering_moments
from analysis.transport.blas import on_one_thread

ComplexArray = NDArray[np.complex128]

MIN_ANGLES = 16
NEGLIGIBLE = 1e-12  # moments of the phase function below this share of the first scatter nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneGrid:
    """Nodes in depth and directions between the axes.

    Attributes
    ----------
    x_mm : (n_x,), rising from zero to the far wall
    theta_rad, weight_rad : (n,), directions and their quadrature weights; a direction of weight
        zero is carried along for its own sake
    """

    x_mm: Array
    theta_rad: Array
    weight_rad: Array

    @classmethod
    def graded(
        cls,
        depth_mm: float,
        *,
        sigma_t_per_mm: float,
        n_x: int,
        n_theta: int,
        striped: bool = False,
    ) -> PlaneGrid:
        """Return nodes that crowd at both walls, and Gauss-Legendre directions in each quadrant.

        Fluence behaves like x ln x at a wall and radiance changes quickly with direction where a
        ray grazes it; both are where the nodes are. Most nodes stand within the first ten mean
        free paths. For ``striped`` light the directions spread evenly: what a slanted ray brings
        oscillates with direction everywhere.

        Raises
        ------
        AnalysisError
            If there are fewer than 8 nodes or 16 directions, or they are no multiple of four.
        """
        if n_x < 8 or n_theta < MIN_ANGLES or n_theta % 4:
            msg = f"{n_x} nodes, {n_theta} angles: at least 8 and 16, the angles in fours."
            raise AnalysisError(msg)
        u = np.linspace(0.0, 1.0, n_x)
        even = u**2 * (3.0 - 2.0 * u)
        # Depths grow as sinh, so that a thick medium keeps its nodes where the light is.
        stretch = math.asinh(max(0.1 * sigma_t_per_mm * depth_mm, 1e-3))
        x_mm = depth_mm * np.sinh(stretch * even) / math.sinh(stretch)
        node, weight = np.polynomial.legendre.leggauss(n_theta // 4)
        v = 0.5 * (node + 1.0)
        share = v if striped else v**2 * (3.0 - 2.0 * v)
        density = np.ones_like(v) if striped else 6.0 * v * (1.0 - v)
        return cls(
            x_mm=x_mm,
            theta_rad=np.concatenate([0.5 * np.pi * (share + k) for k in range(4)]),
            weight_rad=np.tile(0.25 * np.pi * density * weight, 4),
        )

    def watching(self, theta_rad: Array) -> PlaneGrid:
        """Return this grid with directions added that scatter nothing but are solved for."""
        return PlaneGrid(
            x_mm=self.x_mm,
            theta_rad=np.concatenate([self.theta_rad, theta_rad]),
            weight_rad=np.concatenate([self.weight_rad, np.zeros(theta_rad.size)]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneField:
    """Every bounce against depth, as amplitudes of exp(i q (y - x tan(theta_0))) where q > 0.

    Attributes
    ----------
    fluence : (K, n_x), phi_k for k = 1 .. K, each for a scattering coefficient of one per mm,
        over exp(log_scale[k - 1])
    radiance : (K - 1, n, n_x), L_k for k = 2 .. K, likewise
    log_scale : (K,), its exponential is taken out, so that no order over- or underflows
    """

    grid: PlaneGrid
    fluence: ComplexArray
    radiance: ComplexArray
    log_scale: Array

    def weighted(self, sigma_s_per_mm: float) -> ComplexArray:
        """Return phi_k with sigma_s^(k-1) applied, (K, n_x)."""
        return np.asarray(self.fluence * self._weights(sigma_s_per_mm)[:, None])

    def at(self, x_mm: Array, sigma_s_per_mm: float, *, n_watched: int = 0) -> DepthField:
        """Return what is real of the weighted orders at other depths, by cubic splines.

        ``n_watched`` directions, the last of the grid, are returned as radiance.
        """
        nodes = self.grid.x_mm
        fluence = CubicSpline(nodes, self.weighted(sigma_s_per_mm).real, axis=1)(x_mm)
        if n_watched == 0:
            return DepthField(fluence=np.maximum(fluence, 0.0), radiance=None)
        watched = self.radiance[:, -n_watched:].real
        weight = self._weights(sigma_s_per_mm)[1:, None, None]
        radiance = CubicSpline(nodes, watched * weight, axis=2)(x_mm)
        return DepthField(fluence=np.maximum(fluence, 0.0), radiance=np.maximum(radiance, 0.0))

    def _weights(self, sigma_s_per_mm: float) -> Array:
        k = np.arange(self.fluence.shape[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.exp(np.where(k, k * np.log(sigma_s_per_mm), 0.0) + self.log_scale))


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthField:
    """Fluence (K, n_x) and radiance (K - 1, n, n_x) against depth."""

    fluence: Array
    radiance: Array | None


def solve_plane(
    medium: Medium,
    grid: PlaneGrid,
    *,
    n_bounces: int,
    angle_deg: float = 0.0,
    wavenumber_per_mm: float = 0.0,
) -> PlaneField:
    """Return bounces 1 .. n_bounces of a beam that enters as exp(i q y) (physics: Eqs. 1, 4).

    ``cos(theta) dL_k/dx + (sigma_t + i q sin(theta)) L_k = integral p L_(k-1) dtheta'``, black
    walls at either end, L_1 = exp(-(sigma_t + i q sin(theta_0)) x / cos(theta_0)); the second
    bounce is the closed form.

    Parameters
    ----------
    angle_deg : direction of the beam inside the medium
    wavenumber_per_mm : q = 2 pi / period of the stripes; zero for uniform light
    """
    slant = math.radians(angle_deg)
    theta, sigma_t, q = grid.theta_rad, medium.sigma_t_per_mm, wavenumber_per_mm
    extinction = sigma_t + 1j * q * np.sin(theta)
    beam_rate = (sigma_t + 1j * q * math.sin(slant)) / math.cos(slant)
    n_orders = int(np.count_nonzero(grid.weight_rad)) // 2
    basis, weights = scattering_moments(
        medium.g, medium.phase, theta, n_orders=n_orders, negligible=NEGLIGIBLE
    )
    to_moments, to_source = basis * grid.weight_rad, np.ascontiguousarray(basis.T * weights)
    source = phase_function(theta - slant, medium.g, medium.phase).astype(np.complex128)
    radiance = source[:, None] * _beam_integral(grid, extinction, beam_rate)
    fluence = [np.exp(-beam_rate * grid.x_mm)]
    field, log_scale = [radiance], [0.0, 0.0]
    steps = node_steps(grid.x_mm, np.cos(theta), extinction)
    for k in range(2, n_bounces + 1):
        moments = _real_times(to_moments, field[-1])
        fluence.append(moments[0].copy())
        if k == n_bounces:
            break
        brightest = float(np.abs(moments[0]).max())
        if brightest > 0.0:
            moments /= brightest
        log_scale.append(log_scale[-1] + (math.log(brightest) if brightest > 0.0 else 0.0))
        field.append(carry(_real_times(to_source, moments), np.cos(theta) > 0.0, *steps))
    turn = np.exp(1j * q * math.tan(slant) * grid.x_mm)  # seen along the beam's own stripes
    return PlaneField(
        grid=grid,
        fluence=np.array(fluence[:n_bounces]) * turn,
        radiance=np.array(field[: n_bounces - 1]).reshape(-1, theta.size, grid.x_mm.size) * turn,
        log_scale=np.array(log_scale[:n_bounces]),
    )


def _beam_integral(grid: PlaneGrid, extinction: ComplexArray, beam_rate: complex) -> ComplexArray:
    """Integrate L_1 back along every direction to the wall, (n, n_x), mm."""
    x, depth = grid.x_mm, grid.x_mm[-1]
    cos_t = np.cos(grid.theta_rad)[:, None]
    length = np.where(cos_t > 0.0, x, depth - x) / np.abs(cos_t)
    rate = extinction[:, None] - beam_rate * cos_t
    # Where the ray leaves the beam behind quickly the exponential overflows against a source
    # that has underflowed: both are joined before they are taken.
    start, span = -beam_rate * x, -rate * length
    thin = np.abs(span) < 1e-3
    safe = np.where(thin, 1.0, rate)
    closed = (np.exp(start) - np.exp(start + span)) / safe
    series = np.exp(start) * length * (1.0 + span / 2.0 + span**2 / 6.0 + span**3 / 24.0)
    return np.asarray(np.where(thin, series, closed))


def _real_times(matrix: Array, vectors: ComplexArray) -> ComplexArray:
    with on_one_thread():
        return np.asarray((matrix @ vectors.view(np.float64)).view(np.complex128))


def node_steps(
    x_mm: Array, cos_theta: Array, extinction: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return what a ray keeps from node to node, and the weights of the source on its way.

    (n, n_x) and (3, n, n_x), the source being that at the node before, at, and behind a node; at
    the last one the parabola leans on the ray's past instead.
    """
    left = np.zeros((cos_theta.size, x_mm.size), dtype=np.complex128)
    share = np.zeros((3, cos_theta.size, x_mm.size), dtype=np.complex128)
    for forward in (True, False):
        index = np.flatnonzero((cos_theta > 0.0) == forward)
        x = x_mm if forward else x_mm[-1] - x_mm[::-1]
        width = np.diff(x)
        ratio = np.append(width[1:] / width[:-1], -1.0 - width[-2] / width[-1])
        path = width / np.abs(cos_theta[index, None])
        tau = extinction[index, None] * path
        e0, e1, e2 = _moments(tau)
        behind = (e2 - e1) / (ratio * (1.0 + ratio))
        before = e1 + (e2 - e1) / (1.0 + ratio)
        way = slice(1, None) if forward else slice(-2, None, -1)
        left[index, way] = np.exp(-tau)
        for part, weight in zip(share, (before, e0 - before - behind, behind), strict=True):
            part[index, way] = path * weight
    return left, share


@njit(cache=True, nogil=True)
def _moments(tau: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the integrals of t^k exp(-tau t) over 0 .. 1 for k = 0, 1, 2."""
    flat = tau.ravel()
    found = np.zeros((3, flat.size), dtype=np.complex128)
    for i in range(flat.size):
        rate = flat[i]
        if abs(rate) < 0.5:
            term = 1.0 + 0.0j
            for n in range(16):
                for k in range(3):
                    found[k, i] += term / (n + 1 + k)
                term = -term * rate / (n + 1)
        else:
            left = np.exp(-rate)
            found[0, i] = (1.0 - left) / rate
            found[1, i] = (found[0, i] - left) / rate
            found[2, i] = (2.0 * found[1, i] - left) / rate
    return (
        found[0].reshape(tau.shape),
        found[1].reshape(tau.shape),
        found[2].reshape(tau.shape),
    )


@njit(cache=True, nogil=True)
def carry(
    source: ComplexArray, forward: NDArray[np.bool_], left: ComplexArray, share: ComplexArray
) -> ComplexArray:
    """Carry ``source`` (n, n_x) along its directions, nothing entering at the walls."""
    out = np.zeros_like(source)
    last = source.shape[1] - 1
    for n in range(source.shape[0]):
        step = 1 if forward[n] else -1
        i = 0 if forward[n] else last
        for done in range(1, last + 1):
            i += step
            beyond = i + step if done < last else i - 2 * step
            added = share[0, n, i] * source[n, i - step] + share[1, n, i] * source[n, i]
            out[n, i] = left[n, i] * out[n, i - step] + added + share[2, n, i] * source[n, beyond]
    return out
