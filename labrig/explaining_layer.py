"""What solving a layer would take: resolution, processor time and memory, nothing solved finely."""

from __future__ import annotations

import math
import time

from analysis.light_field import Grid
from analysis.medium import Medium, Slab
from analysis.slab_field import wave_grids
from analysis.transport.choose import Resolution
from analysis.transport.montecarlo import N_BATCHES
from analysis.transport.slab import solve_slab
from analysis.transport.slab_grid import SlabGrid
from analysis.transport.slab_resolution import depths, directions
from analysis.transport.slab_tolerance import FINER, FINEST, SettledSlab, first_fineness
from analysis.transport.solve import Choice
from labrig.models.scene import Scene
from labrig.solving_layer import coarsely, enough, layer_of, picture_grid

FIELD_BYTES = 24.0  # of each value of the light field: what is kept, and the work on one bounce
WAVE_BYTES = 16.0  # of each value of a wave's light by bearing
BATCH_BYTES = 8.0 * (N_BATCHES + 4)  # of each cell and bounce of the Monte Carlo


def choose_layer(
    scene: Scene, *, orders: int | None, tolerances: list[float], engine: str
) -> list[tuple[Choice, float]]:
    """Return what each tolerance would take, and its processor time, s.

    The time is NaN where only a run can tell. A coarse solution tells how many bounces matter and
    how finely each tolerance is to be solved. The resolution holds the cells of the picture and
    the directions of white light's transport.

    Raises
    ------
    PlanError
        If the engine is one of the plane's.
    """
    slab = layer_of(scene, engine)
    coarse = coarsely(scene, slab, orders)
    wanted = enough(coarse, scene) if orders is None else max(orders, 2)
    if engine == "montecarlo":
        return [_by_paths(scene, wanted, one) for one in tolerances]
    rate_s = layer_rate_s()
    return [_chosen(scene, slab, coarse, wanted, one, rate_s) for one in tolerances]


def _chosen(
    scene: Scene, slab: Slab, coarse: SettledSlab, orders: int, tolerance: float, rate_s: float
) -> tuple[Choice, float]:
    medium, picture = scene.medium.record(), picture_grid(scene)
    wanted, first = coarse.fineness_for(tolerance, orders), first_fineness(tolerance)
    fineness = min(wanted, FINEST)
    white = white_grid(medium, slab, fineness)
    waves = wave_grids(medium, slab, scene.beam.record(), picture, fineness=fineness)
    tried = {first / FINER, first, 0.5 * first, fineness, 0.5 * fineness}
    work = sum(white_grid(medium, slab, f).work(orders, striped=False) for f in tried)
    work += sum(on.work(orders, striped=q > 0.0) for q, on in waves)
    reason = (
        f"a layer has a solver of its own: {white.x_mm.size} depths, {white.n_z} polynomials over "
        f"the height, {len(waves)} waves along the face"
    )
    if wanted > FINEST:
        reason += "; a tolerance that will hardly be met"
    choice = Choice(
        engine="slab",
        reason=reason,
        resolution=_cells(picture, white.n_directions),
        orders=orders,
        tolerance=tolerance,
        memory_bytes=max(on.memory_bytes for _, on in waves)
        + _kept_bytes(picture, orders, white.x_mm.size * len(waves)),
    )
    return choice, work * rate_s


def _by_paths(scene: Scene, orders: int, tolerance: float) -> tuple[Choice, float]:
    """Return what the Monte Carlo takes; how long, only its noise can tell."""
    picture = picture_grid(scene)
    choice = Choice(
        engine="montecarlo",
        reason="asked for; paths are followed until every bounce is known",
        resolution=_cells(picture, picture.n_theta),
        orders=orders,
        tolerance=tolerance,
        memory_bytes=BATCH_BYTES * (orders - 1.0) * picture.n_x * picture.n_y,
    )
    return choice, math.nan


def _cells(picture: Grid, n_directions: int) -> Resolution:
    return Resolution(
        cells_x=picture.n_x - 1,
        cells_y=picture.n_y - 1,
        n_theta=n_directions,
        least_theta=n_directions,
        edges=(0.0, 1.0),
    )


def _kept_bytes(picture: Grid, orders: int, n_waves_x: int) -> float:
    light_field = (orders - 1.0) * picture.n_x * picture.n_y * picture.n_theta
    return FIELD_BYTES * light_field + WAVE_BYTES * orders * n_waves_x * picture.n_theta


def white_grid(medium: Medium, slab: Slab, fineness: float) -> SlabGrid:
    """Return what white light is solved on."""
    x_mm = depths(medium.sigma_t_per_mm, slab, fineness=fineness)
    return directions(medium.g, slab, x_mm, wavenumber_per_mm=0.0, fineness=fineness)


def layer_rate_s() -> float:
    """Return the processor time of a unit of `SlabGrid.work`, measured on a small layer."""
    medium = Medium(sigma_t_per_mm=0.2, sigma_s_per_mm=0.1, g=0.4)
    slab = Slab(depth_mm=30.0, height_mm=5.0)
    grid, best = white_grid(medium, slab, 1.2), float("inf")
    for _ in range(3):
        begin = time.process_time()
        solve_slab(medium, slab, grid, n_bounces=6)
        best = min(best, time.process_time() - begin)
    return best / grid.work(6, striped=False)
