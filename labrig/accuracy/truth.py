"""The best truth that a scene has: a closed form for order 2, extrapolated ordinates beyond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import RectBivariateSpline

from analysis.light_field import Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import USUAL_RATE, guess, relative_error, resolvable
from analysis.transport.ordinates import DType, second_fluence, solve_on

MOST_RADIANCES = 5e8
FINEST = 1e-4  # the tolerance whose grid the truth's is at least
LEAST_DIRECTIONS = 256
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
    error : relative, of the later ones: half of what the extrapolation changed, and a quarter of
        what the spline misses between nodes twice as far apart
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
    """Solve on two very fine nested grids and extrapolate; order 2 is the closed form."""
    fine = _finest(medium, tank, beam, orders)
    half = Grid(
        tank=tank,
        n_x=(fine.n_x - 1) // 2 + 1,
        n_y=(fine.n_y - 1) // 2 + 1,
        n_theta=max(fine.n_theta // 2, resolvable(medium.g)),
    )
    found = []
    for done, grid in enumerate((half, fine)):
        progress("truth", done, 3)
        found.append(
            solve_on(medium, beam, grid, n_bounces=orders, light_field=False, dtype=dtype).fluence
        )
    progress("truth", 2, 3)
    limits = [_limit(half, fine, *pair) for pair in zip(found[0][2:], found[1][2:], strict=True)]
    second = _second(medium, beam, half, CELL_DIRECTIONS)
    progress("truth", 3, 3)
    return Truth(
        medium=medium,
        beam=beam,
        second=RectBivariateSpline(half.y_mm, half.x_mm, second),
        later=[spline for spline, _ in limits],
        error=max(error for _, error in limits),
    )


def _limit(
    half: Grid, fine: Grid, coarser: Array, finer: Array
) -> tuple[RectBivariateSpline, float]:
    """Return one order on ever finer grids, as a spline, and its relative error."""
    places = (fine.y_mm, fine.x_mm)
    change = (finer[::2, ::2] - coarser) / (2.0**USUAL_RATE - 1.0)
    limit = finer + RectBivariateSpline(half.y_mm, half.x_mm, change)(*places)
    between = RectBivariateSpline(half.y_mm, half.x_mm, finer[::2, ::2])(*places)
    error = 0.5 * relative_error(finer, limit) + 0.25 * relative_error(between, finer)
    return RectBivariateSpline(*places, limit), error


def _finest(medium: Medium, tank: Tank, beam: Beam, orders: int) -> Grid:
    """Return twice the grid guessed for the finest tolerance, as far as it is affordable."""
    wanted = guess(medium, tank, beam, FINEST)
    n_theta = max(LEAST_DIRECTIONS, wanted.n_theta, 2 * resolvable(medium.g))
    cells = 4.0 * wanted.cells_x * wanted.cells_y
    share = min(1.0, MOST_RADIANCES / (cells * n_theta * (orders - 1))) ** 0.5
    return Grid(
        tank=tank,
        n_x=max(8, 4 * round(0.5 * wanted.cells_x * share)) + 1,
        n_y=max(8, 4 * round(0.5 * wanted.cells_y * share)) + 1,
        n_theta=n_theta,
    )


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
