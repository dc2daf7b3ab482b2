"""The second bounce of a slab as its camera sees it, integrated over height in closed form."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import numpy as np
from numba import njit

from analysis.medium import Medium, Slab
from analysis.phase_function import Array, phase_function
from analysis.transport.fresnel import reflectance

COARSEST = 20  # polar angles in each part of the rules, at g = 0
FINEST = 28  # and where g is nearly one
STRIPED = 0.12  # more azimuths, per stripes' phase over the height
TWO_PEAKS = 0.5  # g from which on the beam's peak is given a rule of its own


def second_order(
    x_mm: Array, medium: Medium, slab: Slab, *, wavenumber_per_mm: float, n_angles: int = 0
) -> Array:
    """Return A_2(x; q) exp(sigma_t x) for an albedo of one, (n_x,).

    ``A_2 = (1/h) int dz exp(-sigma_t (h - z)) sigma_s int p(mu_z) L_2 dOmega``, over
    ``sigma_s p(0) (1 - exp(-sigma_t h)) / (sigma_t h)``, where ``L_2 = sigma_s p(mu_x)
    exp(-sigma_t x) [(1 - E_1) + R (E_1 - E_2)] / kappa``, ``E = exp(-kappa s)``, ``kappa =
    sigma_t (1 - mu_x) + i q mu_y``; s_1 is the way back to the first wall or, going down, to the
    surface, s_2 to the next wall after one reflection.

    Parameters
    ----------
    n_angles : polar angles of each part of the rules; zero for as many as g calls for. Azimuths
        are as many in each quarter, and more under stripes: along the stripes' crossing light
        oscillates with azimuth as exp(i q z tan(phi))

    Notes
    -----
    The integrand has two peaks, around the beam and around the camera. Where they are sharp, two
    smooth shares of it, which add to one, are integrated in polar coordinates around either axis.
    """
    n = n_angles or angles_for(medium.g)
    n_phi = round(n * (1.0 + min(STRIPED * wavenumber_per_mm * slab.height_mm, 2.0)))
    cosines, weight = _directions(medium.g, slab.surface_index, n, n_phi)
    g = medium.g
    p_beam = phase_function(np.arccos(np.clip(cosines[:, 0], -1.0, 1.0)), g, "hg-paper")
    p_camera = phase_function(np.arccos(np.clip(cosines[:, 2], -1.0, 1.0)), g, "hg-paper")
    across = float(phase_function(np.array(0.5 * math.pi), g, "hg-paper"))
    sigma_t = medium.sigma_t_per_mm
    seen = -math.expm1(-sigma_t * slab.height_mm) / sigma_t
    found = add_up(
        np.ascontiguousarray(x_mm, dtype=np.float64),
        cosines,
        weight * p_beam * p_camera,
        slab.surface_index,
        (sigma_t, wavenumber_per_mm),
        (slab.height_mm, slab.depth_mm),
    )
    return np.asarray(found * sigma_t / (across * seen))


def angles_for(g: float) -> int:
    """Return how many polar angles leave less than 0.1 % of the second order."""
    return round(COARSEST + (FINEST - COARSEST) * g**2)


def _directions(g: float, index: float, n: int, n_phi: int) -> tuple[Array, Array]:
    """Return directions (n, 3) with mu_y > 0, and weights that hold for both halves of y."""
    critical = math.acos(math.sqrt(1.0 - 1.0 / index**2))
    theta, phi, weight = _polar_rule(n, n_phi, [0.5 * math.pi, math.pi - critical])
    around_camera = np.stack(_turned(theta, phi)[::-1], axis=1)
    if g < TWO_PEAKS:
        return np.ascontiguousarray(around_camera), 2.0 * weight
    theta, phi, beam_weight = _polar_rule(n, n_phi, [0.5 * math.pi])
    around_beam = np.stack(_turned(theta, phi), axis=1)
    cosines = np.concatenate([around_beam, around_camera])
    # 1 + g^2 - 2 g mu for either axis: small in its peak, where the other's share vanishes.
    beam = (1.0 + g * g - 2.0 * g * cosines[:, 0]) ** 3
    camera = (1.0 + g * g - 2.0 * g * cosines[:, 2]) ** 3
    share = np.concatenate([camera[: theta.size], beam[theta.size :]]) / (beam + camera)
    return np.ascontiguousarray(cosines), 2.0 * np.concatenate([beam_weight, weight]) * share


def _turned(theta: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return the cosines along the axis, to the side mu_y, and across."""
    return np.cos(theta), np.sin(theta) * np.sin(phi), np.sin(theta) * np.cos(phi)


