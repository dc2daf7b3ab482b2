"""Pilots: coarse solutions that foretell the cheapest grid for a tolerance, and measure its error.

Errors come from cells and from directions. Two nested grids tell the former, which falls with the
second power of the cells. Of the latter the second bounce tells on every grid: it is known in
closed form, and a third of its directions by themselves show what these leave. Later bounces feel a
share of that, which the coarser grid tells with twice the directions; less than usual is not
believed of so coarse a grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.light_field import BounceField, Grid
from analysis.medium import Tank
from analysis.phase_function import Array
from analysis.transport.choose import Resolution, relative_errors
from analysis.transport.sweep import cubic_weights

CELL_RATES = 2.2, -0.4  # power of the cells that errors fall with: at g = 0, and per abs(g)
USUAL_TIMES = 2.7
LEAST_TIMES, MOST_TIMES = 1.4, 6.0  # cells of an answer over those of its pilot, each way
MORE_ANGLES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0)  # directions, likewise
# Of the tolerance, that grids are chosen for: for errors from cells of a fluence, for those where
# a light field is wanted (single directions are less exact than their sum), and from directions.
FLUENCE_AIM, LIGHT_AIM, ANGLES_AIM = 0.8, 0.7, 0.9
# Powers of errors of later bounces from directions: they fall with these, by themselves and
# relative to the second bounce, and grow with cells.
ANGLE_RATE, SHARE_RATE, ANGLE_GROWTH = 2.3, 0.7, 0.4
ON_FINER = 0.85  # share that fine grids show of what directions leave, over that of a pilot
# Likewise of bounce 3 by 32 directions, and the power of the scatterings that it falls with.
USUAL_SHARE, FORGETTING = 0.28, 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Pilot:
    """What two nested coarse grids tell.

    Attributes
    ----------
    base, grid, fluence : the finer of them, and its orders (K, n_y, n_x)
    aim : of the tolerance, for errors from cells
    rate : power of the cells that errors fall with
    cells, angles : errors of its bounces from the third on that come from cells and directions
    share : (K,), of what directions leave of bounce 2, that they leave of bounces from the third on
    """

    base: Resolution
    grid: Grid
    fluence: Array
    aim: float
    rate: float
    cells: float
    angles: float
    share: Array

    @classmethod
    def of(
        cls,
        base: Resolution,
        tank: Tank,
        half: BounceField,
        turned: BounceField,
        whole: BounceField,
        *,
        light_field: bool,
    ) -> Pilot:
        """Return what a grid tells, and every second node of it, also with twice the directions."""
        grid = base.grid(tank)
        left = ON_FINER * relative_errors(half.fluence, turned.fluence) / (1.0 - 2.0**-ANGLE_RATE)
        share, scatterings = np.zeros(left.size), np.arange(2, left.size)
        share[2:] = USUAL_SHARE * (2.0 / scatterings) ** FORGETTING
        share *= (32.0 / grid.n_theta) ** SHARE_RATE
        if (second := second_change(half)) > 0.0:
            share[2:] = np.maximum(share[2:], left[2:] / second)
        change = relative_errors(half.fluence, whole.fluence[:, ::2, ::2])
        rate = CELL_RATES[0] + CELL_RATES[1] * abs(whole.medium.g)
        return cls(
            base=base,
            grid=grid,
            fluence=whole.fluence,
            aim=LIGHT_AIM if light_field else FLUENCE_AIM,
            rate=rate,
            cells=float(change[2:].max(initial=0.0)) / (2.0**rate - 1.0),
            angles=float(share.max()) * second_change(whole),
            share=share,
        )

    def needed(self, tolerance: float) -> float:
        """Return times the cells that are foretold to be needed."""
        return float((self.cells / (self.aim * tolerance)) ** (1.0 / self.rate))

    def cheapest(self, tolerance: float) -> Resolution | None:
        """Return the cheapest grid foretold to meet a tolerance; None if it is far off."""
        times = max(self.needed(tolerance), LEAST_TIMES)
        grown = self.angles * times**ANGLE_GROWTH
        for more in MORE_ANGLES if times <= MOST_TIMES else ():
            if grown * more**-ANGLE_RATE <= ANGLES_AIM * tolerance:
                return self.base.scaled(times, math.ceil(more * self.base.n_theta))
        return None

    def foretold(self, tolerance: float) -> Resolution:
        """Return the grid that would meet a tolerance, however fine."""
        times = max(self.needed(tolerance), LEAST_TIMES)
        grown = self.angles * times**ANGLE_GROWTH / (ANGLES_AIM * tolerance)
        more = max(grown ** (1.0 / ANGLE_RATE), 1.0)
        return self.base.scaled(times, math.ceil(more * self.base.n_theta))

    def finer(self, tolerance: float) -> Resolution:
        """Return the grid of a pilot that can foretell what this one is too coarse for."""
        more = (self.angles / tolerance) ** (1.0 / ANGLE_RATE) / MORE_ANGLES[-1]
        return self.base.scaled(
            min(max(self.needed(tolerance) / USUAL_TIMES, 1.0), MOST_TIMES),
            math.ceil(self.base.n_theta * max(2.0 * more, 1.0)),
            unit=2,
        )

    def measured(self, answer: BounceField, grid: Grid) -> tuple[Array, Array]:
        """Return errors of an answer from cells, (K,), and from directions, (K,)."""
        change = relative_errors(self.fluence, _on_nodes_of(self.grid, answer))
        turned = second_change(answer) * (self.grid.n_theta / grid.n_theta) ** SHARE_RATE
        return change / (self._times(grid) ** self.rate - 1.0), self.share * turned

    def taught(self, grid: Grid, cells: float, angles: float) -> Pilot:
        """Return this pilot with the errors that an answer had."""
        times, more = self._times(grid), grid.n_theta / self.grid.n_theta
        return replace(
            self,
            cells=cells * times**self.rate,
            angles=angles * more**ANGLE_RATE / times**ANGLE_GROWTH,
        )

    def _times(self, grid: Grid) -> float:
        pairs = ((grid.n_x, self.grid.n_x), (grid.n_y, self.grid.n_y))
        return math.sqrt(math.prod((many - 1) / (few - 1) for many, few in pairs))


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
