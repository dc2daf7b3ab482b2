"""Bounce-tagged Monte Carlo: the independent route to every order, and the light of simulations.

Paths start on the lit face, are forced to collide inside the tank, and score their expected
fluence along each whole ray (Eqs. 1, 3). The first steps of a path follow a randomly shifted
lattice, which leaves the expectation exact and takes most of the noise from the low orders.
Independent batches give standard errors that are true.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Beam, Medium, Tank

Array = NDArray[np.float64]
Scores = tuple[Array, NDArray[np.complex128]]

N_BATCHES = 16
NEGLIGIBLE_TRANSMISSION = 1e-5  # a ray is followed until this share of it is left


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledField:
    """Cell averages of scattered light, with standard errors.

    Attributes
    ----------
    fluence, std_error : (K - 1, n_y, n_x), phi_k of bounces k = 2 .. K with sigma_s^(k-1)
        applied, for unit irradiance across the beam
    modulated : (n_harmonics, n_y, n_x), complex; the sum of bounces 2 .. K under light entering
        as exp(i h q y), divided by exp(i h q (y - x tan(theta_0))), which is how the beam would
        carry it to where it is seen; one for each harmonic h
    x_mm, y_mm : cell centres
    """

    fluence: Array
    std_error: Array
    modulated: NDArray[np.complex128]
    x_mm: Array
    y_mm: Array


def simulate(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    *,
    n_bounces: int,
    n_paths: int,
    cell_mm: float,
    seed: int,
    stripe_wavenumber_per_mm: float = 0.0,
    harmonics: tuple[int, ...] = (),
    n_threads: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> SampledField:
    """Follow ``n_paths`` paths through ``n_bounces`` bounces.

    Parameters
    ----------
    stripe_wavenumber_per_mm : 2 pi / period of stripes along y
    harmonics : ascending multiples of it whose modulation is wanted
    progress : called with (batches done, batches in all)

    Raises
    ------
    AnalysisError
        If the phase function is not ``hg-plane`` (the only one sampled here), the beam leaves
        the face, or a count is too small.
    """
    if medium.phase != "hg-plane":
        msg = f"phase = {medium.phase!r}: the Monte Carlo samples hg-plane only; choose that."
        raise AnalysisError(msg)
    if n_bounces < 2 or n_paths < N_BATCHES:
        msg = f"{n_paths} paths of {n_bounces} bounces: at least {N_BATCHES} paths of 2 are needed."
        raise AnalysisError(msg)
    beam = beam.entering(tank)
    n_x = max(1, round(tank.depth_mm / cell_mm))
    n_y = max(1, round(tank.width_mm / cell_mm))
    n_batch = n_paths // N_BATCHES
    angle = math.radians(beam.angle_deg)
    orders = np.asarray(harmonics, dtype=np.int64)

    def run(batch: int) -> Scores:
        scores = np.zeros((n_bounces - 1, n_y, n_x))
        modulated = np.zeros((n_y, n_x, orders.size), dtype=np.complex128)
        _follow(
            np.array([medium.sigma_t_per_mm, medium.albedo, medium.g]),
            np.array([tank.depth_mm, tank.width_mm]),
            np.array([beam.from_mm, beam.to_mm, angle]),
            n_batch,
            np.random.default_rng([seed, batch]),
            _lattice(5),
            stripe_wavenumber_per_mm,
            orders,
            scores,
            modulated,
        )
        return scores, modulated

    batches = _run_all(run, n_threads, progress)
    scores = np.stack([batch for batch, _ in batches])
    # Irradiance is counted across the beam: a slanted one brings its cosine to the face.
    power = (beam.to_mm - beam.from_mm) * math.cos(angle)
    weight = power / (n_batch * (tank.depth_mm / n_x) * (tank.width_mm / n_y))
    return SampledField(
        fluence=weight * scores.mean(axis=0),
        std_error=weight * scores.std(axis=0, ddof=1) / math.sqrt(N_BATCHES),
        modulated=weight * np.moveaxis(np.mean([wave for _, wave in batches], axis=0), -1, 0),
        x_mm=(np.arange(n_x) + 0.5) * tank.depth_mm / n_x,
        y_mm=(np.arange(n_y) + 0.5) * tank.width_mm / n_y,
    )


def _run_all(
    run: Callable[[int], Scores], n_threads: int, progress: Callable[[int, int], None] | None
) -> list[Scores]:
    """Run every batch and return them in order, so that a seed gives the same bits every time."""
    with ThreadPoolExecutor(n_threads) as pool:
        batches = [pool.submit(run, batch) for batch in range(N_BATCHES)]
        try:
            for done, finished in enumerate(as_completed(batches), start=1):
                finished.result()
                if progress is not None:
                    progress(done, N_BATCHES)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Ctrl-C need not wait for all batches
            raise
    return [finished.result() for finished in batches]


def _lattice(n_dimensions: int) -> Array:
    """Return the steps of the additive recurrence built on the generalised golden ratio."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (n_dimensions + 1))
    return np.asarray((1.0 / ratio) ** np.arange(1, n_dimensions + 1))


