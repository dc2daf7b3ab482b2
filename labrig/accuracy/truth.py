"""The best truth that a scene has: a closed form for order 2, extrapolated ordinates beyond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from analysis.light_field import Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import RATES, USUAL_RATE, guess, relative_error, resolvable
from analysis.transport.ordinates import DType, second_fluence, solve_on

MOST_RADIANCES = 8e8  # of the finest grid
FINEST, FINER = 1e-4, 4.0  # the truth has so many times the cells, each way, of this tolerance
# What is wrong of the extrapolation in cells: of four scenes, 0.15 to 0.34 on 2.8 times the cells.
CELLS_LEFT = 0.35
FEW, MANY = 192, 4  # directions, and times them
SECOND_TIMES = 3  # so many directions for what the second order feeds to the third
SECOND_DIRECTIONS = 8192  # for point values
CELL_DIRECTIONS = 1024  # for means over cells, which are held to noise
MOST_JUDGED = 4000  # nodes; of finer grids every second or fourth is looked at
GAUSS_POINTS = 4  # along each side of a cell, for its mean

Shape = tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Fluence of orders 2 .. K anywhere in the tank.

    Attributes
    ----------
    second : order 2, for means over cells only
    later : orders 3 .. K, splines in y and x
    error : relative, of the later ones: a third of what the extrapolation in cells changed, half of
        what differs if directions are judged on cells twice as large, and a quarter of what the
        spline misses between nodes twice as far apart
    """

    medium: Medium
    beam: Beam
    second: RectBivariateSpline
    later: list[RectBivariateSpline]
    error: float
    _exact: dict[Shape, Array] = field(default_factory=dict)

    def errors_on(self, grid: Grid, fluence: Array) -> Array:
        """Return the relative errors of orders 2 .. K of point values (K, n_y, n_x)."""
        step, judged = _thinned(grid)
        found = fluence[1:, ::step, ::step]
        truth = [self._second_on(judged)]
        truth += [spline(judged.y_mm, judged.x_mm) for spline in self.later]
        return np.array([relative_error(a, b) for a, b in zip(found, truth, strict=True)])

    def second_error_on(self, grid: Grid, second: Array) -> float:
        """Return the relative error of order 2 alone."""
        step, judged = _thinned(grid)
        return relative_error(second[::step, ::step], self._second_on(judged))

    def errors_over(self, x_mm: Array, y_mm: Array, fluence: Array) -> Array:
        """Return the relative errors of orders 2 .. K of means over cells (K - 1, n_y, n_x)."""
        truth = [_means(spline, y_mm, x_mm) for spline in (self.second, *self.later)]
        return np.array([relative_error(a, b) for a, b in zip(fluence, truth, strict=True)])

    def _second_on(self, grid: Grid) -> Array:
        shape = (grid.n_y, grid.n_x)
        if shape not in self._exact:
            self._exact[shape] = _second(self.medium, self.beam, grid, SECOND_DIRECTIONS)
        return self._exact[shape]


