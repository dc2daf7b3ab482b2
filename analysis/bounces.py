"""Forward pictures of every bounce for a range of g: the first of the paper's two steps.

The fluence of a bounce depends smoothly on g, so it is solved at a few Chebyshev nodes and
interpolated: a search over g costs no further solution of the transport equation.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Phase
from analysis.transport.beam import ballistic_fluence
from analysis.transport.ordinates import bounce_weight, march

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BounceTable:
    """phi_k at Chebyshev nodes in g, for an albedo of one.

    Attributes
    ----------
    g_nodes : (n_g,)
    fluence : (n_g, K, n_y, n_x)
    """

    sigma_t_per_mm: float
    phase: Phase
    beam: Beam
    grid: Grid
    g_nodes: Array
    fluence: Array

    def at(self, g: float) -> Array:
        """Return phi_1 .. phi_K at an asymmetry for an albedo of one, (K, n_y, n_x)."""
        return np.tensordot(self._share(g), self.fluence, axes=1)

    def multiple(self, g: float, albedo: float) -> Array:
        """Return the multiple scattering sum_(k>=2) sigma_s^(k-1) I_k / c, (n_y, n_x) (Eq. 10)."""
        weights = albedo ** np.arange(self.fluence.shape[1])
        weights[0] = 0.0
        return np.tensordot(np.outer(self._share(g), weights), self.fluence, axes=2)

    def _share(self, g: float) -> Array:
        """Return the weights of the nodes by which a value at g is interpolated, (n_g,).

        Barycentric interpolation on Chebyshev points of the first kind.
        """
        n = self.g_nodes.size
        distance = g - self.g_nodes
        if np.any(distance == 0.0):
            return np.asarray((distance == 0.0).astype(np.float64))
        j = np.arange(n)
        weight = (-1.0) ** j * np.sin((2 * j + 1) * np.pi / (2 * n)) / distance
        return np.asarray(weight / weight.sum())


def tabulate(
    sigma_t_per_mm: float,
    beam: Beam,
    grid: Grid,
    *,
    phase: Phase,
    n_bounces: int,
    g_range: tuple[float, float],
    n_g: int,
) -> BounceTable:
    """Solve the bounces 1 .. n_bounces at n_g asymmetries, these side by side.

    Raises
    ------
    AnalysisError
        As the solver does.
    """
    low, high = g_range
    points = np.cos((2 * np.arange(n_g) + 1) * np.pi / (2 * n_g))
    g_nodes = 0.5 * (low + high) + 0.5 * (high - low) * points
    fluence = np.empty((n_g, n_bounces, grid.n_y, grid.n_x))
    fluence[:, 0] = ballistic_fluence(
        grid.x_mm, grid.y_mm, sigma_t_per_mm=sigma_t_per_mm, beam=beam
    )

    def solve(row: Array, g: float) -> None:
        medium = Medium(
            sigma_t_per_mm=sigma_t_per_mm, sigma_s_per_mm=sigma_t_per_mm, g=g, phase=phase
        )
        # Single precision costs 1e-6 of the brightest, far below what a grid of nodes costs.
        lights = march(medium, beam, grid, n_bounces=n_bounces, dtype=np.float32)
        for k, radiance in enumerate(lights, start=2):
            row[k - 1] = bounce_weight(medium, k, radiance.log_scale) * radiance.fluence

    with ThreadPoolExecutor(min(n_g, os.cpu_count() or 1)) as pool:
        list(pool.map(solve, fluence, map(float, g_nodes)))
    return BounceTable(
        sigma_t_per_mm=sigma_t_per_mm,
        phase=phase,
        beam=beam,
        grid=grid,
        g_nodes=g_nodes,
        fluence=fluence,
    )
