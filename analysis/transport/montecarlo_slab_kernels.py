"""Compiled kernels of the Monte Carlo of a slab: one path in three dimensions (Eqs. 1 to 3)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.transport.fresnel import reflectance
from analysis.transport.montecarlo_kernels import (
    NEGLIGIBLE_TRANSMISSION,
    Array,
    draw,
    lit_length,
    score_ray,
)

Triple = tuple[float, float, float]

TO_CAMERA = 0.2  # share of directions drawn around the camera's axis


@njit(cache=True, nogil=True)
def scattered_share(cosine: float, g: float) -> float:
    """Return Eq. 2 per steradian; the form that keeps its digits as g tends to one."""
    a = abs(g)
    near = 1.0 - cosine if g >= 0.0 else 1.0 + cosine
    spread = (1.0 - a) ** 2 + 2.0 * a * near
    return (1.0 - a * a) / (4.0 * math.pi * spread * math.sqrt(spread))


@njit(cache=True, nogil=True)
def deflection_cosine(share: float, g: float) -> float:
    """Return the cosine of the deflection at quantile ``share`` of Eq. 2 on the sphere."""
    if abs(g) < 1e-4:
        return 2.0 * share - 1.0 + 1.5 * g * (1.0 - (2.0 * share - 1.0) ** 2)
    ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * share)
    return min(max((1.0 + g * g - ratio * ratio) / (2.0 * g), -1.0), 1.0)


@njit(cache=True, nogil=True)
def turned(axis: Triple, cosine: float, azimuth: float) -> Triple:
    """Return the direction at an angle from ``axis``."""
    x, y, z = axis
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    a, b = sine * math.cos(azimuth), sine * math.sin(azimuth)
    flat = math.sqrt(max(1.0 - z * z, 0.0))
    if flat < 1e-8:
        return (a, b, cosine if z > 0.0 else -cosine)
    return (
        cosine * x + (a * x * z - b * y) / flat,
        cosine * y + (a * y * z + b * x) / flat,
        cosine * z - a * flat,
    )


@njit(cache=True, nogil=True)
def next_direction(before: Triple, g: float, u: float, v: float) -> tuple[Triple, float]:
    """Return a direction and its weight: drawn after the phase function or around the camera.

    Without the second kind a camera's share in sharply peaked scattering is all but never met.
    """
    if u < TO_CAMERA:
        axis, u = (0.0, 0.0, 1.0), u / TO_CAMERA
    else:
        axis, u = before, (u - TO_CAMERA) / (1.0 - TO_CAMERA)
    found = turned(axis, deflection_cosine(u, g), 2.0 * math.pi * v)
    cosine = before[0] * found[0] + before[1] * found[1] + before[2] * found[2]
    wanted = scattered_share(cosine, g)
    drawn = (1.0 - TO_CAMERA) * wanted + TO_CAMERA * scattered_share(found[2], g)
    return found, wanted / drawn


@njit(cache=True, nogil=True)
def way_out(place: Triple, to: Triple, box: Triple) -> tuple[float, bool]:
    """Return the way to the first wall of the box (depth, width, height), and if it is the top."""
    far, top = 1e300, False
    for axis in range(3):
        if to[axis] > 0.0:
            way = (box[axis] - place[axis]) / to[axis]
        elif to[axis] < 0.0:
            way = -place[axis] / to[axis]
        else:
            continue
        if way < far:
            far, top = way, axis == 2 and to[axis] > 0.0
    return max(far, 0.0), top


@njit(cache=True, nogil=True)
def moved(place: Triple, to: Triple, way: float) -> Triple:
    """Return the place ``way`` mm further on."""
    return (place[0] + way * to[0], place[1] + way * to[1], place[2] + way * to[2])


@njit(cache=True, nogil=True)
def collide(
    place: Triple, to: Triple, box: Triple, sigma_t: float, index: float, share: float
) -> tuple[Triple, Triple, float]:
    """Return where a ray collides at quantile ``share``, its direction there, and its lit length.

    The collision is forced onto the ray, the part mirrored by the surface and all; sigma_s times
    the lit length is what the path's weight is multiplied by.
    """
    first, top = way_out(place, to, box)
    lit = lit_length(sigma_t, first)
    if not top:
        way = -math.log1p(-share * lit * sigma_t) / sigma_t
        return moved(place, to, min(way, first)), to, lit
    sent_back = reflectance(to[2], index) * math.exp(-sigma_t * first)
    surface = moved(place, to, first)
    under, below = (surface[0], surface[1], box[2]), (to[0], to[1], -to[2])
    second, _ = way_out(under, below, box)
    beyond = sent_back * lit_length(sigma_t, second)
    chosen = share * (lit + beyond)
    if chosen < lit or sent_back == 0.0:
        way = -math.log1p(-min(chosen, lit) * sigma_t) / sigma_t
        return moved(place, to, min(way, first)), to, lit + beyond
    way = -math.log1p(-(chosen - lit) / sent_back * sigma_t) / sigma_t
    return moved(under, below, min(way, second)), below, lit + beyond


@njit(cache=True, nogil=True)
def score_mirrored(
    begin: Triple,
    direction: Triple,
    share: float,
    entered: float,
    medium: Triple,
    box: Triple,
    index: float,
    seen_by_camera: bool,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    wave: NDArray[np.complex128],
    scores: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Score a ray up to a wall, and after the surface's mirror to the next.

    Parameters
    ----------
    share : weight of the path
    entered : where along y the path entered, mm
    scores, modulated : (n_y, n_x) and (n_y, n_x, n_harmonics)
    """
    sigma_t, _, g = medium
    n_y, n_x = scores.shape
    left = -math.log(NEGLIGIBLE_TRANSMISSION) / sigma_t
    dark = np.empty((0, 0))
    while True:
        first, top = way_out(begin, direction, box)
        fading, value = sigma_t, share
        if seen_by_camera:
            # What the ray scatters upwards fades on the rest of the way up.
            fading = sigma_t * (1.0 - direction[2])
            value *= scattered_share(direction[2], g) * math.exp(-sigma_t * (box[2] - begin[2]))
        score_ray(
            (begin[0], begin[1], begin[1] - entered),
            (direction[0], direction[1], direction[1]),
            (box[1] / n_y, box[0] / n_x),
            min(first, left),
            fading,
            value,
            wavenumber,
            harmonics,
            wave,
            scores,
            dark,
            modulated,
        )
        if not top or first >= left:
            return
        left -= first
        share *= reflectance(direction[2], index) * math.exp(-sigma_t * first)
        if share == 0.0:
            return
        at = moved(begin, direction, first)
        begin = (at[0], at[1], box[2])
        direction = (direction[0], direction[1], -direction[2])


