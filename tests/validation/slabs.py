"""Slabs solved as the tests of several files want them, and their orders in bins of depth."""

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.medium import Medium, Slab
from analysis.transport.slab import SlabField, solve_slab
from analysis.transport.slab_resolution import depths, directions


def solved(
    m: Medium, slab: Slab, *, q: float = 0.0, fineness: float = 1.0, orders: int = 6
) -> SlabField:
    x = depths(m.sigma_t_per_mm, slab, fineness=fineness)
    grid = directions(m.g, slab, x, wavenumber_per_mm=q, fineness=fineness)
    return solve_slab(m, slab, grid, n_bounces=orders, wavenumber_per_mm=q)


def binned(values, x_mm, sigma_t, edges_mm):
    """Means over bins of values times exp(-sigma_t x), (..., n_bins)."""
    node, weight = np.polynomial.legendre.leggauss(8)
    width = np.diff(edges_mm)[:, None]
    at = edges_mm[:-1, None] + 0.5 * width * (node + 1.0)
    seen = CubicSpline(x_mm, values, axis=-1)(at) * np.exp(-sigma_t * at)
    return seen @ (0.5 * weight)
