"""The ballistic beam L_1 and the closed form of the second bounce L_2.

Along the ray that arrives at (x, y) in direction theta, the part that lies in the lit strip is
one interval, and the light set out on it is the exponential of a linear function. So L_2 has no
spatial error at all, at any point and for any width and slant of the beam.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.light_field import Grid
from analysis.medium import Beam, Tank
from analysis.phase_function import Array


def ballistic_fluence(
    x_mm: Array, y_mm: Array, *, sigma_t_per_mm: float, beam: Beam
) -> NDArray[np.float64]:
    """Return phi_1 = exp(-sigma_t d) in the lit strip, zero outside, (n_y, n_x).

    ``d = x / cos(theta_0)`` is the path inside the medium. A node on the strip's edge gets one
    half, the mean of both sides.
    """
    angle = math.radians(beam.angle_deg)
    entry = y_mm[:, None] - x_mm[None, :] * math.tan(angle)
    lit = np.heaviside(entry - beam.from_mm, 0.5) * np.heaviside(beam.to_mm - entry, 0.5)
    return np.asarray(lit * np.exp(-sigma_t_per_mm * x_mm[None, :] / math.cos(angle)))


@njit(cache=True, nogil=True)
def integrate_strip(
    x: float,
    y: float,
    cos_t: float,
    sin_t: float,
    depth: float,
    width: float,
    low: float,
    high: float,
    cos_0: float,
    sin_0: float,
    sigma_t: float,
) -> float:
    """Integrate exp(-sigma_t s) L_1 backwards along a ray from (x, y), in mm.

    ``s`` counts back along the direction (cos_t, sin_t), up to the wall of the tank;
    L_1 = exp(-sigma_t d) inside the strip low < y - x tan(theta_0) < high.
    """
    far = 1e300
    if cos_t > 0.0:
        far = min(far, x / cos_t)
    elif cos_t < 0.0:
        far = min(far, (x - depth) / cos_t)
    if sin_t > 0.0:
        far = min(far, y / sin_t)
    elif sin_t < 0.0:
        far = min(far, (y - width) / sin_t)
    near = 0.0
    tan_0 = sin_0 / cos_0
    entry = y - x * tan_0
    drift = sin_t - cos_t * tan_0
    if abs(drift) < 1e-14:
        if entry <= low or entry >= high:
            return 0.0
    else:
        s_low = (entry - low) / drift
        s_high = (entry - high) / drift
        near = max(near, min(s_low, s_high))
        far = min(far, max(s_low, s_high))
    if far <= near:
        return 0.0
    rate = sigma_t * (1.0 - cos_t / cos_0)
    # Start from the brighter end: the other one may underflow where the beam is grazing.
    bright = near if rate >= 0.0 else far
    brightest = math.exp(-sigma_t * x / cos_0 - rate * bright)
    span = far - near
    if rate == 0.0:
        return brightest * span
    return -brightest * math.expm1(-abs(rate) * span) / abs(rate)


@njit(cache=True, nogil=True)
def _fill_second_bounce(
    x: Array,
    y: Array,
    theta: Array,
    tank_beam: Array,
    sigma_t: float,
    weight: Array,
    out: Array,
) -> None:
    """Fill out (n_theta, n_y, n_x) with weight * integrate_strip."""
    depth, width, low, high, cos_0, sin_0 = tank_beam
    for n in range(theta.size):
        cos_t, sin_t = math.cos(theta[n]), math.sin(theta[n])
        for j in range(y.size):
            for i in range(x.size):
                out[n, j, i] = weight[n] * integrate_strip(
                    x[i], y[j], cos_t, sin_t, depth, width, low, high, cos_0, sin_0, sigma_t
                )


def second_bounce(
    grid: Grid, beam: Beam, *, sigma_t_per_mm: float, weight: Array
) -> NDArray[np.float64]:
    """Return weight(theta) times the strip integral at every node, (n_theta, n_y, n_x).

    With ``weight = sigma_s p(theta - theta_0)`` this is L_2 exactly.
    """
    out = np.empty((grid.n_theta, grid.n_y, grid.n_x))
    _fill_second_bounce(
        grid.x_mm,
        grid.y_mm,
        grid.theta_rad,
        _tank_and_beam(grid.tank, beam),
        sigma_t_per_mm,
        weight,
        out,
    )
    return out


def _tank_and_beam(tank: Tank, beam: Beam) -> NDArray[np.float64]:
    angle = math.radians(beam.angle_deg)
    return np.array(
        [
            tank.depth_mm,
            tank.width_mm,
            beam.from_mm,
            beam.to_mm,
            math.cos(angle),
            math.sin(angle),
        ]
    )
