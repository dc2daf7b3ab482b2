"""How many bounces a scene needs, and whether their sum converges at all."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import power_removed
from analysis.transport.choose import guess
from analysis.transport.ordinates import march
from analysis.transport.peaked import line_energies

MAX_ORDERS = 400
SERIES_ORDERS = 2000
SETTLED = 1e-4  # relative change of the ratio of successive orders
COUNTING_RADIANCES = 3e8  # of the grid that orders are counted on
ALMOST_LIMIT = 0.999  # abs(g) from which on light keeps to the beam's line well enough to count


def orders_needed(medium: Medium, tank: Tank, beam: Beam, tolerance: float) -> int:
    """Return how many orders leave less than a tolerance of all light to come.

    The ratio of successive orders tends to sigma_s times the tank's largest eigenvalue; orders
    are counted by it once it has settled, on a coarse grid.

    Raises
    ------
    AnalysisError
        If that ratio is one or more: the series diverges. Or if too many orders are needed, or so
        coarse a grid is too large already.
    """
    if medium.sigma_s_per_mm == 0.0:
        return 1
    if abs(medium.g) > ALMOST_LIMIT:
        return _orders_of_peaked(medium, tank, beam, tolerance)
    first = guess(medium, tank, beam, 0.1)
    grid = first.scaled(0.5, first.least_theta).grid(tank)
    if grid.n_x * grid.n_y * grid.n_theta > COUNTING_RADIANCES:
        msg = (
            f"the tank is so large beside a mean free path that its bounces would be counted on "
            f"{grid.n_y - 1} x {grid.n_x - 1} cells: ask for a number of orders."
        )
        raise AnalysisError(msg)
    remaining = _energy(grid, medium, beam)
    total, previous, ratio = 0.0, math.nan, math.nan
    for k, energy in enumerate(remaining, start=1):
        total += energy
        now = energy / previous if k > 1 else math.nan
        settled = abs(now / ratio - 1.0) < SETTLED
        ratio, previous = now, energy
        if settled and k > 3:
            if ratio >= 1.0:
                least = medium.sigma_s_per_mm / ratio
                f0 = power_removed(medium.g, medium.phase)
                msg = (
                    f"the bounces grow by {ratio:.4g} from order to order and their sum diverges: "
                    f"sigma_s f0 = {medium.sigma_s_per_mm * f0:.4g} / mm feeds more light than the "
                    f"tank loses; below sigma_s = {least:.4g} / mm it converges, and orders "
                    "1 .. K can be had by asking for K."
                )
                raise AnalysisError(msg)
            tail = energy * ratio / (1.0 - ratio)
            more = math.log(max(tail / (tolerance * (total + tail)), 1.0)) / -math.log(ratio)
            needed = k + math.ceil(more)
            if needed > MAX_ORDERS:
                break
            return needed
        if k > 2 and ratio < 1.0 and energy * ratio / (1.0 - ratio) < 0.1 * tolerance * total:
            return k
    msg = (
        f"more than {MAX_ORDERS} bounces are needed for a tolerance of {tolerance}: "
        "ask for a number of orders."
    )
    raise AnalysisError(msg)


def _energy(grid: Grid, medium: Medium, beam: Beam) -> Iterator[float]:
    """Yield the integrated fluence of each order on a grid."""
    depth = grid.tank.depth_mm / math.cos(math.radians(beam.angle_deg))
    y, irradiance = beam.profile_points()
    t = medium.sigma_t_per_mm
    yield float(np.trapezoid(irradiance, y)) * (-math.expm1(-t * depth) / t if t > 0.0 else depth)
    cell = grid.cell_x_mm * grid.cell_y_mm
    for k, radiance in enumerate(march(medium, beam, grid, n_bounces=SERIES_ORDERS), start=2):
        power = (k - 1) * math.log(medium.sigma_s_per_mm) + radiance.log_scale
        yield float(radiance.fluence.sum()) * cell * math.exp(min(power, 600.0))


def _orders_of_peaked(medium: Medium, tank: Tank, beam: Beam, tolerance: float) -> int:
    """Return how many orders matter on the beam's own line, g being near one in absolute value."""
    remaining = [0.0]
    for k, energy in enumerate(line_energies(medium, tank, beam), start=1):
        remaining.append(energy)
        ratio = energy / remaining[-2] if k > 1 and energy else 0.0
        tail = energy * ratio / (1.0 - ratio) if ratio < 1.0 else math.inf
        if k > 1 and tail < 1e-2 * tolerance * sum(remaining):
            break
        if k == SERIES_ORDERS or not math.isfinite(energy):
            break
    if math.isfinite(tail):
        left = np.cumsum([tail, *remaining[:0:-1]])[::-1]  # beyond orders 0, 1, ..
        needed = int(np.argmax(left <= tolerance * left[0]))
        if 0 < needed <= MAX_ORDERS:
            return needed
    msg = (
        f"more than {MAX_ORDERS} bounces are needed for a tolerance of {tolerance}: "
        "ask for a number of orders."
    )
    raise AnalysisError(msg)
