"""A slab's orders over a range of extinction and asymmetry, interpolated (Chebyshev)."""

from __future__ import annotations

import math
import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.medium import Medium, Slab
from analysis.phase_function import Array
from analysis.transport.slab import solve_slab
from analysis.transport.slab_grid import SlabGrid
from analysis.transport.slab_resolution import depths, directions

Range = tuple[float, float]

STRIPED_ORDERS = 14
WHITE_ORDERS = 120
TAIL = 2e-4  # share of the last order, at an albedo of one, from which on a ratio continues it
FINEST = 1.6  # of the solutions a table is checked against
ALBEDO, DEEPEST = 0.95, 5.0  # and the albedo and optical depth it is checked at
VERSION = 2  # of the kept files; raise it when the solver changes its answer


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

    def checked(self, *, n: int, seed: int, fineness: float = FINEST) -> SlabTable:
        """Return the table with its error, as found at ``n`` places between its nodes.

        The largest relative error of the sum of orders at an albedo of 0.95 where the light is
        above e^-5 of the face's, against solutions of the given fineness.
        """
        rng = np.random.default_rng(seed)
        worst = 0.0
        for _ in range(n):
            sigma_t, g = (float(rng.uniform(*span)) for span in (self.sigma_t_per_mm, self.g))
            x = depths(sigma_t, self.slab, fineness=fineness)
            bright = x * sigma_t < DEEPEST
            for q, of_q in zip(self.wavenumbers_per_mm, self.orders(sigma_t, g), strict=True):
                grid = directions(g, self.slab, x, wavenumber_per_mm=q, fineness=fineness)
                exact = camera_orders(sigma_t, g, self.slab, grid, q, of_q.shape[0])
                wanted = np.asarray(np.polynomial.polynomial.polyval(ALBEDO, exact))[bright]
                found = CubicSpline(self.x_mm, np.polynomial.polynomial.polyval(ALBEDO, of_q))(x)
                worst = max(worst, float(np.abs(found[bright] / wanted - 1.0).max()))
        return replace(self, error=worst)

    def save(self, path: Path) -> None:
        """Write the table; what is written appears whole or not at all."""
        arrays = {f"of_{i}": c for i, c in enumerate(self.coefficients)}
        walls = [self.slab.depth_mm, self.slab.height_mm, self.slab.surface_index]
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as part:
            np.savez(
                part,
                allow_pickle=False,
                version=np.array(VERSION),
                slab=walls,
                sigma_t=self.sigma_t_per_mm,
                g=self.g,
                wavenumbers=self.wavenumbers_per_mm,
                x_mm=self.x_mm,
                error=self.error,
                **arrays,
            )
        Path(part.name).replace(path)

    @classmethod
    def load(cls, path: Path) -> SlabTable | None:
        """Return a table that was saved; None where there is none, or it is damaged or outdated."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                if int(kept["version"]) != VERSION:
                    return None
                depth_mm, height_mm, index = (float(v) for v in kept["slab"])
                n_q = kept["wavenumbers"].size
                return cls(
                    slab=Slab(depth_mm=depth_mm, height_mm=height_mm, surface_index=index),
                    sigma_t_per_mm=(float(kept["sigma_t"][0]), float(kept["sigma_t"][1])),
                    g=(float(kept["g"][0]), float(kept["g"][1])),
                    wavenumbers_per_mm=kept["wavenumbers"],
                    x_mm=kept["x_mm"],
                    coefficients=tuple(kept[f"of_{i}"] for i in range(n_q)),
                    error=float(kept["error"]),
                )
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None


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
