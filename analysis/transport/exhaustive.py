"""The paper's literal recursion: every cell gathers from every other cell (Eqs. 1, 4).

The historical baseline, hours where a sweep takes a blink, and the naive twin of the ordinates:
nothing is marched or interpolated in space, so an error of theirs cannot be repeated here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium
from analysis.phase_function import Array, convolution_matrix, phase_function
from analysis.transport.beam import ballistic_fluence

PAIR_NS = 50.0  # cost of one pair of cells and one bounce on one core, measured
N_PARTS = 16  # heights in a cell at which the beam is asked for


def solve_exhaustive(
    medium: Medium,
    beam: Beam,
    grid: Grid,
    *,
    n_bounces: int,
    self_cell: bool,
    limit_s: float = 600.0,
) -> BounceField:
    """Return bounces 1 .. n_bounces by gathering from every cell, order after order.

    Parameters
    ----------
    grid : its nodes are the centres of the cells, those at the walls being cut in half by them,
        those in the corners to a quarter
    self_cell : whether a cell also receives the light that it sets out itself
    limit_s : most seconds of one core that it may take

    Raises
    ------
    AnalysisError
        If fewer than two bounces are asked for, the beam leaves the tank's face, or it would take
        more than ``limit_s``.

    Notes
    -----
    Radiance per radian in direction theta is the source along the ray behind, averaged here over
    an angle bin: ``L = (1/dtheta) sum over cells in the bin of A exp(-sigma_t r) / r S``, A being
    the cell's area and r its distance. A pair whose direction falls between two bin centres is
    shared between them linearly. The cell's own light is the integral of 1/r over it,
    ``4 h ln(1 + sqrt 2)`` for a square of side h, spread evenly over the directions. The paper
    does not say that it was added; without it each bounce loses a tenth of the light or more.
    With it the sum over the others, taken at their centres, still falls short of the integral by
    about a tenth of the cell's own light, so the method converges with the first power of h.
    Orders carry sigma_s^(k-1).
    """
    if n_bounces < 2:
        msg = f"n_bounces = {n_bounces}: at least two are needed for multiple scattering."
        raise AnalysisError(msg)
    beam = beam.entering(grid.tank)
    predicted_s = predict_s(grid, n_bounces=n_bounces)
    if predicted_s > limit_s:
        msg = (
            f"the exhaustive method would take {predicted_s:.3g} s for {grid.n_y} x {grid.n_x} "
            f"cells and {n_bounces} bounces, and may take {limit_s:g} s; use a coarser grid."
        )
        raise AnalysisError(msg)
    sigma_s, theta, d_theta = medium.sigma_s_per_mm, grid.theta_rad, 2.0 * math.pi / grid.n_theta
    scatter = sigma_s * convolution_matrix(medium.g, medium.phase, grid.n_theta)
    from_beam = phase_function(theta - math.radians(beam.angle_deg), medium.g, medium.phase)
    fluence = np.empty((n_bounces, grid.n_y, grid.n_x))
    light_field = np.empty((n_bounces - 1, grid.n_y, grid.n_x, grid.n_theta))
    fluence[0] = ballistic_fluence(
        grid.x_mm, grid.y_mm, sigma_t_per_mm=medium.sigma_t_per_mm, beam=beam
    )
    own = _own_light(grid) if self_cell else np.zeros((grid.n_y, grid.n_x, grid.n_theta))
    source = sigma_s * _lit(grid, beam, medium.sigma_t_per_mm)[:, :, None] * from_beam
    for k in range(2, n_bounces + 1):
        radiance = light_field[k - 2]
        np.multiply(own, source, out=radiance)
        _gather(
            np.ascontiguousarray(source * _area(grid)[:, :, None]),
            (grid.y_mm[1], grid.x_mm[1]),
            medium.sigma_t_per_mm,
            radiance,
        )
        fluence[k - 1] = d_theta * radiance.sum(axis=-1)
        source = radiance @ scatter.T
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=fluence,
        light_field=light_field,
        engine="exhaustive",
    )


def predict_s(grid: Grid, *, n_bounces: int) -> float:
    """Return the seconds of one core that `solve_exhaustive` takes, by the measured cost."""
    return PAIR_NS * 1e-9 * (n_bounces - 1) * float(grid.n_x * grid.n_y) ** 2


def _lit(grid: Grid, beam: Beam, sigma_t_per_mm: float) -> Array:
    """Return the ballistic fluence, each cell's mean over its height, (n_y, n_x)."""
    edges = 0.5 * (grid.y_mm[1:] + grid.y_mm[:-1])
    low, high = np.r_[0.0, edges], np.r_[edges, grid.y_mm[-1]]
    part = (np.arange(N_PARTS) + 0.5) / N_PARTS
    heights = low[:, None] + (high - low)[:, None] * part
    lit = ballistic_fluence(grid.x_mm, heights.ravel(), sigma_t_per_mm=sigma_t_per_mm, beam=beam)
    return np.asarray(lit.reshape(grid.n_y, N_PARTS, grid.n_x).mean(axis=1))


def _area(grid: Grid) -> Array:
    """Return the area of the cell around each node, mm^2, (n_y, n_x)."""
    side_x, side_y = np.full(grid.n_x, grid.x_mm[1]), np.full(grid.n_y, grid.y_mm[1])
    for side in (side_x, side_y):
        side[[0, -1]] *= 0.5
    return np.asarray(side_y[:, None] * side_x)


def _own_light(grid: Grid) -> Array:
    """Return the mean way through a cell to its node, mm, (n_y, n_x, n_theta).

    Zero in directions that come from behind a wall.
    """
    b, a = grid.y_mm[1], grid.x_mm[1]
    way = (a * math.asinh(b / a) + b * math.asinh(a / b)) / math.pi
    own = np.full((grid.n_y, grid.n_x, grid.n_theta), way)
    cos, sin = np.cos(grid.theta_rad), np.sin(grid.theta_rad)
    own[:, 0, cos > 0.0] = 0.0
    own[:, -1, cos < 0.0] = 0.0
    own[0][:, sin > 0.0] = 0.0
    own[-1][:, sin < 0.0] = 0.0
    return own


@njit(cache=True, nogil=True)
def _gather(power: Array, pitch: tuple[float, float], sigma_t: float, radiance: Array) -> None:
    """Add to ``radiance`` what each cell receives from every other one.

    Parameters
    ----------
    power : (n_y, n_x, n_theta), source of each cell times its area, mm
    pitch : between rows and between columns, mm
    radiance : (n_y, n_x, n_theta), per radian
    """
    n_y, n_x, n_theta = power.shape
    h_y, h_x = pitch
    per_bin = n_theta / (2.0 * math.pi)
    for j in range(n_y):
        for i in range(n_x):
            for j_from in range(n_y):
                for i_from in range(n_x):
                    if j_from == j and i_from == i:
                        continue
                    dx, dy = (i - i_from) * h_x, (j - j_from) * h_y
                    way = math.sqrt(dx * dx + dy * dy)
                    weight = per_bin * math.exp(-sigma_t * way) / way
                    place = math.atan2(dy, dx) * per_bin - 0.5
                    after = math.floor(place) + 1
                    share = place - after + 1
                    # At most half a turn to either side: bins below zero count from the end.
                    here = power[j_from, i_from]
                    radiance[j, i, after - 1] += weight * (1.0 - share) * here[after - 1]
                    radiance[j, i, after] += weight * share * here[after]
