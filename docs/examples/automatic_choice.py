"""What the automatic choice of a grid costs beside the cheapest grid that meets the tolerance.

    python docs/examples/automatic_choice.py [TOLERANCE ...]

Twelve scenes, orders 2 to 6 without a light field. The truth is a solution to a tenth of the
tolerance (order 2: its closed form); the grids tried are finer and coarser than the first guess,
with and without more directions for the second bounce. Writes a table; ten minutes on one core.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.interpolate import RectBivariateSpline

from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.transport.choose import guess, relative_error
from analysis.transport.ordinates import second_fluence, solve_on
from analysis.transport.solve import solve

ORDERS = 6
CELLS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.8)
DIRECTIONS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
TIMED = 8  # grids, those that are cheapest by their number of radiances

# sigma_t, albedo, g; depth, width; beam from, to; angle
SCENES = (
    (0.2051, 0.9, 0.4, 100, 75, 25, 50, 0),
    (1.0, 0.9, -0.5, 20, 20, 5, 15, 0),
    (0.2, 0.9, 0.8, 40, 40, 15, 25, 0),
    (0.4, 0.9, 0.0, 40, 40, 15, 25, 0),
    (0.05, 0.99, 0.4, 100, 75, 25, 50, 0),
    (0.2051, 0.5, 0.4, 100, 75, 25, 50, 30),
    (0.1, 0.9, 0.0, 40, 40, 15, 25, 80),
    (1.0, 0.99, 0.4, 20, 20, 5, 15, 0),
    (0.2, 0.9, 0.4, 10, 100, 40, 60, 0),
    (0.1, 0.9, 0.6, 150, 15, 5, 10, 0),
    (0.2051, 0.9, 0.4, 40, 40, 19, 21, 0),
    (0.05, 0.99, 0.7, 100, 75, 25, 50, 30),
)


def main() -> None:
    """Write a row for each tolerance and scene."""
    rows = itertools.product([float(word) for word in sys.argv[1:]] or [1e-2, 1e-3], SCENES)
    head = ["| scene | asked | CPU s | worst error | times the cheapest | which is |"]
    for row in itertools.chain(head, ["| --- " * 6 + "|"], (line(s, t) for t, s in rows)):
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


def line(scene: tuple[float, ...], asked: float) -> str:
    """Return a row of the table."""
    sigma_t, albedo, g, depth, width, low, high, angle = scene
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=albedo * sigma_t, g=g)
    tank = Tank(depth_mm=depth, width_mm=width)
    beam = Beam(from_mm=low, to_mm=high, angle_deg=angle)
    truth = solve(medium, tank, beam, orders=ORDERS, tolerance=asked / 10, light_field=False)

    def automatic() -> BounceField:
        return solve(medium, tank, beam, orders=ORDERS, tolerance=asked, light_field=False)

    def on(grid: Grid, second_times: int) -> BounceField:
        return solve_on(
            medium,
            beam,
            grid,
            n_bounces=ORDERS,
            light_field=False,
            dtype=np.float32,
            second_times=second_times,
        )

    base, fits = guess(medium, tank, beam, asked), []
    for times, more, second in itertools.product(CELLS, DIRECTIONS, (1, 3)):
        grid = base.scaled(times, math.ceil(more * base.least_theta)).grid(tank)
        radiances = grid.n_x * grid.n_y * grid.n_theta * (ORDERS - 2 + second)
        fits.append((radiances, grid.n_y, grid.n_x, grid.n_theta, second))
    met: list[tuple[float, str]] = []
    for _, n_y, n_x, n_theta, second in sorted(set(fits)):
        grid = Grid(tank=tank, n_x=n_x, n_y=n_y, n_theta=n_theta)
        if worst(on(grid, second), truth) <= asked:
            name = f"{n_y - 1} x {n_x - 1} cells, {n_theta} directions"
            name += ", more for order 2" if second > 1 else ""
            met.append((seconds(lambda grid=grid, second=second: on(grid, second)), name))
        if len(met) == TIMED:
            break
    took, error = seconds(automatic), worst(automatic(), truth)
    cheapest, name = min(met) if met else (math.nan, "none tried")
    what = f"({sigma_t:g}, {albedo:g}, {g:g}); {depth:g} x {width:g}, {high - low:g}"
    what += f"; {angle:g}°" if angle else ""
    return f"| {what} | {asked:g} | {took:.3f} | {error:.1e} | {took / cheapest:.1f} | {name} |"


def worst(field: BounceField, truth: BounceField) -> float:
    """Return the largest relative error of orders 2 to K."""
    fine, grid = truth.grid, field.grid
    second = second_fluence(field.medium, field.beam, grid, equal_angles(2048))
    errors = [relative_error(field.fluence[1], field.medium.sigma_s_per_mm * second)]
    for k in range(2, ORDERS):
        spline = RectBivariateSpline(fine.y_mm, fine.x_mm, truth.fluence[k])
        errors.append(relative_error(field.fluence[k], spline(grid.y_mm, grid.x_mm)))
    return max(errors)


def seconds(what: Callable[[], BounceField]) -> float:
    """Return the least processor time of three calls, s."""
    least = math.inf
    for _ in range(3):
        begin = time.process_time()
        what()
        least = min(least, time.process_time() - begin)
    return least


if __name__ == "__main__":
    main()
