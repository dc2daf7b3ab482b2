"""Every bounce of a scene whose liquid has a height: solved as a slab, to a tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.light_field import BounceField, Grid
from analysis.slab_field import slab_bounces
from analysis.transport.slab_tolerance import SettledSlab, solve_to
from labrig.errors import PlanError
from labrig.models.scene import Scene

N_CELLS = 100  # along the depth
N_THETA = 64
LEAST_ORDERS, MOST_ORDERS = 3, 120


def layer_bounces(
    scene: Scene, *, orders: int | None, tolerance: float, engine: str
) -> BounceField:
    """Return the bounces of a layer; see `analysis.slab_field`.

    Raises
    ------
    PlanError
        If another engine is asked for, or the tolerance cannot be met.
    """
    slab = scene.tank.slab()
    if slab is None or engine != "auto":
        msg = (
            f"engine {engine}: a layer of known height has one solver of its own; leave the "
            "engine out, or leave tank.height_mm out."
        )
        raise PlanError(msg)
    medium, tank = scene.medium.record(), scene.tank.record()
    wanted = orders or _enough(solve_to(medium, slab, tolerance=0.1, n_bounces=MOST_ORDERS), scene)
    wanted = max(wanted, 2)
    settled = solve_to(medium, slab, tolerance=tolerance, n_bounces=wanted)
    if not settled.reached:
        msg = (
            f"tolerance {tolerance:g}: the finest slab solution leaves {settled.error.max():.1e} "
            "of a bounce; ask for less, or for fewer orders."
        )
        raise PlanError(msg)
    grid = Grid.covering(tank, cell_mm=tank.depth_mm / N_CELLS, n_theta=N_THETA)
    found = slab_bounces(
        medium,
        slab,
        scene.beam.record(),
        grid,
        n_bounces=wanted,
        fineness=settled.fineness,
    )
    return replace(found.seen, error_estimate=settled.error)


def _enough(settled: SettledSlab, scene: Scene) -> int:
    """Return the bounce after which less than the scene's tail of all light is left."""
    field = settled.field
    light = np.trapezoid(
        field.camera * np.exp(-field.sigma_t_per_mm * field.x_mm), field.x_mm, axis=1
    )
    light = light * scene.medium.record().albedo ** np.arange(light.size)
    left = np.append(np.cumsum(light[::-1])[::-1][1:], 0.0)
    return max(LEAST_ORDERS, 1 + int(np.argmax(left < scene.tail * light.sum())))
