"""Every bounce of a scene whose liquid has a height: by the slab's solver or by its Monte Carlo."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from analysis.light_field import BounceField, Cells, Grid
from analysis.medium import Slab
from analysis.slab_field import slab_bounces
from analysis.transport.beam import ballistic_fluence
from analysis.transport.montecarlo import relative_noise
from analysis.transport.montecarlo_slab import SlabSample, simulate_slab
from analysis.transport.slab_tolerance import SettledSlab, solve_to
from labrig.errors import PlanError
from labrig.models.scene import Scene

N_CELLS = 100  # along the depth
N_THETA = 64
LEAST_ORDERS, MOST_ORDERS = 3, 120
COARSE = 0.1  # tolerance of a solution that only tells what is needed
ENGINES = ("auto", "montecarlo")
PILOT_PATHS, MOST_PATHS = 50_000, 200_000_000
MORE_PATHS = 1.2  # than the noise of the last run calls for

Followed = Callable[[int, int], None]


def layer_of(scene: Scene, engine: str) -> Slab:
    """Return the layer of a scene that has one, for an engine that can solve it.

    Raises
    ------
    PlanError
        If the engine is one of the plane's.
    """
    slab = scene.tank.slab()
    if slab is None or engine not in ENGINES:
        msg = (
            f"engine {engine} computes in a plane, and the tank's liquid has a height: choose "
            f"{' or '.join(ENGINES)}, or leave tank.height_mm out for a plane."
        )
        raise PlanError(msg)
    return slab


def layer_bounces(
    scene: Scene,
    *,
    orders: int | None,
    tolerance: float,
    engine: str,
    progress: Followed | None = None,
) -> BounceField:
    """Return the bounces of a layer; see `analysis.slab_field`.

    Those of the Monte Carlo are means over cells, of what the camera sees, without a light field.

    Raises
    ------
    PlanError
        If the engine is one of the plane's, or the tolerance cannot be met.
    """
    slab = layer_of(scene, engine)
    wanted = orders_of(scene, slab, orders)
    if engine == "montecarlo":
        return _sampled(_Paths(scene=scene, slab=slab, orders=wanted), tolerance, progress)
    medium = scene.medium.record()
    settled = solve_to(medium, slab, tolerance=tolerance, n_bounces=wanted)
    if not settled.reached:
        msg = (
            f"tolerance {tolerance:g}: the finest slab solution leaves {settled.error.max():.1e} "
            "of a bounce; ask for less, or for fewer orders."
        )
        raise PlanError(msg)
    found = slab_bounces(
        medium,
        slab,
        scene.beam.record(),
        picture_grid(scene),
        n_bounces=wanted,
        fineness=settled.fineness,
    )
    return replace(found.seen, error_estimate=settled.error)


def picture_grid(scene: Scene) -> Grid:
    """Return where bounces are told."""
    tank = scene.tank.record()
    return Grid.covering(tank, cell_mm=tank.depth_mm / N_CELLS, n_theta=N_THETA)


def orders_of(scene: Scene, slab: Slab, orders: int | None) -> int:
    """Return as many orders as are asked for, or as hold all but the scene's tail of the light."""
    if orders is not None:
        return max(orders, 2)
    return enough(coarsely(scene, slab, None), scene)


def coarsely(scene: Scene, slab: Slab, orders: int | None) -> SettledSlab:
    """Return a quick solution, which tells how many bounces matter and what they will cost.

    In a layer a bounce holds less light than the albedo leaves of the one before.
    """
    medium = scene.medium.record()
    if orders is None:
        albedo = min(medium.albedo, math.exp(-1.0 / MOST_ORDERS))
        orders = math.ceil(math.log(scene.tail * (1.0 - albedo)) / math.log(max(albedo, 0.01)))
        orders = min(max(orders, LEAST_ORDERS), MOST_ORDERS)
    return solve_to(medium, slab, tolerance=COARSE, n_bounces=max(orders, 2))


def enough(settled: SettledSlab, scene: Scene) -> int:
    """Return the bounce after which less than the scene's tail of all light is left."""
    field = settled.field
    light = np.trapezoid(
        field.camera * np.exp(-field.sigma_t_per_mm * field.x_mm), field.x_mm, axis=1
    )
    light = light * scene.medium.record().albedo ** np.arange(light.size)
    left = np.append(np.cumsum(light[::-1])[::-1][1:], 0.0)
    return max(LEAST_ORDERS, 1 + int(np.argmax(left < scene.tail * light.sum())))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Paths:
    """What paths are followed through."""

    scene: Scene
    slab: Slab
    orders: int

    def follow(self, n_paths: int, seed: int, progress: Followed | None) -> SlabSample:
        scene = self.scene
        return simulate_slab(
            scene.medium.record(),
            self.slab,
            n_bounces=self.orders,
            n_paths=n_paths,
            cell_mm=scene.tank.depth_mm / N_CELLS,
            seed=seed,
            width_mm=scene.tank.width_mm,
            beam=scene.beam.record(),
            n_threads=os.cpu_count() or 1,
            progress=progress,
        )


def _sampled(paths: _Paths, tolerance: float, progress: Followed | None) -> BounceField:
    """Follow as many paths as the noise of fewer calls for, until every bounce is known."""
    n_paths, seed = PILOT_PATHS, 1
    while True:
        sample = paths.follow(n_paths, seed, progress)
        noise = relative_noise(sample.light, sample.std_error)
        if noise.max() <= tolerance:
            break
        wanted = MORE_PATHS * n_paths * float(noise.max() / tolerance) ** 2
        if wanted > MOST_PATHS:
            msg = (
                f"tolerance {tolerance:g}: the Monte Carlo would need {wanted:.1g} paths, at most "
                f"{MOST_PATHS:.1g} are followed; ask for a looser one, or leave the engine out."
            )
            raise PlanError(msg)
        n_paths, seed = math.ceil(wanted), seed + 1
    scene = paths.scene
    n_y, n_x = sample.light.shape[1:]
    cells = Cells(tank=scene.tank.record(), n_x=n_x, n_y=n_y, n_theta=N_THETA)
    beam = scene.beam.record().entering(cells.tank)
    first = ballistic_fluence(
        cells.x_mm, cells.y_mm, sigma_t_per_mm=scene.medium.sigma_t_per_mm, beam=beam
    )[None]
    return BounceField(
        medium=scene.medium.record(),
        beam=beam,
        grid=cells,
        fluence=np.concatenate([first, sample.light]),
        light_field=None,
        engine="montecarlo",
        error_estimate=np.concatenate([[0.0], noise]),
    )
