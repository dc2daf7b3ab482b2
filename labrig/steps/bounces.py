"""The step that explains multiple scattering by bounces, the paper's way (Eqs. 10, 11)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.bounces import BounceTable, tabulate
from analysis.inversion import Inversion, invert
from analysis.light_field import BounceField, Grid
from analysis.medium import Medium
from analysis.phase_function import UNRESOLVED
from analysis.profile import WHOLE
from analysis.transport.ordinates import solve_on
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.steps.decay import Decay
from labrig.steps.rectify import Pictures
from labrig.steps.separation import Separated

Array = NDArray[np.float64]

POOR_FIT = 0.1  # rms of the residual of Eq. 10 over rms of the picture
MAX_RADIANCES = 60_000_000  # nodes x angles: half a gigabyte an array


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """The bounces of the medium found.

    ``inversion`` is the medium that the paper's way finds (Eqs. 9, 10), ``bounces`` are of the
    one taken for the truth. ``layer_fluence`` is (K, n_y, n_x), the mean over the height of a
    layer's light, which its camera sees only a part of; None in a plane.
    """

    inversion: Inversion
    multiple: Array
    grid: Grid
    bounces: BounceField
    notes: tuple[str, ...]
    layer_fluence: Array | None = None


def render_bounces(decay: Decay, pictures: Pictures, config: Analysis) -> BounceTable:
    """Render every bounce for a range of g: L_1 analytic, L_2 closed, then recursively (Eq. 4).

    Raises
    ------
    AnalysisRefusedError
        If the grid would not fit in memory.
    AnalysisError
        If the angles cannot resolve the range of g.
    """
    cell = config.cell_mm if pictures.unit == "mm" else decay.tank.depth_mm / 100.0
    grid = Grid.covering(decay.tank, cell_mm=cell, n_theta=config.n_theta)
    if grid.n_x * grid.n_y * grid.n_theta > MAX_RADIANCES:
        msg = (
            f"a grid of {grid.n_y} x {grid.n_x} nodes and {grid.n_theta} angles holds more than "
            f"{MAX_RADIANCES / 1e6:.0f} million radiances; choose a larger cell_mm."
        )
        raise AnalysisRefusedError(msg)
    return tabulate(
        decay.attenuation.sigma_t_per_mm,
        decay.beam,
        grid,
        phase=config.phase,
        n_bounces=config.n_bounces,
        g_range=config.g_range,
        n_g=config.n_g,
    )


def explain(
    separated: Separated,
    decay: Decay,
    table: BounceTable,
    pictures: Pictures,
    known: Medium | None = None,
) -> Explained:
    """Find sigma_s and g whose bounces explain the multiple scattering (Eqs. 10, 11).

    The bounces returned are those of the medium ``known`` better, if there is one.

    Raises
    ------
    AnalysisError
        If there is no multiple scattering to explain.
    """
    grid = table.grid
    multiple, count = grid.average(separated.best.multiple, pictures.pixel)
    variance, _ = grid.average(separated.best.multiple_variance, pictures.pixel)
    valid, _ = grid.average(np.isfinite(separated.best.multiple).astype(float), pictures.pixel)
    multiple = np.where(valid >= WHOLE, multiple, np.nan)
    found = invert(multiple, variance / np.maximum(count, 1.0), decay.attenuation, table)
    medium = Medium(
        sigma_t_per_mm=decay.attenuation.sigma_t_per_mm,
        sigma_s_per_mm=found.sigma_s_per_mm,
        g=found.g,
        phase=table.phase,
    )
    n_bounces = table.fluence.shape[1]
    notes = []
    if found.at_limit:
        notes.append(
            "The fit of sigma_s and g stopped at the end of its range: they are not determined."
        )
    if found.rms_relative > POOR_FIT:
        notes.append(
            f"The bounces leave {100 * found.rms_relative:.0f} % (rms) of the multiple scattering "
            "unexplained: the model of Eq. 10 does not fit, and its sigma_s and g mean little."
        )
    if found.last_bounce_share > 0.01:
        notes.append(
            f"Bounce {n_bounces} still holds {100 * found.last_bounce_share:.1f} % of the "
            "multiple scattering: raise n_bounces."
        )
    return Explained(
        inversion=found,
        multiple=multiple,
        grid=grid,
        bounces=solve_on(
            known or medium,
            decay.beam,
            _resolving(grid, known),
            n_bounces=n_bounces,
            dtype=np.float32,  # as they are written
        ),
        notes=tuple(notes) if known is None else (),
    )


def _resolving(grid: Grid, medium: Medium | None) -> Grid:
    """Return the grid with directions enough for a medium."""
    n_theta = grid.n_theta
    while medium is not None and abs(medium.g) ** (n_theta // 2) > UNRESOLVED:
        n_theta += 32
    return replace(grid, n_theta=n_theta)
