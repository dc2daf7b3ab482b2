"""Ordinates to a tolerance: a coarse pilot tells the grid that is needed, companions its error.

Every solution has companions on every second and every fourth node. Two of them extrapolate each
order to ever finer cells, two more measure what that is worth, and a last one, with half as many
directions, what those are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.choose import (
    ANGLE_RATE,
    MARGIN,
    USUAL_RATE,
    Resolution,
    Wanted,
    extrapolated_error,
    field_bytes,
    guess,
    refuse_too_large,
    refuse_too_long,
    relative_error,
    relative_errors,
    resolvable,
)
from analysis.transport.ordinates import DType, second_fluence, solve_on
from analysis.transport.second import second_to

MAX_ATTEMPTS = 8
PILOT = 8.0  # times the tolerance, whose grid is tried first and tells more than a guess
COARSEST = 1e-2  # tolerance from which on a pilot is no cheaper
AIMS = (0.75, 0.4)  # of the tolerance that cells and directions of the next grid are made for
LEAST = 1.1  # times that the part with the larger error grows
MOST = 8.0
CELL_RATE = 2.8
WORTH = 2.5  # times smaller than what it is measured by is the error of extrapolated orders
SURE = 0.6  # of the tolerance that an error found on some nodes may take
SECOND_RATE = 1.6  # power of the number of directions that the second order's error falls with
LEAST_PROBES = 120  # nodes that tell the second order's error
MOST_CORRECTED = 0.5  # of an order; more is not believed
SINGLE_TOLERANCE = 1e-5  # single precision costs 1e-6 of the brightest
SINGLE_DEPTHS = (0.01, 60.0)  # optical; it has no numbers for orders and depths below exp(-87)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Attempt:
    """Orders on one resolution: what they are worth, by order, from cells and from directions."""

    field: BounceField
    by_cells: Array
    by_angles: Array


def solve_ordinates(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    resolution: Resolution,
    wanted: Wanted,
) -> BounceField:
    """Solve on a pilot's resolution, then on what that calls for, until the tolerance is met.

    ``resolution`` is the one guessed, that tells beforehand what is too large.

    Raises
    ------
    AnalysisError
        If a grid exceeds the memory or the time, or the tolerance is not met by the last that
        was tried.
    """
    tolerance = wanted.tolerance
    refuse_too_costly(resolution, medium, wanted)
    if tolerance < COARSEST / 2.0:
        resolution = guess(medium, tank, beam, min(PILOT * tolerance, COARSEST))
    dtype = _precision(medium, tank, tolerance)
    worst = math.nan
    for _ in range(MAX_ATTEMPTS):
        refuse_too_costly(resolution, medium, wanted)
        tried = _attempt(medium, beam, tank, resolution, wanted, dtype)
        error = np.hypot(tried.by_cells, tried.by_angles)
        worst = float(error[2:].max(initial=0.0))
        if worst <= tolerance:
            error[1] = _mend_second(tried.field, resolution.grid(tank), tolerance)
            return replace(tried.field, error_estimate=error)
        resolution = _next(resolution, tried, tolerance)
    msg = (
        f"a tolerance of {tolerance} was not met, the error is still {worst:.2g}; "
        "ask for a looser one."
    )
    raise AnalysisError(msg)


def refuse_too_costly(resolution: Resolution, medium: Medium, wanted: Wanted) -> None:
    """Raise an error with the figures if a resolution exceeds the memory or the time."""
    what = f"{resolution} for g = {medium.g}, {wanted.orders} orders"
    needed = field_bytes(resolution, wanted.orders, light_field=wanted.light_field)
    refuse_too_large(needed, wanted.memory_bytes, what)
    refuse_too_long(wanted.rate_s * resolution.radiances(wanted.orders), wanted.limit_s, what)


def _next(resolution: Resolution, tried: _Attempt, tolerance: float) -> Resolution:
    """Return the resolution that errors call for which fall with the usual rates."""
    cells, angles = float(tried.by_cells[2:].max()), float(tried.by_angles[2:].max())
    more_cells = (cells / (AIMS[0] * tolerance)) ** (1.0 / CELL_RATE)
    more_angles = (angles / (AIMS[1] * tolerance)) ** (1.0 / ANGLE_RATE)
    least = (LEAST, 1.0) if cells > angles else (1.0, LEAST)
    return resolution.refined(
        min(max(more_cells, least[0]), MOST), min(max(more_angles, least[1]), MOST)
    )


def _attempt(
    medium: Medium,
    beam: Beam,
    tank: Tank,
    resolution: Resolution,
    wanted: Wanted,
    dtype: DType,
) -> _Attempt:
    """Solve on a resolution and its companions; the second order is not yet summed well."""

    def on(grid: Grid, *, light_field: bool = False) -> BounceField:
        return solve_on(
            medium, beam, grid, n_bounces=wanted.orders, light_field=light_field, dtype=dtype
        )

    coarse, middle = (on(resolution.grid(tank, times)).fluence for times in (4, 2))
    field = on(resolution.grid(tank), light_field=wanted.light_field)
    by_angles = np.zeros(wanted.orders)
    if wanted.orders > 2:
        n_theta = resolution.n_theta // 2
        fewer = n_theta >= resolvable(medium.g)
        grid = resolution.grid(tank, 4)
        turned = on(replace(grid, n_theta=n_theta if fewer else 4 * n_theta)).fluence
        scale = 2.0**ANGLE_RATE - 1.0 if fewer else 1.0
        by_angles = relative_errors(turned, coarse) / scale
    fine = field.fluence
    change = relative_errors(middle, fine[:, ::2, ::2])
    by_cells = extrapolated_error(relative_errors(coarse, middle[:, ::2, ::2]), change)
    by_cells[:2] = by_angles[:2] = 0.0
    step = 2.0**USUAL_RATE - 1.0
    for k in range(2, wanted.orders):
        correction = _share((fine[k, ::2, ::2] - middle[k]) / step, fine[k, ::2, ::2])
        before = _share((middle[k, ::2, ::2] - coarse[k]) / step, middle[k, ::2, ::2])
        finer = fine[k, ::4, ::4] * (1.0 + correction[::2, ::2])
        error = relative_error(middle[k, ::2, ::2] * (1.0 + before), finer) / WORTH
        if error < by_cells[k]:
            by_cells[k] = error
            _correct(field, k, correction)
    return _Attempt(field=field, by_cells=by_cells, by_angles=by_angles)


def _share(part: Array, whole: Array) -> Array:
    """Return one as a share of the other, none where there is no light."""
    share = np.divide(part, whole, out=np.zeros_like(part), where=whole > 0.0)
    return np.asarray(np.clip(share, -MOST_CORRECTED, MOST_CORRECTED))


def _correct(field: BounceField, k: int, correction: Array) -> None:
    """Scale an order, and its light field alike, by one plus what every second node is told."""
    factor = np.empty(field.fluence[k].shape)
    factor[::2, ::2] = 1.0 + correction
    factor[1::2, ::2] = 0.5 * (factor[:-1:2, ::2] + factor[2::2, ::2])
    factor[:, 1::2] = 0.5 * (factor[:, :-1:2] + factor[:, 2::2])
    field.fluence[k] *= factor
    if field.light_field is not None:
        field.light_field[k - 1] *= factor[:, :, None].astype(field.light_field.dtype)


def _precision(medium: Medium, tank: Tank, tolerance: float) -> DType:
    """Return single precision where neither tolerance nor range of values needs double."""
    optical = medium.sigma_t_per_mm * math.hypot(tank.depth_mm, tank.width_mm)
    tame = SINGLE_DEPTHS[0] < optical < SINGLE_DEPTHS[1] and medium.gain == "refused"
    return np.float32 if tame and tolerance >= SINGLE_TOLERANCE else np.float64


def _mend_second(field: BounceField, grid: Grid, tolerance: float) -> float:
    """Sum the second order over more directions where that is needed; return its error.

    It is measured on some of the nodes against the sum between kinks. Three times as many
    directions, a third of which are there, may be enough: those between the axes stay so, which
    keeps the jumps at the walls between two of them. Else all nodes are summed between kinks.
    """
    medium, beam, n_theta = field.medium, field.beam, grid.n_theta
    every = next((n for n in (5, 3) if grid.n_x * grid.n_y > n**2 * LEAST_PROBES), 1)
    few = (grid.x_mm[::every], grid.y_mm[::every])
    exact, doubt = second_to(medium, beam, grid, *few, 0.1 * tolerance)
    exact *= medium.sigma_s_per_mm

    def error() -> float:
        return MARGIN * relative_error(field.fluence[1, ::every, ::every], exact) + doubt

    enough = SURE * tolerance
    if enough < error() < 3.0**SECOND_RATE * enough:
        theta_rad = equal_angles(3 * n_theta)[np.arange(3 * n_theta) % 3 != 1]
        added = second_fluence(medium, beam, grid, theta_rad)
        field.fluence[1] = (field.fluence[1] + 2.0 * medium.sigma_s_per_mm * added) / 3.0
    if error() <= enough:
        return error()
    summed, doubt = second_to(medium, beam, grid, grid.x_mm, grid.y_mm, 0.5 * tolerance)
    field.fluence[1] = medium.sigma_s_per_mm * summed
    return doubt
