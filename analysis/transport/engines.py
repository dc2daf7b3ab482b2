"""The other engines behind the front door: depth alone, Monte Carlo, the paper's recursion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Cells, Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.beam import ballistic_fluence
from analysis.transport.choose import (
    MARGIN,
    SECOND_RATE,
    Resolution,
    Wanted,
    refuse_too_large,
    relative_error,
    relative_errors,
    resolvable,
)
from analysis.transport.exhaustive import solve_exhaustive
from analysis.transport.montecarlo import simulate
from analysis.transport.plane import DepthField, PlaneGrid, solve_plane

PLANE_START = 64  # nodes and directions tried first
PLANE_ATTEMPTS = 6
SAMPLED_CELLS = 100  # along the longer side
SAMPLED_ANGLES = 64
MOST_PATHS = 2_000_000_000
ANGULAR_BYTES = 136.0  # for each bounce, cell and direction, while batches are held
EXHAUSTIVE_CELLS = 16  # along the longer side, and twice as many
EXHAUSTIVE_LIMIT_S = 600.0


def solve_in_depth(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    resolution: Resolution,
    wanted: Wanted,
) -> BounceField:
    """Solve in depth alone, doubling nodes and directions until they change little enough.

    Raises
    ------
    AnalysisError
        If the tolerance is not met.
    """
    grid = Grid(tank=tank, n_x=resolution.cells_x + 1, n_y=4, n_theta=resolution.n_theta)
    n, before = PLANE_START, None
    for _ in range(PLANE_ATTEMPTS):
        nodes = PlaneGrid.graded(
            tank.depth_mm, sigma_t_per_mm=medium.sigma_t_per_mm, n_x=n, n_theta=n
        )
        if wanted.light_field:
            nodes = nodes.watching(grid.theta_rad)
        solved = solve_plane(medium, nodes, n_bounces=wanted.orders, angle_deg=beam.angle_deg)
        watched = grid.n_theta if wanted.light_field else 0
        found = solved.at(grid.x_mm, medium.sigma_s_per_mm, n_watched=watched)
        if before is not None:
            pairs = zip(before, found.fluence, strict=True)
            error = np.array([MARGIN * relative_error(one, other) for one, other in pairs])
            error /= 2.0**SECOND_RATE - 1.0
            if error.max() <= wanted.tolerance:
                return _along_the_face(medium, beam, grid, found, error)
        n, before = 2 * n, found.fluence
    msg = f"a tolerance of {wanted.tolerance} was not met in depth alone; ask for a looser one."
    raise AnalysisError(msg)


def _along_the_face(
    medium: Medium, beam: Beam, grid: Grid, found: DepthField, error: Array
) -> BounceField:
    """Repeat what was found against depth along the face."""
    light = found.radiance
    if light is not None:
        shape = (light.shape[0], grid.n_y, grid.n_x, grid.n_theta)
        light = np.broadcast_to(light.transpose(0, 2, 1)[:, None], shape)
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=np.repeat(found.fluence[:, None, :], grid.n_y, axis=1),
        light_field=light,
        engine="plane",
        error_estimate=error,
    )


def solve_by_sampling(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    wanted: Wanted,
    progress: Callable[[int, int], None] | None = None,
) -> BounceField:
    """Follow paths until the noise of every order is below the tolerance; cell averages.

    Raises
    ------
    AnalysisError
        If the result exceeds the memory, or so many paths are not followed.
    """
    orders, light_field = wanted.orders, wanted.light_field
    longer = max(tank.depth_mm, tank.width_mm)
    cells = Cells(
        tank=tank,
        n_x=max(1, round(SAMPLED_CELLS * tank.depth_mm / longer)),
        n_y=max(1, round(SAMPLED_CELLS * tank.width_mm / longer)),
        n_theta=SAMPLED_ANGLES,
    )
    bounces = tuple(range(2, orders + 1)) if light_field else ()
    needed = ANGULAR_BYTES * len(bounces) * cells.n_x * cells.n_y * cells.n_theta
    refuse_too_large(needed, wanted.memory_bytes, f"the light field of {orders} orders in samples")
    first = ballistic_fluence(
        cells.x_mm, cells.y_mm, sigma_t_per_mm=medium.sigma_t_per_mm, beam=beam
    )[None]
    sampled = simulate(
        medium,
        tank,
        beam,
        n_bounces=orders,
        n_paths=MOST_PATHS,
        cell_mm=longer / SAMPLED_CELLS,
        seed=1,
        angular_bounces=bounces,
        n_theta=cells.n_theta,
        until_std_error=wanted.tolerance,
        progress=progress,
    )
    return BounceField(
        medium=medium,
        beam=beam,
        grid=cells,
        fluence=np.concatenate([first, sampled.fluence]),
        light_field=sampled.radiance if light_field else None,
        engine="montecarlo",
        error_estimate=np.concatenate([[0.0], sampled.relative_noise()]),
    )


def solve_exhaustively(medium: Medium, tank: Tank, beam: Beam, *, orders: int) -> BounceField:
    """Run the paper's recursion on as many cells as are bearable, each with its own light.

    Its error falls with the first power of the cell and is measured against cells twice as large;
    there is no tolerance that it could be asked for.
    """
    longer = max(tank.depth_mm, tank.width_mm)
    n_theta = max(64, resolvable(medium.g))
    coarse, fine = (
        solve_exhaustive(
            medium,
            beam,
            Grid(
                tank=tank,
                n_x=times * max(3, round(EXHAUSTIVE_CELLS * tank.depth_mm / longer)) + 1,
                n_y=times * max(3, round(EXHAUSTIVE_CELLS * tank.width_mm / longer)) + 1,
                n_theta=n_theta,
            ),
            n_bounces=orders,
            self_cell=True,
            limit_s=EXHAUSTIVE_LIMIT_S,
        )
        for times in (1, 2)
    )
    error = relative_errors(coarse.fluence, fine.fluence[:, ::2, ::2])
    error[0] = 0.0
    return replace(fine, error_estimate=MARGIN * error)
