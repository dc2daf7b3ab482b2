"""Pilots: coarse solutions that foretell the cheapest grid for a tolerance, and measure its error.

Errors come from cells and from directions. Two nested grids tell the former, which falls with a
power of the cells. Of the latter the second bounce tells on every grid: it is known in closed
form, and a third of its directions by themselves show what these leave. Later bounces feel a share
of that, as all scenes have it in common, or more, which the finer grid tells with half as many
directions again. Where bounce 2 needs no more directions than the grid's, no later one is worse,
and answers are so cheap that a guess is tried at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.light_field import BounceField, Grid
from analysis.medium import Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import SECOND_RATE, Resolution, relative_errors
from analysis.transport.sweep import cubic_weights

CELL_RATES = 2.2, -0.4  # power of the cells that errors fall with: at g = 0, and per abs(g)
USUAL_TIMES = 2.7
GUESS_MARGIN = 1.12  # cells of a first answer over those guessed, each way
LEAST_TIMES, MOST_TIMES = 1.4, 6.0  # cells of an answer over those of its pilot, each way
MORE_ANGLES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0)  # directions, likewise
CELLS_AIM, ANGLES_AIM = 0.72, 0.88  # of the tolerance, for errors from cells and from directions
CELLS_MARGIN, ANGLES_MARGIN = 1.23, 1.13  # stated errors over those told
# Powers of errors of later bounces from directions: they fall with these, by themselves and
# relative to the second bounce, whose own grow with cells.
ANGLE_RATE, SHARE_RATE, SECOND_GROWTH = 2.0, 0.7, 0.4
TURNED_TIMES = 1.5  # directions of a pilot that tells what fewer leave
# Share of the second bounce's that is usual for bounce 3 and 32 directions, and the power of the
# scatterings that it falls with.
USUAL_SHARE, FORGETTING = 0.28, 0.8
FEW_AIM = 0.5  # of the tolerance, for a second bounce summed over the grid's directions alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Errors of an answer.

    Attributes
    ----------
    cells, angles : (K,), those from cells and from directions, the latter of bounces from the third
    second : by how much more directions than the grid's change bounce 2, relative to it
    """

    cells: Array
    angles: Array
    second: float

    @property
    def stated(self) -> Array:
        """What is stated of bounces from the third on, (K,); of the others zero."""
        error = np.maximum(CELLS_MARGIN * self.cells, ANGLES_MARGIN * self.angles)
        error[:2] = 0.0
        return np.asarray(error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    """What coarse grids tell.

    Attributes
    ----------
    base, grid, fluence : the finer of them, and its orders (K, n_y, n_x)
    rate : power of the cells that errors fall with
    cells : error of its bounces from the third on that comes from cells
    second : by how much more directions than the grid's changed bounce 2, relative to it
    turned : (K,), errors of its bounces from the third on that come from directions; None where
        bounce 2 needs no more of them than the grid has
    """

    base: Resolution
    grid: Grid
    fluence: Array
    rate: float
    cells: float
    second: float
    turned: Array | None

    @classmethod
    def of(
        cls,
        base: Resolution,
        tank: Tank,
        whole: BounceField,
        half: BounceField,
        turned: BounceField | None,
    ) -> Pilot:
        """Return what a grid tells, every second node of it, and the grid with more directions.

        Those may have fewer orders; what the last of them tells stands for the later ones.
        """
        n, rate, left = half.n_bounces, _rate(whole.medium), None
        change = relative_errors(half.fluence, whole.fluence[:n, ::2, ::2])
        if turned is not None:
            told = relative_errors(whole.fluence[:n], turned.fluence)
            told /= 1.0 - TURNED_TIMES**-ANGLE_RATE
            left = np.pad(told, (0, whole.n_bounces - n), mode="edge")
        return cls(
            base=base,
            grid=base.grid(tank),
            fluence=whole.fluence,
            rate=rate,
            cells=float(change[2:].max(initial=0.0)) / (2.0**rate - 1.0),
            second=second_change(whole),
            turned=left,
        )

    @classmethod
    def of_guess(
        cls, base: Resolution, tank: Tank, whole: BounceField, guessed: Resolution, tolerance: float
    ) -> Pilot:
        """Return what a grid tells by itself, the number of cells being guessed."""
        grid, rate = base.grid(tank), _rate(whole.medium)
        times = GUESS_MARGIN * _times(guessed.grid(tank), grid)
        return cls(
            base=base,
            grid=grid,
            fluence=whole.fluence,
            rate=rate,
            cells=CELLS_AIM * tolerance * times**rate,
            second=second_change(whole),
            turned=None,
        )

    def needed(self, tolerance: float) -> float:
        """Return times the cells that are foretold to be needed."""
        return float((self.cells / (CELLS_AIM * tolerance)) ** (1.0 / self.rate))

    def cheapest(self, tolerance: float) -> Resolution | None:
        """Return the cheapest grid foretold to meet a tolerance; None if it is far off."""
        times = max(self.needed(tolerance), LEAST_TIMES)
        for more in MORE_ANGLES if times <= MOST_TIMES else ():
            answer = self.base.scaled(times, math.ceil(more * self.base.n_theta))
            cells = self.times(answer.grid(self.grid.tank))
            if self._foretold_from_directions(cells, answer.n_theta) <= ANGLES_AIM * tolerance:
                return answer
        return None

    def foretold(self, tolerance: float) -> Resolution:
        """Return the grid that would meet a tolerance, however fine."""
        times = max(self.needed(tolerance), LEAST_TIMES)
        angles = self._foretold_from_directions(times, self.base.n_theta)
        more = max((angles / (ANGLES_AIM * tolerance)) ** (1.0 / ANGLE_RATE), 1.0)
        return self.base.scaled(times, math.ceil(more * self.base.n_theta))

    def finer(self, tolerance: float) -> Resolution:
        """Return the grid of a pilot that can foretell what this one is too coarse for."""
        angles = self._foretold_from_directions(1.0, self.base.n_theta)
        more = (angles / tolerance) ** (1.0 / ANGLE_RATE) / MORE_ANGLES[-1]
        return self.base.scaled(
            min(max(self.needed(tolerance) / USUAL_TIMES, 1.0), MOST_TIMES),
            math.ceil(self.base.n_theta * max(2.0 * more, 1.0)),
            unit=2,
        )

    def measured(self, answer: BounceField, grid: Grid) -> Measured:
        """Return what is left of the errors of an answer."""
        change = relative_errors(self.fluence, _on_nodes_of(self.grid, answer))
        second = second_change(answer)
        if self.turned is None:
            second = self.second_foretold(self.times(grid), grid.n_theta)
        return Measured(
            cells=change / (self.times(grid) ** self.rate - 1.0),
            angles=self.from_directions(second, grid.n_theta),
            second=second,
        )

    def from_directions(self, second: float, n_theta: int) -> Array:
        """Return errors that so many directions leave, (K,), of the first and second bounce none.

        ``second`` is by how much more directions change bounce 2.
        """
        errors = np.zeros(self.fluence.shape[0])
        if self.turned is None:
            errors[2:] = by_grid_alone(second)
            return errors
        share = USUAL_SHARE * (2.0 / np.arange(2, errors.size)) ** FORGETTING
        share *= (32.0 / n_theta) ** SHARE_RATE
        left = self.turned[2:] * (n_theta / self.base.n_theta) ** -ANGLE_RATE
        errors[2:] = np.maximum(share * second, left)
        return errors

    def second_foretold(self, times: float, n_theta: int) -> float:
        """Return by how much more directions are foretold to change bounce 2 of another grid."""
        more = n_theta / self.base.n_theta
        return float(self.second * times**SECOND_GROWTH * more**-SECOND_RATE)

    def taught(self, grid: Grid, found: Measured) -> Pilot:
        """Return this pilot with the errors that an answer had."""
        times = self.times(grid)
        known = self.second_foretold(times, grid.n_theta)
        second = self.second * found.second / known if known > 0.0 else found.second
        cells = float(found.cells[2:].max()) * times**self.rate
        return replace(self, cells=cells, second=second)

    def times(self, grid: Grid) -> float:
        """Return how many times the cells of this pilot a grid has each way."""
        return _times(grid, self.grid)

    def _foretold_from_directions(self, times: float, n_theta: int) -> float:
        second = self.second_foretold(times, n_theta)
        return float(self.from_directions(second, n_theta).max(initial=0.0))


def _rate(medium: Medium) -> float:
    return CELL_RATES[0] + CELL_RATES[1] * abs(medium.g)


def _times(grid: Grid, other: Grid) -> float:
    pairs = ((grid.n_x, other.n_x), (grid.n_y, other.n_y))
    return math.sqrt(math.prod((many - 1) / (few - 1) for many, few in pairs))


def few_suffice(whole: BounceField, tolerance: float) -> bool:
    """Return whether bounce 2 needs no more directions than the grid's, told by a finer pilot."""
    error = by_grid_alone(second_change(whole)) * USUAL_TIMES**SECOND_GROWTH
    return bool(error <= FEW_AIM * tolerance)


def by_grid_alone(second: float) -> float:
    """Return the error of a second bounce that three times the directions change by so much."""
    return float(second / (1.0 - 3.0**-SECOND_RATE))


def second_change(field: BounceField) -> float:
    """Return by how much more directions than the grid's changed bounce 2, relative to it."""
    return 0.0 if field.error_estimate is None else float(field.error_estimate[1])


def _on_nodes_of(grid: Grid, field: BounceField) -> Array:
    """Return the orders between the nodes of their grid, by cubics, (K, n_y, n_x) of a grid."""
    _, n_y, n_x = field.fluence.shape
    return np.asarray(_cubic(n_y, grid.n_y) @ field.fluence @ _cubic(n_x, grid.n_x).T)


def _cubic(n: int, n_wanted: int) -> Array:
    """Return what takes n values at equal steps to others from end to end, (n_wanted, n)."""
    weights, rows = np.zeros((n_wanted, n)), np.arange(n_wanted)
    place = np.linspace(0.0, n - 1.0, n_wanted)
    first = np.clip(np.floor(place).astype(int) - 1, 0, n - 4)
    for k, weight in enumerate(cubic_weights.py_func(place - first)):
        weights[rows, first + k] = weight
    return weights
