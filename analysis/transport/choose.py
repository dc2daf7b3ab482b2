"""Tolerance in, cheapest grid out: a first guess from the scene's scales, mended by measurement.

The error of an order is the relative rms of its fluence over the nodes above one percent of its
maximum. `pilots` measures it between nested grids; it is never assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import UNRESOLVED, Array

BRIGHT = 1e-2  # nodes darker than this share of an order's maximum do not count
RATES = (1.0, 2.3)  # powers of the cell that errors fall with; others are not believed
USUAL_RATE = 2.0
MARGIN = 1.1  # stated error over the one extrapolated
SECOND_RATE = 1.6  # power of the number of directions that the second order's error falls with

MIN_CELLS = 16  # a side
ANGLES = 32.0  # for an error of 1e-3
LEAST_MEETING, MOST_MEETING = 0.95, 1.2  # times the cells wished for that may meet edges better
WORKING_FIELDS = 3  # light fields that a solution takes beside those returned

# The guess, fitted to what 14 scenes needed for errors of 1e-2 and 1e-3 (decision 8).
CELL_MEAN_FREE_PATHS = 0.14
CELL_BEAM_WIDTHS = 0.13
CELL_TANKS = 0.055  # of the tank's side
THINNEST = 0.15  # of what is usual: thinner beams and layers are left to the measured error
MOST_PEAKED = 0.1  # likewise of scattering forward
LEAST_ACROSS = 0.2  # share of that, as a power, which depth feels where the beam runs along it


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """Cells and directions of a solution.

    Attributes
    ----------
    n_theta : directions, a multiple of sixteen
    least_theta : the fewest that resolve the phase function
    edges : of the beam, shares of the tank's width; light has kinks there, and a grid whose nodes
        meet them is up to three times as exact
    """

    cells_x: int
    cells_y: int
    n_theta: int
    least_theta: int
    edges: tuple[float, float]

    def __str__(self) -> str:
        return f"{self.cells_y} x {self.cells_x} cells and {self.n_theta} directions"

    def grid(self, tank: Tank, every: int = 1) -> Grid:
        """Return the grid of every node, or of every second or fourth."""
        return Grid(
            tank=tank,
            n_x=self.cells_x // every + 1,
            n_y=self.cells_y // every + 1,
            n_theta=self.n_theta,
        )

    def scaled(self, times: float, n_theta: int, *, unit: int = 1) -> Resolution:
        """Return about so many times the cells each way, multiples of a unit, and directions."""
        return replace(
            self,
            cells_x=max(MIN_CELLS, unit * math.ceil(self.cells_x * times / unit - 1e-9)),
            cells_y=_meeting(self.edges, max(MIN_CELLS, self.cells_y * times), unit),
            n_theta=_sixteens(n_theta),
        )

    def radiances(self, n_bounces: int) -> float:
        """Return how many radiances are computed, the pilots included."""
        nodes = (self.cells_x + 1.0) * (self.cells_y + 1.0)
        return nodes * 1.15 * self.n_theta * max(n_bounces - 1, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What a solution is asked for."""

    orders: int
    tolerance: float
    light_field: bool
    memory_bytes: float


def guess(medium: Medium, tank: Tank, beam: Beam, tolerance: float) -> Resolution:
    """Return cells and directions that most scenes of such scales need for a tolerance."""
    width = beam.to_mm - beam.from_mm
    finer = 1e-3 / tolerance
    sigma_t = max(medium.sigma_t_per_mm, 1.0 / max(tank.depth_mm, tank.width_mm))
    by_path = CELL_MEAN_FREE_PATHS / sigma_t
    # Light aslant stays in a thinner layer at the face; light scattered forward keeps the beam's
    # edges, which run along the depth unless it is aslant.
    slant = math.radians(beam.angle_deg)
    layer = max(math.cos(slant) ** 0.75, THINNEST)
    peaked = max((1.0 - medium.g**4) ** 1.3, MOST_PEAKED)
    across = min(max(2.0 * math.sin(abs(slant)), LEAST_ACROSS), 1.0)
    by_width = max(CELL_BEAM_WIDTHS * width, THINNEST * by_path * peaked)
    coarser = finer ** (-1.0 / 2.2)
    of_x = by_path * layer * peaked**across, CELL_TANKS * tank.depth_mm
    of_y = by_path * peaked, by_width, CELL_TANKS * tank.width_mm
    cell_x_mm, cell_y_mm = (
        coarser / math.hypot(*(1.0 / one for one in axis)) for axis in (of_x, of_y)
    )
    least = resolvable(medium.g)
    edges = (beam.from_mm / tank.width_mm, beam.to_mm / tank.width_mm)
    return Resolution(
        cells_x=max(MIN_CELLS, math.ceil(tank.depth_mm / cell_x_mm)),
        cells_y=_meeting(edges, max(MIN_CELLS, tank.width_mm / cell_y_mm), 1),
        n_theta=max(least, _sixteens(ANGLES * finer**0.5)),
        least_theta=least,
        edges=edges,
    )


def resolvable(g: float) -> int:
    """Return the least number of directions, in sixteens, that resolve the phase function."""
    if g == 0.0:
        return 32
    peaked = -math.log(min(abs(g), 1.0 - 1e-15))
    return _sixteens(-2.0 * math.log(UNRESOLVED) / peaked)


def relative_error(found: Array, truth: Array) -> float:
    """Return the rms of ``found - truth`` over that of ``truth``, where that is bright."""
    scale = float(truth.max())  # no square of an order leaves the range of numbers
    bright = truth > BRIGHT * scale
    light = truth[bright] / scale
    if light.size == 0:
        return 0.0
    miss = found[bright] / scale - light
    return math.sqrt(np.vdot(miss, miss) / np.vdot(light, light))


def relative_errors(found: Array, truth: Array) -> Array:
    """Return the relative error of each order, (K,)."""
    return np.array([relative_error(one, other) for one, other in zip(found, truth, strict=True)])


def _meeting(edges: tuple[float, float], cells: float, unit: int) -> int:
    """Return about so many cells, a multiple of a unit, whose nodes meet both edges best.

    And those of grids of every second node, down to the unit. Between 0.95 and 1.2 times what is
    asked for.
    """
    first = math.ceil(LEAST_MEETING * cells / unit - 1e-9)
    most = max(first, math.floor(MOST_MEETING * cells / unit))

    def miss(n: int) -> tuple[float, float]:
        nested = [edge * n / 2**k for k in range(unit.bit_length()) for edge in edges]
        return round(sum(abs(place - round(place)) for place in nested), 1), abs(n - cells)

    return min(range(first * unit, most * unit + 1, unit), key=miss)


def _sixteens(n: float) -> int:
    return max(32, 16 * math.ceil(n / 16.0 - 1e-9))


def field_bytes(resolution: Resolution, orders: int, *, light_field: bool) -> float:
    """Return the memory that a solution takes, results and work, byte."""
    nodes = (resolution.cells_x + 1.0) * (resolution.cells_y + 1.0)
    fields = WORKING_FIELDS + (max(orders - 1, 0) if light_field else 0)
    return 8.0 * nodes * (resolution.n_theta * fields + orders)


def refuse_too_large(needed_bytes: float, memory_bytes: float, what: str) -> None:
    """Raise an error with the figures if more memory is needed than there is."""
    if needed_bytes > memory_bytes:
        msg = (
            f"{what}: {needed_bytes / 1e9:.3g} GB are needed and {memory_bytes / 1e9:.3g} GB at "
            "hand; ask for a looser tolerance, fewer orders, or no light field."
        )
        raise AnalysisError(msg)
