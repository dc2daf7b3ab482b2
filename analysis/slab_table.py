"""A slab's orders over a range of extinction and asymmetry, interpolated (Chebyshev)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.errors import AnalysisError
from analysis.medium import Medium, Slab
from analysis.phase_function import Array
from analysis.transport.slab import solve_slab
from analysis.transport.slab_grid import SlabGrid
from analysis.transport.slab_resolution import directions

Range = tuple[float, float]

STRIPED_ORDERS = 14
WHITE_ORDERS = 120
TAIL = 2e-4  # share of the last order, at an albedo of one, from which on a ratio continues it
VERSION = 1  # of the kept files; raise it when the solver changes its answer


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabTable:
    """Orders at Chebyshev nodes of sigma_t and g, for given wave numbers.

    Attributes
    ----------
    sigma_t_per_mm, g : ranges of the table
    wavenumbers_per_mm : (n_q,); zero is white light
    x_mm : (n_x,)
    coefficients : for each wave number (n_sigma_t, n_g, K, n_x), of A_k exp(sigma_t x) at an
        albedo of one; K differs
    error : largest relative error of sums of orders found between the nodes, at an albedo of
        0.95; NaN where it was not looked for
    """

    slab: Slab
    sigma_t_per_mm: Range
    g: Range
    wavenumbers_per_mm: Array
    x_mm: Array
    coefficients: tuple[Array, ...]
    error: float = math.nan

    @classmethod
    def build(
        cls,
        slab: Slab,
        wavenumbers_per_mm: Array,
        x_mm: Array,
        *,
        sigma_t_per_mm: Range,
        g: Range,
        n_nodes: tuple[int, int],
        fineness: float,
        tail: float = TAIL,
    ) -> SlabTable:
        """Solve at every node; ``fineness`` is that of `directions`.

        Every node has the directions of the largest g, so that the orders are smooth in g.

        Raises
        ------
        AnalysisError
            If a range is none.
        """
        _refuse(sigma_t_per_mm, g, n_nodes)
        found = []
        at_sigma_t, at_g = (_nodes(n, r) for n, r in zip(n_nodes, (sigma_t_per_mm, g), strict=True))
        for q in wavenumbers_per_mm:
            hardest = max(g, key=abs)
            grid = directions(hardest, slab, x_mm, wavenumber_per_mm=q, fineness=fineness)
            n_bounces = orders_of(sigma_t_per_mm[1], g[1], slab, grid, q, tail=tail)
            values = np.empty((*n_nodes, n_bounces, x_mm.size))
            for i, sigma_t in enumerate(at_sigma_t):
                for j, asymmetry in enumerate(at_g):
                    values[i, j] = camera_orders(sigma_t, asymmetry, slab, grid, q, n_bounces)
            found.append(_transformed(values))
        return cls(
            slab=slab,
            sigma_t_per_mm=sigma_t_per_mm,
            g=g,
            wavenumbers_per_mm=np.asarray(wavenumbers_per_mm, dtype=np.float64),
            x_mm=x_mm,
            coefficients=tuple(found),
        )

    def orders(self, sigma_t_per_mm: float, g: float) -> list[Array]:
        """Return A_k exp(sigma_t x) for an albedo of one, (K, n_x) for each wave number."""
        by_sigma_t = _polynomials(
            sigma_t_per_mm, self.sigma_t_per_mm, self.coefficients[0].shape[0]
        )
        by_g = _polynomials(g, self.g, self.coefficients[0].shape[1])
        found = []
        for c in self.coefficients:
            of_g = (by_sigma_t @ c.reshape(c.shape[0], -1)).reshape(c.shape[1], -1)
            found.append((by_g @ of_g).reshape(c.shape[2:]))
        return found


def _polynomials(value: float, span: Range, n: int) -> Array:
    """Return Chebyshev polynomials 0 .. n - 1 of a value within a range."""
    u = (2.0 * value - span[0] - span[1]) / (span[1] - span[0])
    return np.asarray(np.polynomial.chebyshev.chebvander(np.array([u]), n - 1)[0])


def camera_orders(
    sigma_t: float, g: float, slab: Slab, grid: SlabGrid, wavenumber: float, n_bounces: int
) -> Array:
    """Return what the camera sees of bounces 1 .. n_bounces, (K, n_x), see `SlabField`."""
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
    return solve_slab(medium, slab, grid, n_bounces=n_bounces, wavenumber_per_mm=wavenumber).camera


def orders_of(
    sigma_t: float, g: float, slab: Slab, grid: SlabGrid, wavenumber: float, *, tail: float
) -> int:
    """Return how many orders leave less than ``tail`` to the last, at an albedo of one."""
    medium = Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)
    most = STRIPED_ORDERS if wavenumber else WHITE_ORDERS
    field = solve_slab(medium, slab, grid, n_bounces=most, wavenumber_per_mm=wavenumber, least=tail)
    return int(field.camera.shape[0])


def _nodes(n: int, span: Range) -> Array:
    u = np.cos(np.pi * (np.arange(n) + 0.5) / n)
    return np.asarray(0.5 * (span[0] + span[1]) + 0.5 * (span[1] - span[0]) * u)


def _transformed(values: Array) -> Array:
    """Return Chebyshev coefficients of values at the nodes along the first two axes."""
    for axis in (0, 1):
        n = values.shape[axis]
        k = np.arange(n)
        matrix = np.cos(np.pi * np.outer(k, k + 0.5) / n) * np.where(k, 2.0, 1.0)[:, None] / n
        values = np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)
    return np.ascontiguousarray(values)


def _refuse(sigma_t: Range, g: Range, n_nodes: tuple[int, int]) -> None:
    if not 0.0 < sigma_t[0] < sigma_t[1] < math.inf or not -1.0 < g[0] < g[1] < 1.0:
        msg = f"sigma_t {list(sigma_t)}, g {list(g)}: ranges are 0 < from < to, -1 < from < to < 1."
        raise AnalysisError(msg)
    if min(n_nodes) < 2:
        msg = f"n_nodes = {list(n_nodes)}: a table has at least two nodes along either axis."
        raise AnalysisError(msg)
