"""Monte Carlo kernels for a tank that is not black: paths folded at walls that give light back.

They also carry stripes that lose their sharpness with depth. A tank with black walls and a sharp
projector has no need of them, and does not load them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.transport.montecarlo_kernels import (
    Array,
    deflect,
    draw,
    lit_length,
    score_ray,
    wall_distance,
)

LEGS = 64  # pieces of a folded ray at most
FAINT = 1e-5  # share of the light at which a ray ends


@njit(cache=True, nogil=True)
def turned_back(index: float, cosine: float) -> float:
    """Return the share of unpolarised light that a bare surface to air turns back (Fresnel)."""
    a = abs(cosine)
    sine = index * math.sqrt(max(1.0 - a * a, 0.0))
    if sine >= 1.0:
        return 1.0
    b = math.sqrt(1.0 - sine * sine)
    s = (index * a - b) / (index * a + b)
    p = (index * b - a) / (index * b + a)
    return 0.5 * (s * s + p * p)


@njit(cache=True, nogil=True)
def fold(
    place: tuple[float, float],
    direction: tuple[float, float],
    tank: Array,
    sigma_t: float,
    walls: Array,
    legs: Array,
) -> int:
    """Follow a ray from wall to wall until it is faint; return the number of its legs.

    Parameters
    ----------
    tank : depth, width, mm
    walls : refractive index behind the lit face, reflectance of all other walls
    legs : (LEGS, 6), filled with x, y, cos, sin, length, and the share of the light at its begin
    """
    x, y = place
    cos_t, sin_t = direction
    share = 1.0
    for n in range(legs.shape[0]):
        to_x = (tank[0] - x) / cos_t if cos_t > 0.0 else (-x / cos_t if cos_t < 0.0 else 1e300)
        reach = wall_distance(x, y, cos_t, sin_t, tank[0], tank[1])
        legs[n, 0], legs[n, 1], legs[n, 2] = x, y, cos_t
        legs[n, 3], legs[n, 4], legs[n, 5] = sin_t, reach, share
        share *= math.exp(-sigma_t * reach)
        x = min(max(x + reach * cos_t, 0.0), tank[0])
        y = min(max(y + reach * sin_t, 0.0), tank[1])
        if to_x <= reach * (1.0 + 1e-12):
            share *= walls[1] if cos_t > 0.0 else turned_back(walls[0], cos_t)
            cos_t = -cos_t
        else:
            share *= walls[1]
            sin_t = -sin_t
        if share < FAINT:
            return n + 1
    return int(legs.shape[0])


@njit(cache=True, nogil=True)
def collide(legs: Array, n_legs: int, sigma_t: float, u: float) -> tuple[int, float, float]:
    """Draw where a folded ray collides: its leg, the way along it, and its lit length in all."""
    total = 0.0
    for n in range(n_legs):
        total += legs[n, 5] * lit_length(sigma_t, legs[n, 4])
    left = u * total
    for n in range(n_legs):
        part = legs[n, 5] * lit_length(sigma_t, legs[n, 4])
        if left < part or n == n_legs - 1:
            lit = min(left / legs[n, 5], lit_length(sigma_t, legs[n, 4]))
            way = -math.log1p(-min(lit * sigma_t, 1.0 - 1e-16)) / sigma_t if sigma_t > 0.0 else lit
            return n, min(way, legs[n, 4]), total
        left -= part
    return 0, 0.0, total


@njit(cache=True, nogil=True)
def follow_folded(
    medium: Array,
    tank: Array,
    walls: Array,
    spread: Array,
    angle: float,
    entry: tuple[Array, Array, Array],
    stretched: tuple[Array, Array, Array],
    paths: tuple[int, int],
    rng: np.random.Generator,
    shift: Array,
    lattice: Array,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    scores: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Follow paths as `montecarlo_kernels.follow`, in a tank whose walls give light back.

    Parameters
    ----------
    walls : see `fold`
    spread : standard deviation of the stripes' blur at the face, and its growth per mm of depth

    Notes
    -----
    A Gaussian blur that has grown from s0 to s is a random displacement of the stripes, whose
    deviation is sqrt(s^2 - s0^2): in the mean every wave loses exp(-(h q)^2 (s^2 - s0^2) / 2).
    """
    sigma_t, sigma_s, g, power = medium
    n_orders, n_y, n_x = scores.shape
    cell = (tank[1] / n_y, tank[0] / n_x)
    slope = math.tan(angle)
    survival = math.sqrt(min(sigma_s * power / sigma_t, 1.0)) if sigma_t > 0.0 else 1.0
    wave = np.empty((2, harmonics.size), dtype=np.complex128)
    dark, legs = np.empty((0, 0)), np.empty((LEGS, 6))
    for n in range(paths[0], paths[1]):
        y_entry = draw(entry[0], entry[1], entry[2], (shift[0] + n * lattice[0]) % 1.0)
        n_legs = fold(
            (0.0, y_entry), (math.cos(angle), math.sin(angle)), tank, sigma_t, walls, legs
        )
        weight, displaced = 1.0, 0.0
        for k in range(n_orders):
            if 2 * k + 2 < lattice.size:
                u = (shift[2 * k + 1] + n * lattice[2 * k + 1]) % 1.0
                v = (shift[2 * k + 2] + n * lattice[2 * k + 2]) % 1.0
            else:
                u, v = rng.random(), rng.random()
            leg, way, lit = collide(legs, n_legs, sigma_t, u)
            cos_t, sin_t = legs[leg, 2], legs[leg, 3]
            x, y = legs[leg, 0] + way * cos_t, legs[leg, 1] + way * sin_t
            if k == 0 and spread[1] > 0.0:
                # The beam's blur grows along its way, to and fro.
                depth = way * abs(cos_t)
                for before in range(leg):
                    depth += legs[before, 4] * abs(legs[before, 2])
                now = spread[0] + spread[1] * depth
                grown = math.sqrt(now * now - spread[0] * spread[0])
                displaced = grown * rng.standard_normal()
            weight *= sigma_s * power * lit
            theta = math.atan2(sin_t, cos_t) + deflect(v, g, stretched)
            n_legs = fold((x, y), (math.cos(theta), math.sin(theta)), tank, sigma_t, walls, legs)
            for m in range(n_legs):
                x, y, cos_t, sin_t = legs[m, 0], legs[m, 1], legs[m, 2], legs[m, 3]
                score_ray(
                    (x, y, y - x * slope - y_entry - displaced),
                    (cos_t, sin_t, sin_t - cos_t * slope),
                    cell,
                    legs[m, 4],
                    sigma_t,
                    weight * legs[m, 5],
                    wavenumber,
                    harmonics,
                    wave,
                    scores[k],
                    dark,
                    modulated,
                )
            if rng.random() >= survival:
                break
            weight /= survival