@njit(cache=True, nogil=True)
def _wall_distance(
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
def _score_ray(
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
    modulated: NDArray[np.complex128],
) -> None:
    """Add a ray's expected fluence times cell area to each cell it crosses.

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
    n_h = harmonics.size
    for h in range(n_h):
        q = harmonics[h] * wavenumber
        begin = q * lag
        wave[0, h] = complex(math.cos(begin), -math.sin(begin))
        wave[1, h] = weight / complex(sigma_t, q * drift)
    turn = turned = complex(1.0, 0.0)
    power = 1
    left, s = 1.0, 0.0
    while s < reach and 0 <= i < n_x and 0 <= j < n_y:
        s_next = min(next_x, next_y, reach)
        left_next = math.exp(-sigma_t * s_next)
        scores[j, i] += weight * (left - left_next) / sigma_t
        if n_h > 0:
            end = wavenumber * (lag + s_next * drift)
            turn = complex(math.cos(end), -math.sin(end))
            turned, power = turn, 1
        for h in range(n_h):
            while power < harmonics[h]:
                turned *= turn
                power += 1
            ended = left_next * turned
            modulated[j, i, h] += (wave[0, h] - ended) * wave[1, h]
            wave[0, h] = ended
        left, s = left_next, s_next
        if next_x < next_y:
            i += step_x
            next_x += pitch_x
        else:
            j += step_y
            next_y += pitch_y


@njit(cache=True, nogil=True)
def _follow(
    medium: Array,
    tank: Array,
    beam: Array,
    n_paths: int,
    rng: np.random.Generator,
    lattice: Array,
    wavenumber: float,
    harmonics: NDArray[np.int64],
    scores: Array,
    modulated: NDArray[np.complex128],
) -> None:
    """Follow one batch of paths; each bounce k = 2 .. K is scored into scores[k - 2]."""
    sigma_t, albedo, g = medium
    depth, width = tank
    low, high, angle = beam
    n_orders, n_y, n_x = scores.shape
    cell = (width / n_y, depth / n_x)
    longest = -math.log(NEGLIGIBLE_TRANSMISSION) / sigma_t
    slope = math.tan(angle)
    survival = math.sqrt(albedo)
    narrow = (1.0 - g) / (1.0 + g)
    shift = rng.random(lattice.size)
    wave = np.empty((2, harmonics.size), dtype=np.complex128)
    for n in range(n_paths):
        x, y_entry = 0.0, low + (high - low) * ((shift[0] + n * lattice[0]) % 1.0)
        y, theta, weight = y_entry, angle, 1.0
        for k in range(n_orders):
            if 2 * k + 2 < lattice.size:
                u = (shift[2 * k + 1] + n * lattice[2 * k + 1]) % 1.0
                v = (shift[2 * k + 2] + n * lattice[2 * k + 2]) % 1.0
            else:
                u, v = rng.random(), rng.random()
            cos_t, sin_t = math.cos(theta), math.sin(theta)
            caught = -math.expm1(-sigma_t * _wall_distance(x, y, cos_t, sin_t, depth, width))
            path = -math.log1p(-u * caught) / sigma_t
            x, y = x + path * cos_t, y + path * sin_t
            weight *= albedo * caught
            # The inverse of the cumulative hg-plane, a wrapped Cauchy distribution.
            theta += 2.0 * math.atan(narrow * math.tan(math.pi * (v - 0.5)))
            cos_t, sin_t = math.cos(theta), math.sin(theta)
            reach = min(_wall_distance(x, y, cos_t, sin_t, depth, width), longest)
            _score_ray(
                (x, y, y - x * slope - y_entry),
                (cos_t, sin_t, sin_t - cos_t * slope),
                cell,
                reach,
                sigma_t,
                weight,
                wavenumber,
                harmonics,
                wave,
                scores[k],
                modulated,
            )
            # Roulette: dim paths are thinned out, the survivors carry their weight.
            if rng.random() >= survival:
                break
            weight /= survival