def find_truth(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    orders: int,
    dtype: DType,
    progress: Callable[[str, int, int], None],
) -> Truth:
    """Extrapolate orders in cells and in directions; order 2 is the closed form.

    Three nested grids with few directions tell what ever smaller cells come to, and many
    directions on the coarsest of them what the few ones leave.
    """
    fine = _finest(medium, tank, beam, orders)
    half, quarter = _every(fine, 2), _every(fine, 4)
    many = replace(quarter, n_theta=MANY * fine.n_theta)
    grids = [quarter, half, fine, replace(quarter, n_theta=many.n_theta // 2), many]
    grids += [_every(fine, 8), replace(_every(fine, 8), n_theta=many.n_theta)]
    found = []
    for done, grid in enumerate(grids):
        progress("truth", done, len(grids) + 1)
        found.append(
            solve_on(
                medium,
                beam,
                grid,
                n_bounces=orders,
                light_field=False,
                dtype=dtype,
                second_times=SECOND_TIMES,
            ).fluence
        )
    limits = [_limit(grids, [one[k] for one in found]) for k in range(2, orders)]
    second = _second(medium, beam, half, CELL_DIRECTIONS)
    progress("truth", len(grids) + 1, len(grids) + 1)
    return Truth(
        medium=medium,
        beam=beam,
        second=RectBivariateSpline(half.y_mm, half.x_mm, second),
        later=[spline for spline, _ in limits],
        error=max(error for _, error in limits),
    )


def _limit(grids: list[Grid], found: list[Array]) -> tuple[RectBivariateSpline, float]:
    """Return one order on ever finer grids, as a spline, and its relative error."""
    quarter, half, fine = grids[:3]
    coarse, middle, finest, halfway, many, few_8, many_8 = found
    places = (fine.y_mm, fine.x_mm)

    def spread(grid: Grid, values: Array) -> Array:
        return np.asarray(RectBivariateSpline(grid.y_mm, grid.x_mm, values)(*places))

    changes = relative_error(coarse, middle[::2, ::2]), relative_error(middle, finest[::2, ::2])
    rate = float(np.clip(np.log2(changes[0] / changes[1]), *RATES))
    by_cells = spread(half, (finest[::2, ::2] - middle) / (2.0**rate - 1.0))
    by_angles = many - coarse + (many - halfway) / (2.0**USUAL_RATE - 1.0)
    limit = finest + by_cells + spread(quarter, by_angles)
    # What directions do may depend on the cells: it is told by cells twice as large.
    mixed = relative_error((many - coarse)[::2, ::2] + few_8, many_8)
    between = relative_error(spread(half, finest[::2, ::2]), finest)
    error = CELLS_LEFT * relative_error(finest + by_cells, finest) + 0.5 * mixed + 0.25 * between

    return RectBivariateSpline(*places, limit), error


def _finest(medium: Medium, tank: Tank, beam: Beam, orders: int) -> Grid:
    """Return far more cells than the finest tolerance takes, as far as they are affordable."""
    wanted = guess(medium, tank, beam, FINEST)
    n_theta = max(FEW, resolvable(medium.g))
    cells = 1.0 * wanted.cells_x * wanted.cells_y
    more = min(FINER, (MOST_RADIANCES / (cells * n_theta * (orders - 1))) ** 0.5)
    return wanted.scaled(more, n_theta, unit=8).grid(tank)


def _every(grid: Grid, step: int) -> Grid:
    """Return the grid of every second, fourth or eighth node."""
    return replace(grid, n_x=(grid.n_x - 1) // step + 1, n_y=(grid.n_y - 1) // step + 1)


def _thinned(grid: Grid) -> tuple[int, Grid]:
    """Return the nodes that are judged: each step-th, and the grid of these."""
    step = 1
    while (
        (grid.n_x - 1) % (2 * step) == 0
        and (grid.n_y - 1) % (2 * step) == 0
        and grid.n_x * grid.n_y > MOST_JUDGED * step**2
    ):
        step *= 2
    return step, Grid(
        tank=grid.tank,
        n_x=(grid.n_x - 1) // step + 1,
        n_y=(grid.n_y - 1) // step + 1,
        n_theta=grid.n_theta,
    )


def _second(medium: Medium, beam: Beam, grid: Grid, n_theta: int) -> Array:
    summed = second_fluence(medium, beam, grid, equal_angles(n_theta))
    return np.asarray(medium.sigma_s_per_mm * summed)


def _means(spline: RectBivariateSpline, y_mm: Array, x_mm: Array) -> Array:
    """Return means over cells with these centres, (n_y, n_x)."""
    points, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)

    def inside(centres: Array) -> Array:
        half = 0.5 * (centres[1] - centres[0]) if centres.size > 1 else centres[0]
        return np.asarray((centres[:, None] + half * points).ravel())

    values = spline(inside(y_mm), inside(x_mm))
    blocks = values.reshape(y_mm.size, GAUSS_POINTS, x_mm.size, GAUSS_POINTS)
    return np.asarray(np.einsum("aibj,i,j->ab", blocks, 0.5 * weights, 0.5 * weights))
