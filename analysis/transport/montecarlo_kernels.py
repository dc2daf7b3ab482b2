"""Compiled kernels of the Monte Carlo: one path, one ray, one draw (Eqs. 1 to 3)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEGLIGIBLE_TRANSMISSION = 1e-5  # a ray is followed until this share of it is left
THIN = 1e-6  # optical length below which differences of exponentials lose digits


@njit(cache=True, nogil=True)
def draw(nodes: Array, density: Array, cumulative: Array, share: float) -> float:
    """Return the quantile ``share`` of a piecewise-linear density.

    Parameters
    ----------
    nodes : (n,), ascending
    density : (n,), values there, >= 0
    cumulative : (n,), its integral from the first node, divided by the whole
    share : 0 <= share <= 1
    """
    i = min(max(int(np.searchsorted(cumulative, share, side="right")) - 1, 0), nodes.size - 2)
    part = (share - cumulative[i]) / (cumulative[i + 1] - cumulative[i])
    a, b = density[i], density[i + 1]
    # The root of a s + (b - a) s^2 / 2 = part (a + b) / 2 that does not cancel.
    root = a + math.sqrt(max(a * a + part * (b * b - a * a), 0.0))
    s = part * (a + b) / root if root > 0.0 else 0.0
    return float(nodes[i] + (nodes[i + 1] - nodes[i]) * s)


@njit(cache=True, nogil=True)
def deflect(share: float, g: float, stretched: tuple[Array, Array, Array]) -> float:
    """Return the deflection (rad) at quantile ``share`` of the phase function over the circle.

    With tan(t/2) = (1-|g|)/(1+|g|) tan(psi), for g >= 0, hg-plane (a wrapped Cauchy distribution)
    is uniform in psi, however peaked it is in t. ``stretched`` is the density in psi for
    `draw`, empty where that is uniform. For g < 0 the same is counted from pi.
    """
    narrow = (1.0 - abs(g)) / (1.0 + abs(g))
    if g < 0.0:
        share = (share + 0.5) % 1.0
    if stretched[0].size > 0:
        psi = draw(stretched[0], stretched[1], stretched[2], share)
    else:
        psi = math.pi * (share - 0.5)
    turn = 2.0 * math.atan(narrow * math.tan(psi))
    return turn if g >= 0.0 else math.pi + turn


@njit(cache=True, nogil=True)
def lit_length(sigma_t: float, length: float) -> float:
    """Return the integral of exp(-sigma_t s) over 0 .. length, mm."""
    if sigma_t == 0.0:
        return length
    return -math.expm1(-sigma_t * length) / sigma_t


@njit(cache=True, nogil=True)
def wall_distance(
    x: float, y: float, cos_t: float, sin_t: float, depth: float, width: float
) -> float:
    """Return the way from (x, y) along a direction to the wall, mm."""
    far = 1e300
    if cos_t > 0.0:
        far = min(far, (depth - x) / cos_t)
    elif cos_t < 0.0:
        far = min(far, -x / cos_t)
    if sin_t > 0.0:
        far = min(far, (width - y) / sin_t)
    elif sin_t < 0.0:
        far = min(far, -y / sin_t)
    return max(far, 0.0)


@njit(cache=True, nogil=True)
def score_ray(
    origin: tuple[float, float, float],
    direction: tuple[float, float, float],
    cell: tuple[float, float],
    reach: float,
    sigma_t: float,
    weight: float,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    wave: NDArray[np.complex128],
    scores: Array,
    lobe: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Add a ray's expected fluence times cell area to each cell it crosses.

    ``scores`` is (n_y, n_x); ``lobe`` is the same for the ray's angle bin, or empty.
    ``origin`` is (x, y, lag) and ``direction`` (cos, sin, drift): the stripes seen at a point lag
    behind those of the beam there by ``lag`` mm, which grows by ``drift`` per mm of the ray. The
    phase exp(-i q lag) is integrated exactly along each piece of the ray.
    """
    x, y, lag = origin
    cos_t, sin_t, drift = direction
    cell_y, cell_x = cell
    n_y, n_x = scores.shape
    i = min(max(int(x / cell_x), 0), n_x - 1)
    j = min(max(int(y / cell_y), 0), n_y - 1)
    step_x, step_y = (1 if cos_t > 0.0 else -1), (1 if sin_t > 0.0 else -1)
    edge_x, edge_y = (i + (cos_t > 0.0)) * cell_x, (j + (sin_t > 0.0)) * cell_y
    next_x = (edge_x - x) / cos_t if cos_t != 0.0 else 1e300
    next_y = (edge_y - y) / sin_t if sin_t != 0.0 else 1e300
    pitch_x = cell_x / abs(cos_t) if cos_t != 0.0 else 1e300
    pitch_y = cell_y / abs(sin_t) if sin_t != 0.0 else 1e300
    angular, n_h = lobe.size > 0, harmonics.size
    # A ray thinner than this is scored as if it were not, which is wrong by 5e-7 at most.
    fading = max(sigma_t, THIN / max(reach, 1e-300))
    scale = weight / fading
    if n_h > 0:
        begin_wave(lag, drift, fading, weight, wavenumber, harmonics, wave)
    left, s = 1.0, 0.0
    while s < reach and 0 <= i < n_x and 0 <= j < n_y:
        s_next = min(next_x, next_y, reach)
        left_next = math.exp(-fading * s_next)
        score = scale * (left - left_next)
        scores[j, i] += score
        if angular:
            lobe[j, i] += score
        if n_h > 0:
            advance_wave(
                wavenumber * (lag + s_next * drift), left_next, harmonics, wave, modulated[j, i]
            )
        left, s = left_next, s_next
        if next_x < next_y:
            i += step_x
            next_x += pitch_x
        else:
            j += step_y
            next_y += pitch_y


