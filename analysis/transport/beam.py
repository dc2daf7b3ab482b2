"""The ballistic beam L_1 and the closed form of the second bounce L_2.

Along the ray that arrives at (x, y) in direction theta, the part that lies in a lit strip is one
interval, and the light set out on it is a linear function times an exponential. So L_2 has no
spatial error at all, at any point and for any width, slant and profile of the beam.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.light_field import Grid
from analysis.medium import Beam, Tank
from analysis.phase_function import Array

LEAST_DEPTH = 1e-30  # optical: the integral over less is that over nothing, to the last digit
# Optical depths below which a series of five terms is more exact than a difference.
THIN = {np.float64: 0.02, np.float32: 0.1}
TOGETHER = 16384  # integrals at a time, which the nearer memory holds


def ballistic_fluence(
    x_mm: Array, y_mm: Array, *, sigma_t_per_mm: float, beam: Beam
) -> NDArray[np.float64]:
    """Return phi_1 = E exp(-sigma_t d) in the lit strip, zero outside, (n_y, n_x).

    ``d = x / cos(theta_0)`` is the path inside the medium, E the irradiance where the light
    entered. A node on the strip's edge gets one half, the mean of both sides.
    """
    angle = math.radians(beam.angle_deg)
    entry = y_mm[:, None] - x_mm[None, :] * math.tan(angle)
    lit = np.heaviside(entry - beam.from_mm, 0.5) * np.heaviside(beam.to_mm - entry, 0.5)
    lit *= np.interp(entry, *beam.profile_points())
    return np.asarray(lit * np.exp(-sigma_t_per_mm * x_mm[None, :] / math.cos(angle)))


def second_bounce(
    grid: Grid,
    beam: Beam,
    theta_rad: Array,
    *,
    sigma_t_per_mm: float,
    weight: Array,
    lines_of_x: bool = False,
    out: Array | None = None,
) -> Array:
    """Return weight(theta) times the beam integral at every node, (n, n_y, n_x).

    The beam integral is exp(-sigma_t s) L_1 integrated backwards along the ray, in mm; with
    ``weight = sigma_s p(theta - theta_0)`` this is L_2 exactly. ``lines_of_x`` returns it as
    (n, n_x, n_y). It is written over ``out`` if that is given, in its precision.
    """
    places = places_of(grid, lines_of_x=lines_of_x)
    if out is None:
        out = np.empty((theta_rad.size, places[0].size, places[1].size))
    beam_integral(places, theta_rad, weight, beam, grid.tank, sigma_t_per_mm, out)
    return out


def places_of(grid: Grid, *, lines_of_x: bool = False) -> tuple[Array, Array, Array, Array]:
    """Return x of each line and of each node on it, y of each line and of each node, mm.

    The point (p, q) is at (x_line[p] + x_node[q], y_line[p] + y_node[q]); one of either is zero.
    """
    x, y = grid.x_mm, grid.y_mm
    if lines_of_x:
        return x, np.zeros(grid.n_y), np.zeros(grid.n_x), y
    return np.zeros(grid.n_y), x, y, np.zeros(grid.n_x)


def beam_integral(
    places: tuple[Array, Array, Array, Array],
    theta_rad: Array,
    weight: Array,
    beam: Beam,
    tank: Tank,
    sigma_t_per_mm: float,
    out: Array,
) -> None:
    """Write weight(theta) times the integral of exp(-sigma_t s) L_1 backwards along rays.

    Parameters
    ----------
    places : see `places_of`
    theta_rad, weight : (n,), the rays' directions and what each is multiplied by
    out : (n, n_lines, n_nodes), mm; in single precision so is the integral, to some 1e-6 of itself

    Notes
    -----
    Over one linear piece of the profile the integrand is exp(-base - rate s) times a linear
    function. It is counted from the brighter end, with base + rate s and tau = abs(rate) length
    there: the other end may underflow where the beam is grazing.
    """
    heights, irradiance = beam.profile_points()
    rays = _describe_rays(theta_rad, math.radians(beam.angle_deg), sigma_t_per_mm)
    walls = (tank.depth_mm, tank.width_mm)
    at_once = max(1, TOGETHER // math.prod(out.shape[1:]))
    for first in range(0, theta_rad.size, at_once):
        some = slice(first, first + at_once)
        fading, left, more, dark = np.empty((4, *out[some].shape), dtype=out.dtype)
        for k in range(heights.size - 1):
            strip = (heights[k], heights[k + 1], irradiance[k], irradiance[k + 1])
            bright, end = out[some] if k == 0 else more, dark if strip[2] != strip[3] else None
            _cut_rays(*places, rays[some], weight[some], walls, strip, fading, left, bright, end)
            _integrate(fading, left, bright, end)
            if k > 0:
                out[some] += bright


def _integrate(fading: Array, left: Array, bright: Array, dark: Array | None) -> None:
    """Turn ``bright`` into exp(fading) times the integral of exp(left t) over 0 .. 1.

    Both exponents are negative. With what rises linearly from ``bright`` to ``dark`` as a factor;
    without ``dark`` it stays.
    """
    e0 = np.expm1(left)
    e0 /= left
    if dark is None:
        bright *= e0
    else:
        e1 = (np.exp(left) - e0) / left
        # The closed form loses its digits where little is left to fade; the series is exact.
        thin = np.flatnonzero(left.ravel() > -THIN[left.dtype.type])
        few = left.ravel()[thin]
        e1.ravel()[thin] = 1 / 2 + few * (1 / 3 + few * (1 / 8 + few * (1 / 30 + few / 144)))
        bright *= e0 - e1
        bright += dark * e1
    bright *= np.exp(fading, out=fading)


def _describe_rays(theta_rad: Array, slant_rad: float, sigma_t_per_mm: float) -> Array:
    """Return what the rays of each direction share, (n, 6).

    1/cos and 1/sin of the direction (infinite along an axis); the beam's slope; by how much the
    height of entry falls per mm back along the ray; the beam's extinction per mm of depth, and
    that of ray and beam together per mm back along the ray.
    """
    cos_t, sin_t = np.cos(theta_rad), np.sin(theta_rad)
    cos_0, slope = math.cos(slant_rad), math.tan(slant_rad)
    drift = sin_t - cos_t * slope
    rays = np.empty((theta_rad.size, 6))
    rays[:, :2] = np.inf
    np.divide(1.0, cos_t, out=rays[:, 0], where=cos_t != 0.0)
    np.divide(1.0, sin_t, out=rays[:, 1], where=sin_t != 0.0)
    rays[:, 2] = slope
    rays[:, 3] = np.where(np.abs(drift) > 1e-14, drift, 0.0)
    rays[:, 4] = sigma_t_per_mm / cos_0
    rays[:, 5] = sigma_t_per_mm * (1.0 - cos_t / cos_0)
    return rays


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_rays(
    x_line: Array,
    x_node: Array,
    y_line: Array,
    y_node: Array,
    rays: Array,
    weight: Array,
    tank: tuple[float, float],
    strip: tuple[float, float, float, float],
    fading: Array,
    left: Array,
    bright: Array,
    dark: Array | None,
) -> None:
    """Find the piece of each ray that lies in one strip of the beam, for `beam_integral`.

    Its ends have the optical depths -``fading`` and -fading - ``left``; ``bright`` and ``dark``
    are the irradiance that entered there times the piece's length and the direction's weight, zero
    for a ray that misses. ``left`` is never quite zero, no special case later on.
    """
    low, high, at_low, at_high = strip
    rise = (at_high - at_low) / (high - low)
    for n in range(rays.shape[0]):
        inverse_cos, inverse_sin, slope, drift, beam_rate, rate = rays[n]
        wall_x = 0.0 if inverse_cos > 0.0 else tank[0]
        wall_y = 0.0 if inverse_sin > 0.0 else tank[1]
        per_entry = 1.0 / drift if drift != 0.0 else 0.0
        for p in range(fading.shape[1]):
            for q in range(fading.shape[2]):
                x, y = x_line[p] + x_node[q], y_line[p] + y_node[q]
                far_x = (x - wall_x) * inverse_cos if inverse_cos != math.inf else 1e300
                far_y = (y - wall_y) * inverse_sin if inverse_sin != math.inf else 1e300
                entry = y - x * slope
                share = 1.0
                if drift != 0.0:
                    s_low, s_high = (entry - low) * per_entry, (entry - high) * per_entry
                else:
                    s_low, s_high = (-1e300, 1e300) if low <= entry <= high else (0.0, 0.0)
                    # A ray along the strip's edge sees the mean of both sides.
                    if min(abs(entry - low), abs(entry - high)) == 0.0:
                        share = 0.5
                begin = max(0.0, min(s_low, s_high))
                end = max(begin, min(far_x, far_y, max(s_low, s_high)))
                span = end - begin
                near, deep = (begin, end) if rate >= 0.0 else (end, begin)
                fading[n, p, q] = -(beam_rate * x + rate * near)
                left[n, p, q] = -max(abs(rate) * span, LEAST_DEPTH)
                share *= weight[n] * span
                bright[n, p, q] = share * max(at_low + rise * (entry - drift * near - low), 0.0)
                if dark is not None:  # known when it is compiled
                    dark[n, p, q] = share * max(at_low + rise * (entry - drift * deep - low), 0.0)
