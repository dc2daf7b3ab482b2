"""Ordinates to a tolerance: finer grids until the measured error is small enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import (
    MARGIN,
    SECOND_RATE,
    Resolution,
    Wanted,
    expected,
    extrapolate,
    field_bytes,
    refuse_too_large,
    relative_error,
    relative_errors,
)
from analysis.transport.ordinates import DType, second_fluence, solve_on

MAX_ATTEMPTS = 8
MAX_SECOND = 16384
ANGLE_SHARE = 0.2  # of the coarser difference, which is some four times the finer one
FORESIGHT = 3.0  # times the tolerance that coarse grids may foresee before a fine one is tried
SINGLE_TOLERANCE = 1e-5  # single precision costs 1e-6 of the brightest
SINGLE_DEPTHS = (0.01, 60.0)  # optical; it has no numbers for orders and depths below exp(-87)


def solve_ordinates(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    resolution: Resolution,
    wanted: Wanted,
) -> BounceField:
    """Solve on this resolution, and on finer ones until the error meets the tolerance.

    Raises
    ------
    AnalysisError
        If a grid exceeds the memory, or the tolerance is not met by the last that was tried.
    """
    orders, tolerance, light_field = wanted.orders, wanted.tolerance, wanted.light_field
    worst, dtype, angles = math.nan, _precision(medium, tank, tolerance), False
    for _ in range(MAX_ATTEMPTS):
        needed = field_bytes(resolution, orders, light_field=light_field)
        refuse_too_large(
            needed, wanted.memory_bytes, f"{resolution} for g = {medium.g}, {orders} orders"
        )
        coarse, middle = (
            solve_on(
                medium,
                beam,
                resolution.coarser(tank, times, medium.g),
                n_bounces=orders,
                light_field=False,
                dtype=dtype,
            ).fluence
            for times in (4, 2)
        )
        before = relative_errors(coarse, middle)
        foreseen = expected(before[2:]) / tolerance
        if foreseen > FORESIGHT:
            angles = not angles and _angles_limit(
                medium, tank, beam, resolution, orders, dtype, middle, before
            )
            resolution = resolution.refined(min(foreseen, 64.0) ** 0.5, mostly_angles=angles)
            continue
        grid = resolution.grid(tank)
        field = solve_on(medium, beam, grid, n_bounces=orders, light_field=light_field, dtype=dtype)
        change = relative_errors(middle, field.fluence)
        error = extrapolate(before, change)
        error[0] = 0.0
        halved = resolution.coarser(tank, 2, medium.g).n_theta < grid.n_theta
        error[1] = _mend_second(field, grid, float(change[1]) if halved else None, tolerance)
        worst = float(error[2:].max(initial=0.0))
        if worst <= tolerance:
            return replace(field, error_estimate=error)
        # Directions alone never twice running: the cells may limit as much.
        angles = not angles and _angles_limit(
            medium, tank, beam, resolution, orders, dtype, middle, before
        )
        resolution = resolution.refined(1.1 * (worst / tolerance) ** 0.5, mostly_angles=angles)
    msg = (
        f"a tolerance of {tolerance} was not met, the error is still {worst:.2g}; "
        "ask for a looser one."
    )
    raise AnalysisError(msg)


def _angles_limit(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    resolution: Resolution,
    orders: int,
    dtype: DType,
    middle: Array,
    before: Array,
) -> bool:
    """Return whether most of the difference between nested grids comes from their directions."""
    grid = replace(resolution.coarser(tank, 2, medium.g), n_theta=resolution.n_theta)
    turned = solve_on(medium, beam, grid, n_bounces=orders, light_field=False, dtype=dtype).fluence
    by_angles = max(relative_error(a, b) for a, b in zip(middle[2:], turned[2:], strict=True))
    return by_angles > ANGLE_SHARE * float(before[2:].max())


def _precision(medium: Medium, tank: Tank, tolerance: float) -> DType:
    """Return single precision where neither tolerance nor range of values needs double."""
    optical = medium.sigma_t_per_mm * math.hypot(tank.depth_mm, tank.width_mm)
    tame = SINGLE_DEPTHS[0] < optical < SINGLE_DEPTHS[1] and medium.gain == "refused"
    return np.float32 if tame and tolerance >= SINGLE_TOLERANCE else np.float64


def _mend_second(field: BounceField, grid: Grid, change: float | None, tolerance: float) -> float:
    """Sum the second order over more directions where that is needed; return its error.

    ``change`` is what half as many directions made of it; None if nothing tells. Each round has
    three times the directions, a third of which are there: those between the axes stay so, which
    keeps the jumps at the walls between two of them.
    """
    error = math.inf if change is None else MARGIN * change / (2.0**SECOND_RATE - 1.0)
    n = grid.n_theta
    while error > tolerance:
        if n > MAX_SECOND:
            msg = (
                f"the second bounce is not found to {tolerance} with {n} directions, the "
                f"error is still {error:.2g}; ask for a looser tolerance."
            )
            raise AnalysisError(msg)
        theta_rad = equal_angles(3 * n)[np.arange(3 * n) % 3 != 1]
        added = second_fluence(field.medium, field.beam, grid, theta_rad)
        fluence = (field.fluence[1] + 2.0 * field.medium.sigma_s_per_mm * added) / 3.0
        error = MARGIN * relative_error(field.fluence[1], fluence) / (3.0**SECOND_RATE - 1.0)
        field.fluence[1] = fluence
        n *= 3
    return float(error)