def _polar_rule(n: int, n_phi: int, breaks: list[float]) -> tuple[Array, Array, Array]:
    """Return polar angle, azimuth 0 .. pi and weight, Gaussian between breaks and in quarters.

    Polar angles crowd towards the axis.
    """
    node, weight = np.polynomial.legendre.leggauss(n)
    t, w = 0.5 * (node + 1.0), 0.5 * weight
    theta, by_theta = [breaks[0] * t**2], [2.0 * breaks[0] * t * w]
    for low, high in pairwise([*breaks, math.pi]):
        theta.append(low + (high - low) * t)
        by_theta.append((high - low) * w)
    node, weight = np.polynomial.legendre.leggauss(n_phi)
    t, w = 0.5 * (node + 1.0), 0.5 * weight
    quarter = 0.5 * math.pi
    phi = np.concatenate([quarter * t, quarter * (1.0 + t)])
    polar = np.concatenate(theta)
    grid = np.meshgrid(polar, phi, indexing="ij")
    by_polar = np.concatenate(by_theta) * np.sin(polar)
    return grid[0].ravel(), grid[1].ravel(), np.outer(by_polar, np.tile(quarter * w, 2)).ravel()


@njit(cache=True, nogil=True)
def faded(rate: complex, length: float, left: complex) -> complex:
    """Return the integral of exp(-rate s) over 0 .. length, at whose end ``left`` is left."""
    span = rate * length
    if abs(span) < 1e-4:
        return complex(length * (1.0 - span / 2.0 + span * span / 6.0))
    return complex((1.0 - left) / rate)


@njit(cache=True, nogil=True)
def seen_of_ray(
    climbed: float, at_face: complex, rate: complex, sigma_t: float, height: float, mirror: float
) -> complex:
    """Return kappa times one direction's light, seen from above, of rays that end on a wall.

    Heights u are counted down from the surface. A ray from the face has climbed, or fallen, by
    ``climbed`` and keeps ``at_face`` exp(-kappa s) = exp(-rate climbed); ``mirror`` is below zero
    for a ray that goes up, which ends on the face or the floor.
    """
    left = math.exp(-sigma_t * height)
    whole = (1.0 - left) / sigma_t
    upper = min(climbed, height)
    at_upper = at_face if climbed < height else cmath.exp(-rate * height)
    if mirror < 0.0:
        from_face = at_face * (1.0 - math.exp(-sigma_t * (height - upper))) / sigma_t
        from_floor = left * faded(rate - sigma_t, upper, at_upper * math.exp(sigma_t * upper))
        return complex(whole - from_face - from_floor)
    fallen = math.exp(-sigma_t * upper)
    once = faded(rate + sigma_t, upper, at_upper * fallen)
    once += at_face * (fallen - left) / sigma_t
    light = whole - once
    if mirror > 0.0:
        lower = min(max(climbed - height, 0.0), height)
        at_lower = at_face if climbed < 2.0 * height else at_upper * at_upper
        crossed = math.exp(-sigma_t * lower)
        twice = at_face * (crossed - left) / sigma_t
        if lower > 0.0:
            twice += (at_upper - at_lower * crossed) / (rate + sigma_t)
        light += mirror * (once - twice)
    return complex(light)


@njit(cache=True, nogil=True)
def add_up(
    x_mm: Array,
    cosines: Array,
    weight: Array,
    index: float,
    medium: tuple[float, float],
    walls: tuple[float, float],
) -> Array:
    """Sum the second bounce's light over directions, (n_x,)."""
    sigma_t, wavenumber = medium
    height, depth = walls
    out = np.zeros(x_mm.size)
    for n in range(weight.size):
        mu_x, mu_y, mu_z = cosines[n]
        kappa = complex(sigma_t * (1.0 - mu_x), wavenumber * mu_y)
        steep = abs(mu_z)
        rate = kappa / steep
        mirror = -1.0 if mu_z > 0.0 else reflectance(steep, index)
        reach = 2.0 * height if mirror > 0.0 else height
        # Beyond their reach rays know nothing of the face.
        deep = (seen_of_ray(2.0 * reach, 0.0j, rate, sigma_t, height, mirror) / kappa).real
        for i in range(x_mm.size):
            to_face = x_mm[i] / mu_x if mu_x > 0.0 else (depth - x_mm[i]) / -mu_x
            climbed = steep * to_face
            if climbed >= reach:
                out[i] += weight[n] * deep
            else:
                at_face = cmath.exp(-kappa * to_face)
                light = seen_of_ray(climbed, at_face, rate, sigma_t, height, mirror) / kappa
                out[i] += weight[n] * light.real
    return out