@njit(cache=True, nogil=True)
def begin_wave(
    lag: float,
    drift: float,
    fading: float,
    weight: float,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    wave: NDArray[np.complex128],
) -> None:
    """Set wave[0] to the phase at the ray's start and wave[1] to the factor of its integral."""
    for h in range(harmonics.size):
        q = harmonics[h] * wavenumber
        begin = q * lag
        wave[0, h] = complex(math.cos(begin), -math.sin(begin))
        wave[1, h] = weight / complex(fading, q * drift)


@njit(cache=True, nogil=True)
def advance_wave(
    phase: float,
    left: float,
    harmonics: NDArray[np.int64],
    wave: NDArray[np.complex128],
    modulated: NDArray[np.complex128],
) -> None:
    """Add the piece of ray that ends at ``phase`` of the first harmonic with ``left`` of it."""
    turn = complex(math.cos(phase), -math.sin(phase))
    turned, power = turn, 1
    for h in range(harmonics.size):
        while power < harmonics[h]:
            turned *= turn
            power += 1
        ended = left * turned
        modulated[h] += (wave[0, h] - ended) * wave[1, h]
        wave[0, h] = ended


@njit(cache=True, nogil=True)
def follow(
    medium: Array,
    tank: Array,
    angle: float,
    entry: tuple[Array, Array, Array],
    stretched: tuple[Array, Array, Array],
    paths: tuple[int, int],
    rng: np.random.Generator,
    shift: Array,
    lattice: Array,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    slots: NDArray[np.int64],
    scores: Array,
    lobes: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Follow paths number ``paths[0]`` to ``paths[1] - 1`` of one batch, adding up their light.

    Parameters
    ----------
    medium : sigma_t, sigma_s (1/mm), g, and f0, the power of the phase function
    tank : depth, width (mm)
    angle : direction of the beam, rad
    entry, stretched : densities for `draw` of the height of entry (mm) and for `deflect`
    shift, lattice : (2 m + 1,), start and step of the lattice that the first m steps follow
    slots : (K - 1,), the place of each bounce in ``lobes``, -1 for none
    scores : (K - 1, n_y, n_x), fluence of bounces 2 .. K
    lobes : (n, n_theta, n_y, n_x), the same for the bounces with a slot, by angle bin
    modulated : (n_y, n_x, n_harmonics), under stripes, all bounces
    """
    sigma_t, sigma_s, g, power = medium
    depth, width = tank
    n_orders, n_y, n_x = scores.shape
    n_theta = lobes.shape[1]
    cell = (width / n_y, depth / n_x)
    longest = -math.log(NEGLIGIBLE_TRANSMISSION) / sigma_t if sigma_t > 0.0 else 1e300
    slope = math.tan(angle)
    # Any survival keeps the expectation; where weights do not shrink, none should be thinned out.
    survival = math.sqrt(min(sigma_s * power / sigma_t, 1.0)) if sigma_t > 0.0 else 1.0
    wave = np.empty((2, harmonics.size), dtype=np.complex128)
    dark = np.empty((0, 0))
    for n in range(paths[0], paths[1]):
        x, y_entry = 0.0, draw(entry[0], entry[1], entry[2], (shift[0] + n * lattice[0]) % 1.0)
        y, theta, weight = y_entry, angle, 1.0
        for k in range(n_orders):
            if 2 * k + 2 < lattice.size:
                u = (shift[2 * k + 1] + n * lattice[2 * k + 1]) % 1.0
                v = (shift[2 * k + 2] + n * lattice[2 * k + 2]) % 1.0
            else:
                u, v = rng.random(), rng.random()
            cos_t, sin_t = math.cos(theta), math.sin(theta)
            lit = lit_length(sigma_t, wall_distance(x, y, cos_t, sin_t, depth, width))
            path = -math.log1p(-u * sigma_t * lit) / sigma_t if sigma_t > 0.0 else u * lit
            x, y = x + path * cos_t, y + path * sin_t
            weight *= sigma_s * power * lit
            theta += deflect(v, g, stretched)
            cos_t, sin_t = math.cos(theta), math.sin(theta)
            lobe = dark
            if slots[k] >= 0:
                lobe = lobes[slots[k], min(int(theta / (2 * math.pi) % 1.0 * n_theta), n_theta - 1)]
            score_ray(
                (x, y, y - x * slope - y_entry),
                (cos_t, sin_t, sin_t - cos_t * slope),
                cell,
                min(wall_distance(x, y, cos_t, sin_t, depth, width), longest),
                sigma_t,
                weight,
                wavenumber,
                harmonics,
                wave,
                scores[k],
                lobe,
                modulated,
            )
            # Roulette: dim paths are thinned out, the survivors carry their weight.
            if rng.random() >= survival:
                break
            weight /= survival