@njit(cache=True, nogil=True)
def follow_slab(
    medium: Triple,
    box: Triple,
    index: float,
    entry: tuple[Array, Array, Array],
    paths: tuple[int, int],
    rng: np.random.Generator,
    shift: Array,
    lattice: Array,
    seen_by_camera: bool,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    slots: NDArray[np.int64],
    scores: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Follow paths number ``paths[0]`` to ``paths[1] - 1`` of one batch, adding up their light.

    Parameters
    ----------
    medium : sigma_t, sigma_s (1/mm), g
    box : depth, width, height (mm); all walls are black but the top, which reflects
    entry : density for `draw` of where along y a path enters (mm)
    shift, lattice : (2 + 3 m,), start and step of the lattice that the first m steps follow
    seen_by_camera : score what goes up to the camera, else the fluence
    slots : (K - 1,), the place of each bounce in ``modulated``
    scores : (K - 1, n_y, n_x), bounces 2 .. K
    modulated : (n, n_y, n_x, n_harmonics)
    """
    sigma_t, sigma_s, g = medium
    height, n_orders = box[2], scores.shape[0]
    wave = np.empty((2, harmonics.size), dtype=np.complex128)
    for n in range(paths[0], paths[1]):
        entered = draw(entry[0], entry[1], entry[2], (shift[0] + n * lattice[0]) % 1.0)
        place = (0.0, entered, ((shift[1] + n * lattice[1]) % 1.0) * height)
        to, weight = (1.0, 0.0, 0.0), 1.0
        for k in range(n_orders):
            if 3 * k + 4 < lattice.size:
                r = (shift[3 * k + 2] + n * lattice[3 * k + 2]) % 1.0
                u = (shift[3 * k + 3] + n * lattice[3 * k + 3]) % 1.0
                v = (shift[3 * k + 4] + n * lattice[3 * k + 4]) % 1.0
            else:
                r, u, v = rng.random(), rng.random(), rng.random()
            place, to, lit = collide(place, to, box, sigma_t, index, r)
            factor = sigma_s * lit
            weight *= factor
            to, more = next_direction(to, g, u, v)
            weight *= more
            score_mirrored(
                place,
                to,
                weight,
                entered,
                medium,
                box,
                index,
                seen_by_camera,
                wavenumber,
                harmonics,
                wave,
                scores[k],
                modulated[slots[k]],
            )
            # Roulette: dim paths are thinned out, the survivors carry their weight.
            survival = math.sqrt(min(factor, 1.0))
            if rng.random() >= survival:
                break
            weight /= survival
