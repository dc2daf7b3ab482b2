"""Bounce-tagged Monte Carlo of a slab in three dimensions: what its camera sees of every order.

Independent of the solver: it shares with it Eq. 2 and Fresnel's equations, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Beam, Medium, Slab, Tank
from analysis.phase_function import phase_function
from analysis.transport.montecarlo import (
    N_BATCHES,
    lattice_steps,
    mean_and_error,
    with_cumulative,
)
from analysis.transport.montecarlo_kernels import Array, lit_length
from analysis.transport.montecarlo_slab_kernels import follow_slab

N_LATTICE = 8  # dimensions of the lattice: where a path enters, then three for each bounce
ENDLESS_MM = 1e6  # width of a slab without side walls


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabSample:
    """Cell averages of what a slab's camera sees of bounces 2 .. K, with standard errors.

    Attributes
    ----------
    light, std_error : (K - 1, n_y, n_x), in units of single scattering at the lit face under an
        irradiance of one: A_k of physics' Eq. 10 with sigma_s^(k-1) applied
    modulated, modulated_std_error : (n_harmonics, n, n_y, n_x), complex and real; under light that
        enters as exp(i h q y), over that factor, for each harmonic h; n is K - 1, or one for the
        sum of all orders. The error is that of the real part
    x_mm, y_mm : cell centres
    """

    light: Array
    std_error: Array
    modulated: NDArray[np.complex128]
    modulated_std_error: Array
    x_mm: Array
    y_mm: Array
    n_paths: int


def simulate_slab(
    medium: Medium,
    slab: Slab,
    *,
    n_bounces: int,
    n_paths: int,
    cell_mm: float,
    seed: int,
    wavenumber_per_mm: float = 0.0,
    harmonics: tuple[int, ...] = (),
    by_order: bool = True,
    width_mm: float | None = None,
    beam: Beam | None = None,
    scored: Literal["camera", "fluence"] = "camera",
    n_threads: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> SlabSample:
    """Follow ``n_paths`` paths through ``n_bounces`` bounces of a slab.

    Parameters
    ----------
    harmonics : ascending multiples of the wave number whose modulation is wanted
    by_order : whether the modulation is wanted for every order, or summed over them
    width_mm, beam : of a tank with black side walls, and the part of its face that is lit; without
        them the slab and its light have no end along y, and there is one cell
    scored : what the camera sees, or the fluence averaged over the height

    Raises
    ------
    AnalysisError
        If the beam is slanted or leaves the face, the medium is empty or |g| is one, or a number
        is too small.

    Notes
    -----
    The standard errors are those of sixteen batches, so they are themselves known to 18 %. The
    medium's ``phase``, which is about flatland, is not looked at: scattering is Eq. 2 on the
    sphere.
    """
    _refuse(medium, n_bounces, n_paths, cell_mm, beam)
    n_x = max(1, round(slab.depth_mm / cell_mm))
    if width_mm is None or beam is None:
        width, n_y, middle = ENDLESS_MM, 1, 0.5 * ENDLESS_MM
        entry = np.array([middle - 1.0, middle + 1.0]), np.ones(2)
        per_cell = 1.0
    else:
        width, n_y = width_mm, max(1, round(width_mm / cell_mm))
        entry = beam.entering(Tank(depth_mm=slab.depth_mm, width_mm=width)).profile_points()
        per_cell = float(np.trapezoid(entry[1], entry[0])) * n_y / width
    n_slots = n_bounces - 1 if by_order else 1
    slots = np.arange(n_bounces - 1) if by_order else np.zeros(n_bounces - 1, dtype=np.int64)
    n_batch = n_paths // N_BATCHES

    def run(number: int) -> tuple[Array, NDArray[np.complex128]]:
        rng = np.random.default_rng([seed, number])
        scores = np.zeros((n_bounces - 1, n_y, n_x))
        waves = np.zeros((n_slots, n_y, n_x, len(harmonics)), dtype=np.complex128)
        follow_slab(
            (float(medium.sigma_t_per_mm), float(medium.sigma_s_per_mm), float(medium.g)),
            (float(slab.depth_mm), float(width), float(slab.height_mm)),
            float(slab.surface_index),
            with_cumulative(*entry),
            (0, n_batch),
            rng,
            rng.random(N_LATTICE),
            lattice_steps(N_LATTICE),
            scored == "camera",
            wavenumber_per_mm,
            np.asarray(harmonics, dtype=np.int64),
            slots.astype(np.int64),
            scores,
            waves,
        )
        return scores, np.moveaxis(waves, -1, 0)

    found = _run_all(run, n_threads, progress)
    scale = per_cell / (n_batch * slab.depth_mm / n_x)
    if scored == "camera":
        across = float(phase_function(np.array(0.5 * math.pi), medium.g, "hg-paper"))
        seen = lit_length(medium.sigma_t_per_mm, slab.height_mm) / slab.height_mm
        scale /= across * seen
    light, std_error = mean_and_error([scores for scores, _ in found])
    modulated = np.mean([waves for _, waves in found], axis=0)
    _, wave_error = mean_and_error([waves.real for _, waves in found])
    return SlabSample(
        light=scale * light,
        std_error=scale * std_error,
        modulated=scale * modulated,
        modulated_std_error=scale * wave_error,
        x_mm=(np.arange(n_x) + 0.5) * slab.depth_mm / n_x,
        y_mm=(np.arange(n_y) + 0.5) * width / n_y,
        n_paths=n_batch * N_BATCHES,
    )


def _run_all(
    run: Callable[[int], tuple[Array, NDArray[np.complex128]]],
    n_threads: int,
    progress: Callable[[int, int], None] | None,
) -> list[tuple[Array, NDArray[np.complex128]]]:
    """Run every batch; each has its own numbers, whatever the threads."""
    with ThreadPoolExecutor(n_threads) as pool:
        runs = [pool.submit(run, number) for number in range(N_BATCHES)]
        try:
            for done, finished in enumerate(as_completed(runs), start=1):
                finished.result()
                if progress is not None:
                    progress(done, N_BATCHES)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Ctrl-C need not wait for all batches
            raise
    return [finished.result() for finished in runs]


def _refuse(
    medium: Medium, n_bounces: int, n_paths: int, cell_mm: float, beam: Beam | None
) -> None:
    msg = ""
    if medium.sigma_t_per_mm == 0.0 or abs(medium.g) == 1.0:
        msg = (
            f"sigma_t = {medium.sigma_t_per_mm}, g = {medium.g}: a slab needs some extinction and "
            "|g| < 1."
        )
    elif n_bounces < 2 or n_paths < N_BATCHES:
        msg = f"{n_paths} paths of {n_bounces} bounces: at least {N_BATCHES} paths of 2 are needed."
    elif not (math.isfinite(cell_mm) and cell_mm > 0.0):
        msg = f"cell_mm = {cell_mm}: the cell must be a positive length."
    elif beam is not None and beam.angle_deg != 0.0:
        msg = f"angle_deg = {beam.angle_deg}: light enters a slab straight; set the angle to 0."
    if msg:
        raise AnalysisError(msg)
