"""Ordinates to a tolerance: pilots, then the grid that they call for, whose error is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.transport.blas import on_one_thread
from analysis.transport.choose import (
    SECOND_RATE,
    Resolution,
    Wanted,
    field_bytes,
    refuse_too_large,
    relative_error,
)
from analysis.transport.ordinates import DType, second_fluence, solve_on
from analysis.transport.pilots import (
    ANGLES_MARGIN,
    TURNED_TIMES,
    USUAL_TIMES,
    Pilot,
    by_grid_alone,
    few_suffice,
)

MAX_ATTEMPTS = 10
TOLD_ORDERS = 4  # of a pilot's coarser and turned grids; later ones are taken for as bad
MAX_SECOND = 16384
DOUBT = 2.0  # times the memory that a far grid foretold may take before it is refused
SECOND_TIMES = 3  # directions for L_2
NEGLIGIBLE = 0.1  # of the tolerance: moments of the phase function below scatter nothing
SINGLE_TOLERANCE = 1e-5  # single precision costs 1e-6 of the brightest
SINGLE_DEPTHS = (0.01, 60.0)  # optical; it has no numbers for orders and depths below exp(-87)


def solve_ordinates(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    resolution: Resolution,
    wanted: Wanted,
) -> BounceField:
    """Solve on the grid that pilots call for, and on finer ones until the error is small enough.

    Parameters
    ----------
    resolution : the one guessed, whose pilots are tried first

    Raises
    ------
    AnalysisError
        If a grid exceeds the memory, or the tolerance is not met by the last that was tried.
    """
    tolerance, worst = wanted.tolerance, math.nan
    dtype = _precision(medium, tank, tolerance)
    run = _Run(medium, tank, beam, wanted, dtype)
    with on_one_thread():
        base = resolution.scaled(1.0 / USUAL_TIMES, resolution.least_theta, unit=2)
        pilot = run.pilot(base, guessed=resolution)
        for _ in range(MAX_ATTEMPTS):
            answer = pilot.cheapest(tolerance)
            if answer is None:
                _refuse(pilot.foretold(tolerance), medium, wanted, times=DOUBT)
                pilot = run.pilot(pilot.finer(tolerance))
                continue
            _refuse(answer, medium, wanted)
            grid = answer.grid(tank)
            summed = 1 if pilot.turned is None else SECOND_TIMES
            field = run.solve(
                grid, wanted.orders, light_field=wanted.light_field, second_times=summed
            )
            found = pilot.measured(field, grid)
            error = found.stated
            if (worst := float(error.max())) <= tolerance:
                left = by_grid_alone(found.second) * summed**-SECOND_RATE
                error[1] = _mend_second(field, grid, summed * grid.n_theta, left, tolerance)
                return replace(field, error_estimate=error)
            pilot = pilot.taught(grid, found)
    msg = (
        f"a tolerance of {tolerance} was not met, the error is still {worst:.2g}; "
        "ask for a looser one."
    )
    raise AnalysisError(msg)


@dataclass(frozen=True, slots=True)
class _Run:
    """A problem, and how it is solved on any grid."""

    medium: Medium
    tank: Tank
    beam: Beam
    wanted: Wanted
    dtype: DType

    def solve(
        self,
        grid: Grid,
        orders: int,
        *,
        light_field: bool = False,
        second_times: int = SECOND_TIMES,
    ) -> BounceField:
        return solve_on(
            self.medium,
            self.beam,
            grid,
            n_bounces=orders,
            light_field=light_field,
            dtype=self.dtype,
            second_times=second_times,
            negligible=NEGLIGIBLE * self.wanted.tolerance,
        )

    def pilot(self, base: Resolution, *, guessed: Resolution | None = None) -> Pilot:
        """Solve on a coarse grid, and on those that tell its errors.

        Where few directions suffice an answer costs hardly more than those: the guess is tried.
        """
        tolerance, orders = self.wanted.tolerance, self.wanted.orders
        told, turned = min(orders, TOLD_ORDERS), None
        whole = self.solve(base.grid(self.tank), orders)
        few = few_suffice(whole, tolerance)
        if few and guessed is not None:
            return Pilot.of_guess(base, self.tank, whole, guessed, tolerance)
        half = self.solve(base.grid(self.tank, 2), told, second_times=1)
        if not few:
            n_theta = round(TURNED_TIMES * base.n_theta)
            turned = self.solve(replace(base, n_theta=n_theta).grid(self.tank), told)
        return Pilot.of(base, self.tank, whole, half, turned)


def _refuse(resolution: Resolution, medium: Medium, wanted: Wanted, *, times: float = 1.0) -> None:
    """Raise an error if a grid takes more than so many times the memory at hand."""
    needed = field_bytes(resolution, wanted.orders, light_field=wanted.light_field)
    what = f"{resolution} for g = {medium.g}, {wanted.orders} orders"
    if needed > times * wanted.memory_bytes:
        refuse_too_large(needed, wanted.memory_bytes, what)


def _precision(medium: Medium, tank: Tank, tolerance: float) -> DType:
    """Return single precision where neither tolerance nor range of values needs double."""
    optical = medium.sigma_t_per_mm * math.hypot(tank.depth_mm, tank.width_mm)
    tame = SINGLE_DEPTHS[0] < optical < SINGLE_DEPTHS[1] and medium.gain == "refused"
    return np.float32 if tame and tolerance >= SINGLE_TOLERANCE else np.float64


def _mend_second(field: BounceField, grid: Grid, n: int, left: float, tolerance: float) -> float:
    """Sum the second order over more directions while that is needed; return its error.

    So far it is summed over n, which leave an error of ``left``. Each round has three times the
    directions, a third of which are there: those between the axes stay so, which keeps the jumps
    at the walls between two of them.
    """
    while ANGLES_MARGIN * left > tolerance:
        if n > MAX_SECOND:
            msg = (
                f"the second bounce is not found to {tolerance} with {n} directions, the "
                f"error is still {left:.2g}; ask for a looser tolerance."
            )
            raise AnalysisError(msg)
        theta_rad = equal_angles(3 * n)[np.arange(3 * n) % 3 != 1]
        added = second_fluence(field.medium, field.beam, grid, theta_rad)
        fluence = (field.fluence[1] + 2.0 * field.medium.sigma_s_per_mm * added) / 3.0
        left = relative_error(field.fluence[1], fluence) / (3.0**SECOND_RATE - 1.0)
        field.fluence[1] = fluence
        n *= 3
    return ANGLES_MARGIN * left
