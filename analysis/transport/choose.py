"""Tolerance in, cheapest grid out: a first guess from the scene's scales, mended by measurement.

The error of an order is the relative rms of its fluence over the nodes above one percent of its
maximum. It is measured between three nested grids, of which the coarser two cost a seventh of
the finest, and never assumed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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

WORKING_FIELDS = 3  # light fields that a solution takes beside those returned

# The guess, fitted to what 28 scenes needed for an error of 1e-3 (docs/accuracy.md).
CELL_MEAN_FREE_PATHS = 0.16
CELL_BEAM_WIDTHS = 0.16
THINNEST = 0.15  # of what is usual: thinner beams and layers are left to the measured error
ANGLES = 34.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """Cells and directions of a solution, nested so that coarser ones can measure its error.

    Attributes
    ----------
    cells_x, cells_y : multiples of four
    n_theta : directions, a multiple of sixteen
    """

    cells_x: int
    cells_y: int
    n_theta: int

    def __str__(self) -> str:
        return f"{self.cells_y} x {self.cells_x} cells and {self.n_theta} directions"

    def grid(self, tank: Tank) -> Grid:
        """Return the finest grid."""
        return Grid(tank=tank, n_x=self.cells_x + 1, n_y=self.cells_y + 1, n_theta=self.n_theta)

    def coarser(self, tank: Tank, times: int, g: float) -> Grid:
        """Return the grid of every second or fourth node, and as many fewer directions.

        As long as these resolve the phase function.
        """
        return Grid(
            tank=tank,
            n_x=self.cells_x // times + 1,
            n_y=self.cells_y // times + 1,
            n_theta=min(self.n_theta, max(4 * (self.n_theta // times // 4), resolvable(g))),
        )

    def refined(self, times: float, *, mostly_angles: bool) -> Resolution:
        """Return this resolution refined, in cells or in directions, a little in the others."""
        cells, angles = (math.sqrt(times), times) if mostly_angles else (times, math.sqrt(times))
        return Resolution(
            cells_x=_cells(self.cells_x * cells),
            cells_y=_cells(self.cells_y * cells),
            n_theta=_sixteens(self.n_theta * angles),
        )

    def radiances(self, n_bounces: int) -> float:
        """Return how many radiances are computed, the coarser companions included."""
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
    # Light aslant, and more so if scattered forward, stays in a thinner layer at the face.
    layer = math.cos(math.radians(beam.angle_deg)) ** (0.5 + 0.5 * max(medium.g, 0.0))
    layer = max(layer, THINNEST)
    peaked = max(1.0 - medium.g**2, 1e-4)
    by_path = CELL_MEAN_FREE_PATHS * peaked**0.45 * layer / sigma_t
    by_width = max(CELL_BEAM_WIDTHS * width, THINNEST * by_path)
    cell_mm = finer ** (-1.0 / 2.2) / math.hypot(1.0 / by_path, 1.0 / by_width)
    forward = 1.0 - min(abs(medium.g), 0.9999)
    least = resolvable(medium.g)
    return Resolution(
        cells_x=_cells(tank.depth_mm / cell_mm),
        cells_y=_cells(tank.width_mm / cell_mm),
        n_theta=max(least, _sixteens(ANGLES / forward**0.5 * finer**0.55)),
    )


def resolvable(g: float) -> int:
    """Return the least number of directions, in sixteens, that resolve the phase function."""
    if g == 0.0:
        return 32
    peaked = -math.log(min(abs(g), 1.0 - 1e-15))
    return _sixteens(-2.0 * math.log(UNRESOLVED) / peaked)


def relative_error(found: Array, truth: Array) -> float:
    """Return the rms of ``found - truth`` over that of ``truth``, where that is bright."""
    bright = truth > BRIGHT * truth.max()
    if not bright.any():
        return 0.0
    scale = truth.max()  # no square of an order leaves the range of numbers
    miss, light = (found - truth)[bright] / scale, truth[bright] / scale
    return float(np.sqrt(np.sum(miss**2) / np.sum(light**2)))


def relative_errors(found: Array, truth: Array) -> Array:
    """Return the relative error of each order, ``truth`` having twice as fine a grid, (K,)."""
    pairs = zip(found, truth[:, ::2, ::2], strict=True)
    return np.array([relative_error(one, other) for one, other in pairs])


def expected(change: Array) -> float:
    """Return the worst error to expect of a grid twice as fine as the finer of two.

    ``change`` is the difference between these two, by order.
    """
    worst = float(change.max(initial=0.0))
    step = float(2.0**USUAL_RATE)
    return worst / (step - 1.0) / step


def extrapolate(before: Array, change: Array) -> Array:
    """Return the error of the finest of three nested solutions, by order.

    From the differences between the first and second, and between the second and third: their
    ratio is the power that the error falls with.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.nan_to_num(np.log2(before / change), nan=RATES[1])
    return np.asarray(MARGIN * change / (2.0 ** np.clip(rate, *RATES) - 1.0))


def _cells(n: float) -> int:
    return max(12, 4 * math.ceil(n / 4.0 - 1e-9))


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
