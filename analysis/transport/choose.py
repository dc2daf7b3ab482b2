"""Tolerance in, cheapest grid out: a first guess from the scene's scales, mended by measurement.

The error of an order is the relative rms of its fluence over the nodes above one percent of its
maximum. It is measured, and never assumed; `refine` tells how.
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
ANGLE_RATE = 2.3  # power of the number of directions that errors of direction fall with

RATE_S = 1e-8  # processor time of one radiance; `labrig.solving` measures it
COMPANIONS = 1.35  # radiances computed in all, over those of the finest grid
WORKING_FIELDS = 3  # light fields that a solution takes beside those returned

# The guess, fitted to what 28 scenes needed for an error of 1e-3 (docs/accuracy.md).
CELL_MEAN_FREE_PATHS = 0.16
CELL_BEAM_WIDTHS = 0.16
THINNEST = 0.15  # of what is usual: thinner beams and layers are left to the measured error
ANGLES = 34.0
ANGLE_POWER = 0.25  # of the tolerance, that the number of directions grows with
DETOUR = (0.9, 1.45)  # times the cells that are taken to have the beam's edges on nodes
ON_NODE = 0.02  # cells of the coarsest companion by which an edge may miss a node


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """Cells and directions of a solution, nested so that coarser ones can measure its error.

    Attributes
    ----------
    cells_x, cells_y : multiples of four
    n_theta : directions, a multiple of sixteen
    edges : where the beam's edges cut the width, as shares of it; nodes fall there if they can,
        as the light of low orders has kinks along them. Empty if the beam is aslant
    """

    cells_x: int
    cells_y: int
    n_theta: int
    edges: tuple[float, ...] = ()

    def __str__(self) -> str:
        return f"{self.cells_y} x {self.cells_x} cells and {self.n_theta} directions"

    def grid(self, tank: Tank, every: int = 1) -> Grid:
        """Return the finest grid, or that of every second or fourth node."""
        n_x, n_y = self.cells_x // every + 1, self.cells_y // every + 1
        return Grid(tank=tank, n_x=n_x, n_y=n_y, n_theta=self.n_theta)

    def refined(self, cells: float, angles: float) -> Resolution:
        """Return this resolution with so many times the cells, each way, and the directions."""
        return Resolution(
            cells_x=_cells(self.cells_x * cells),
            cells_y=_cells_between(self.cells_y * cells, self.edges),
            n_theta=_sixteens(self.n_theta * angles),
            edges=self.edges,
        )

    def radiances(self, n_bounces: int) -> float:
        """Return how many radiances are computed, the coarser companions included."""
        nodes = (self.cells_x + 1.0) * (self.cells_y + 1.0)
        return nodes * COMPANIONS * self.n_theta * max(n_bounces - 1, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What a solution is asked for.

    Attributes
    ----------
    memory_bytes, limit_s : what is at hand; what is predicted to take more is refused
    rate_s : processor time of one radiance
    """

    orders: int
    tolerance: float
    light_field: bool
    memory_bytes: float
    limit_s: float = math.inf
    rate_s: float = RATE_S


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
    edges: tuple[float, ...] = ()
    if beam.angle_deg == 0.0:
        inside = (y for y in (beam.from_mm, beam.to_mm) if 0.0 < y < tank.width_mm)
        edges = tuple(y / tank.width_mm for y in inside)
    return Resolution(
        cells_x=_cells(tank.depth_mm / cell_mm),
        cells_y=_cells_between(tank.width_mm / cell_mm, edges),
        n_theta=max(least, _sixteens(ANGLES / forward**0.5 * finer**ANGLE_POWER)),
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
    bright = truth > BRIGHT * truth.max()
    if not bright.any():
        return 0.0
    scale = truth.max()  # no square of an order leaves the range of numbers
    miss, light = (found - truth)[bright] / scale, truth[bright] / scale
    return float(np.sqrt(np.sum(miss**2) / np.sum(light**2)))


def relative_errors(found: Array, truth: Array) -> Array:
    """Return the relative error of each order, (K,)."""
    return np.array([relative_error(one, other) for one, other in zip(found, truth, strict=True)])


def extrapolated_error(before: Array, change: Array) -> Array:
    """Return the error of the finest of three nested solutions, by order.

    From the differences between the first and second, and between the second and third: their
    ratio is the power that the error falls with.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.nan_to_num(np.log2(before / change), nan=RATES[1])
    return np.asarray(MARGIN * change / (2.0 ** np.clip(rate, *RATES) - 1.0))


def _cells(n: float) -> int:
    return max(12, 4 * math.ceil(n / 4.0 - 1e-9))


def _cells_between(n: float, edges: tuple[float, ...]) -> int:
    """Return n cells or more, or somewhat fewer if that takes the edges to nodes."""
    least = _cells(n)
    for cells in range(_cells(DETOUR[0] * n), int(DETOUR[1] * least) + 5, 4):
        miss = [abs(cells / 4 * edge - round(cells / 4 * edge)) for edge in edges]
        if max(miss, default=0.0) <= ON_NODE:
            return cells
    return least


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


def refuse_too_long(predicted_s: float, limit_s: float, what: str) -> None:
    """Raise an error with the figures if more time is predicted than is allowed."""
    if predicted_s > limit_s:
        msg = (
            f"{what}: some {predicted_s:.3g} CPU s are predicted and {limit_s:g} s allowed; ask "
            "for a looser tolerance or fewer orders, or allow more by --limit-s."
        )
        raise AnalysisError(msg)
