"""Light of a layer of liquid of known height, by the Monte Carlo in three dimensions."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from analysis.medium import Slab
from analysis.transport.montecarlo import SampledField
from analysis.transport.montecarlo_slab import simulate_slab
from labrig.models.scene import Scene

PILOT_PATHS, PILOT_CELL_MM = 4000, 2.0  # of the run that tells how many bounces are needed


def sample_layer(
    scene: Scene,
    slab: Slab,
    most_bounces: int,
    n_paths: int,
    waves: tuple[float, tuple[int, ...]],
    progress: Callable[[int, int], None] | None = None,
) -> SampledField:
    """Return what the camera sees of a layer's bounces, white and under waves along its face.

    Parameters
    ----------
    most_bounces : more are not followed; fewer are where they hold all but the scene's ``tail`` of
        the light, much of which leaves through surface and floor
    waves : wave number in 1/mm, and its multiples
    """
    medium, wavenumber, n_threads = scene.medium.record(), waves[0], os.cpu_count() or 1
    pilot = simulate_slab(
        medium,
        slab,
        n_bounces=most_bounces,
        n_paths=PILOT_PATHS,
        cell_mm=PILOT_CELL_MM,
        seed=scene.transport.seed,
        n_threads=n_threads,
    )
    sample = simulate_slab(
        medium,
        slab,
        n_bounces=_enough(pilot.light[:, 0].mean(axis=1), scene),
        n_paths=n_paths,
        cell_mm=scene.transport.cell_mm,
        seed=scene.transport.seed,
        wavenumber_per_mm=wavenumber,
        harmonics=waves[1],
        by_order=False,
        width_mm=scene.tank.width_mm,
        beam=scene.beam.record(),
        n_threads=n_threads,
        progress=progress,
    )
    return SampledField(
        fluence=sample.light,
        std_error=sample.std_error,
        modulated=sample.modulated[:, 0],
        radiance=np.empty((0, sample.y_mm.size, sample.x_mm.size, 0)),
        radiance_std_error=np.empty((0, sample.y_mm.size, sample.x_mm.size, 0)),
        x_mm=sample.x_mm,
        y_mm=sample.y_mm,
        theta_rad=np.empty(0),
        n_paths=sample.n_paths,
    )


def _enough(of_bounces: np.ndarray[tuple[int], np.dtype[np.float64]], scene: Scene) -> int:
    """Return the bounce after which less than the tail of all light is left, single and all."""
    sigma_t, depth_mm = scene.medium.sigma_t_per_mm, scene.tank.depth_mm
    single = -np.expm1(-sigma_t * depth_mm) / (sigma_t * depth_mm)
    left = np.cumsum(of_bounces[::-1])[::-1]  # this bounce and later ones
    needless = np.flatnonzero(left < scene.tail * (single + of_bounces.sum()))
    return 2 + (int(needless[0]) if needless.size else of_bounces.size - 1)
