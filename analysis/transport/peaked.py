"""The limits g = 1 and g = -1: light that keeps to the line of the beam (rod model).

A phase function this peaked needs more directions than fit in memory; its limit has closed or
one-dimensional forms, and misses only what is scattered aside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count, islice

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.special import gammaln

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array
from analysis.transport.beam import ballistic_fluence
from analysis.transport.plane import carry, node_steps

ROD_NODES = 801
ROD_LENGTHS = 33
# Error of order k over (k - 1) (1 - |g|): at most 5.6 was measured against the Monte Carlo, at
# abs(g) = 0.99 and 0.999 and tanks of 5 and 20 mean free paths.
ASIDE = 12.0


def solve_peaked(medium: Medium, beam: Beam, grid: Grid, *, n_bounces: int) -> BounceField:
    """Return the bounces in the limit of g's sign, with the error of taking it.

    All light travels along the beam's line, as the ballistic beam does: there is no light field.

    Raises
    ------
    AnalysisError
        If the phase function is hg-paper, whose power is infinite in this limit.
    """
    if medium.phase != "hg-plane":
        msg = f"hg-paper has no limit at g = {medium.g}: it scatters infinite power; use hg-plane."
        raise AnalysisError(msg)
    beam = beam.entering(grid.tank)
    slant = math.radians(beam.angle_deg)
    lit = ballistic_fluence(grid.x_mm, grid.y_mm, sigma_t_per_mm=0.0, beam=beam)
    path = np.broadcast_to(grid.x_mm / math.cos(slant), lit.shape)
    if medium.g > 0.0:
        along = _forward(medium, path, n_bounces)
    else:
        entry = grid.y_mm[:, None] - grid.x_mm[None, :] * math.tan(slant)
        along = _to_and_fro(medium, path, _rod_length(entry, slant, grid), n_bounces)
    k = np.arange(n_bounces)
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=lit * along,
        light_field=None,
        engine="peaked",
        error_estimate=aside(medium.g, n_bounces)[k],
    )


def aside(g: float, n_bounces: int) -> Array:
    """Return the relative error of orders 1 .. K that comes from taking the limit, (K,)."""
    return np.minimum(ASIDE * (1.0 - abs(g)) * np.arange(n_bounces, dtype=np.float64), 1.0)


def _forward(medium: Medium, path: Array, n_bounces: int, *, first: int = 1) -> Array:
    """Return exp(-sigma_t d) (sigma_s d)^(k-1) / (k-1)! from bounce ``first``, (n, n_y, n_x)."""
    with np.errstate(divide="ignore"):
        log_depth = np.log(medium.sigma_s_per_mm * path)
    k = np.arange(first - 1, n_bounces)[:, None, None]
    power = np.where(k > 0, k * np.where(k > 0, log_depth, 0.0), 0.0) - gammaln(k + 1.0)
    return np.asarray(np.exp(power - medium.sigma_t_per_mm * path))


def _rod_length(entry: Array, slant: float, grid: Grid) -> Array:
    """Return the way through the tank of the beam's line that enters at a height, mm."""
    through = grid.tank.depth_mm / math.cos(slant)
    if slant == 0.0:
        return np.full(entry.shape, through)
    side = (grid.tank.width_mm - entry if slant > 0.0 else entry) / abs(math.sin(slant))
    return np.asarray(np.clip(side, 0.0, through))


def _to_and_fro(medium: Medium, path: Array, length: Array, n_bounces: int) -> Array:
    """Return the orders of rods whose light turns back at every scattering, (K, n_y, n_x).

    Solved on rods of several lengths and interpolated: the second order is
    sigma_s / (2 sigma_t) (exp(-sigma_t s) - exp(-sigma_t (2 W - s))).
    """
    longest = float(length.max())
    lengths = np.linspace(0.0, longest, ROD_LENGTHS)
    nodes = _rod_nodes(medium.sigma_t_per_mm * longest)
    share = np.divide(path, length, out=np.zeros(path.shape), where=length > 0.0)
    inside = (share <= 1.0 + 1e-9) & (length > 0.0)
    at = (length.ravel(), np.clip(share, 0.0, 1.0).ravel())
    rods = islice(_rods(medium, lengths, nodes), n_bounces)
    found = [RectBivariateSpline(lengths, nodes, rod).ev(*at).reshape(path.shape) for rod in rods]
    return np.maximum(np.where(inside, found, 0.0), 0.0)


def _rod_nodes(optical: float) -> Array:
    """Return nodes along a rod of length one that crowd where the light enters, if it is thick."""
    stretch = math.asinh(max(0.1 * optical, 1e-3))
    return np.asarray(np.sinh(stretch * np.linspace(0.0, 1.0, ROD_NODES)) / math.sinh(stretch))


def _rods(medium: Medium, lengths_mm: Array, nodes: Array) -> Iterator[Array]:
    """Yield orders 1, 2, .. of rods at shares of their lengths, (n, n_nodes)."""
    optical = medium.sigma_t_per_mm * lengths_mm
    radiance = np.exp(-optical[:, None] * nodes).astype(np.complex128)
    there, back = (
        node_steps(nodes, np.full(lengths_mm.size, way), optical.astype(np.complex128))
        for way in (1.0, -1.0)
    )
    scattered = medium.sigma_s_per_mm * lengths_mm[:, None]
    for k in count(2):
        yield radiance.real
        onward = np.full(lengths_mm.size, k % 2 == 1)
        radiance = carry(scattered * radiance, onward, *(there if k % 2 else back))


def line_energies(medium: Medium, tank: Tank, beam: Beam) -> Iterator[float]:
    """Yield the energy of orders 1, 2, .. on the longest line that the beam takes, mm.

    In the limit of g's sign, as `solve_peaked` has it.
    """
    slant = math.radians(beam.angle_deg)
    longest = tank.depth_mm / math.cos(slant)
    if slant:
        longest = min(longest, tank.width_mm / abs(math.sin(slant)))
    nodes = _rod_nodes(medium.sigma_t_per_mm * longest)
    if medium.g < 0.0:
        rods = _rods(medium, np.array([longest]), nodes)
        yield from (float(np.trapezoid(rod[0], nodes)) * longest for rod in rods)
    else:
        path = (nodes * longest)[None, :]
        for k in count(1):
            yield float(np.trapezoid(_forward(medium, path, k, first=k)[0, 0], path[0]))
