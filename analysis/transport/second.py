"""The second bounce's fluence, free of error of direction: Gauss sums between the kinks of L_2.

Seen from one point, the closed form of L_2 is smooth between the directions of the tank's corners
and of the points where the edges of the beam's strips enter and leave. A few points between two
of these do what thousands of equal steps do.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numba import njit

from analysis.light_field import Grid
from analysis.medium import Beam, Medium
from analysis.phase_function import Array
from analysis.transport.beam import cut_ray, describe_ray
from analysis.transport.choose import relative_error
from analysis.transport.sweep import exponential_moments

POINTS = (4, 6, 8, 11, 16, 24, 36, 54, 80)  # between two kinks
DOUBT = 2.0  # times the error of these is that of all, at most
PROBED = 3  # every third place tells the error
PEAK = (1.0, 5.0)  # the sums are also cut so many widths 1 - |g| beside the phase function's
PEAKED = 0.5  # peak, from this |g| on


def second_to(
    medium: Medium, beam: Beam, grid: Grid, x_mm: Array, y_mm: Array, tolerance: float
) -> tuple[Array, float]:
    """Return the fluence of the second bounce for sigma_s of one per mm, and its relative error.

    The error, measured on some of the places with more points, is below the tolerance, or as
    small as the most points make it.
    """
    probes = x_mm[::PROBED], y_mm[::PROBED]
    coarse = second_at(medium, beam, grid, *probes, POINTS[0])
    for n_points, more in itertools.pairwise(POINTS):
        few = n_points
        fine = second_at(medium, beam, grid, *probes, more)
        error = DOUBT * relative_error(coarse, fine)
        if error <= tolerance:
            break
        coarse = fine
    return second_at(medium, beam, grid, x_mm, y_mm, few), error


def second_at(
    medium: Medium, beam: Beam, grid: Grid, x_mm: Array, y_mm: Array, n_points: int
) -> Array:
    """Return the fluence of the second bounce at places in the tank, (n_y, n_x).

    For a scattering coefficient of one per mm, with ``n_points`` between any two kinks.
    """
    beam = beam.entering(grid.tank)
    heights, irradiance = beam.profile_points()
    nodes, weights = np.polynomial.legendre.leggauss(n_points)
    t = 0.5 * (nodes + 1.0)
    # Points crowd towards the kinks, where grazing light changes fastest.
    places, shares = t * t * (3.0 - 2.0 * t), 3.0 * t * (1.0 - t) * weights
    out = np.empty((y_mm.size, x_mm.size))
    slant = math.radians(beam.angle_deg)
    peak = slant if medium.g >= 0.0 else slant + math.pi
    width = 1.0 - abs(medium.g)
    beside = PEAK if abs(medium.g) > PEAKED else ()
    cuts = peak + width * np.array([0.0, *(side * w for w in beside for side in (-1.0, 1.0))])
    _sum_between_kinks(
        x_mm,
        y_mm,
        (grid.tank.depth_mm, grid.tank.width_mm),
        (medium.sigma_t_per_mm, medium.g),
        (math.cos(slant), math.sin(slant), math.tan(slant)),
        medium.phase == "hg-paper",
        np.column_stack([heights, irradiance]),
        _kink_points(beam, grid.tank.depth_mm, grid.tank.width_mm),
        cuts,
        np.column_stack([places, shares]),
        out,
    )
    return out


def _kink_points(beam: Beam, depth_mm: float, width_mm: float) -> Array:
    """Return where strips' edges enter and leave, and the tank's corners, (n, 2) as x, y."""
    slope = math.tan(math.radians(beam.angle_deg))
    points = [(x, y) for x in (0.0, depth_mm) for y in (0.0, width_mm)]
    for y in beam.profile_points()[0].tolist():
        way = depth_mm
        if slope:
            way = min(way, ((width_mm if slope > 0.0 else 0.0) - y) / slope)
        points += [(0.0, y), (way, y + way * slope)]
    return np.array(points)


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_between_kinks(
    x_mm: Array,
    y_mm: Array,
    tank: tuple[float, float],
    medium: tuple[float, float],
    slant: tuple[float, float, float],
    paper: bool,
    profile: Array,
    kinks: Array,
    cuts: Array,
    rule: Array,
    out: Array,
) -> None:
    """Integrate p(theta - theta_0) times the beam integral over all directions at each place."""
    n = kinks.shape[0] + cuts.size
    borders = np.empty(n + 1)
    for j in range(y_mm.size):
        for i in range(x_mm.size):
            for k in range(n):
                if k < cuts.size:
                    angle = cuts[k]
                else:
                    one = kinks[k - cuts.size]
                    angle = math.atan2(y_mm[j] - one[1], x_mm[i] - one[0])
                borders[k] = angle % (2.0 * math.pi)
            borders[:n].sort()
            borders[n] = borders[0] + 2.0 * math.pi
            total = 0.0
            for k in range(n):
                span = borders[k + 1] - borders[k]
                if span > 1e-13:
                    middle = borders[k] + 0.5 * span
                    if _light(x_mm[i], y_mm[j], middle, tank, medium, slant, paper, profile) > 0.0:
                        for m in range(rule.shape[0]):
                            theta = borders[k] + span * rule[m, 0]
                            light = _light(
                                x_mm[i], y_mm[j], theta, tank, medium, slant, paper, profile
                            )
                            total += span * rule[m, 1] * light
            out[j, i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _light(
    x: float,
    y: float,
    theta: float,
    tank: tuple[float, float],
    medium: tuple[float, float],
    slant: tuple[float, float, float],
    paper: bool,
    profile: Array,
) -> float:
    """Return L_2 at one place and direction for a scattering coefficient of one."""
    sigma_t, g = medium
    cos_t, sin_t = math.cos(theta), math.sin(theta)
    cos_0, sin_0, slope = slant
    ray = describe_ray(cos_t, sin_t, (cos_0, slope), sigma_t)
    found = 0.0
    for k in range(profile.shape[0] - 1):
        strip = (profile[k, 0], profile[k + 1, 0], profile[k, 1], profile[k + 1, 1])
        dimming, tau, bright, dark = cut_ray(x, y, ray, tank, strip)
        if bright + dark > 0.0:
            e0, e1 = -math.expm1(-tau) / tau if tau > 1e-9 else 1.0, 0.0
            if bright != dark:
                e0, e1, _ = exponential_moments(tau)
            found += math.exp(-dimming) * (bright * (e0 - e1) + dark * e1)
    a = abs(g)
    aside = 1.0 - (cos_t * cos_0 + sin_t * sin_0) * (1.0 if g >= 0.0 else -1.0)
    denominator = (1.0 - a) ** 2 + 2.0 * a * aside
    scattered = (1.0 - a) * (1.0 + a) / denominator
    if paper:
        return found * scattered / (4.0 * math.pi * math.sqrt(denominator))
    return found * scattered / (2.0 * math.pi)
