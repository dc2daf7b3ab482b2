"""How finely a slab is to be resolved, and what error that leaves."""

from __future__ import annotations

import math

import numpy as np

from analysis.errors import AnalysisError
from analysis.medium import Slab
from analysis.phase_function import Array
from analysis.transport.slab_grid import SlabGrid, graded_depths, polar_angles
from analysis.transport.slab_second import angles_for

CROWDING = 1.25
THIN, HIGH = 1e-9, 1e3  # optical depth and height that numbers still hold for
MOST_DEPTHS = 4000
LEVEL = 0.7  # of `SlabGrid`, under white light; under stripes no light gets far


def depths(sigma_t_per_mm: float, slab: Slab, *, fineness: float) -> Array:
    """Return nodes in depth from face to far wall, (n_x,), finer where the face is near.

    Raises
    ------
    AnalysisError
        If the liquid is too clear, too high or too long for any answer.
    """
    depth, height = (sigma_t_per_mm * size for size in (slab.depth_mm, slab.height_mm))
    if depth < THIN or height > HIGH:
        msg = (
            f"a layer of {depth:.3g} mean free paths in depth and {height:.3g} in height: at least "
            f"{THIN:g} and at most {HIGH:g} can be solved for; leave the height out for a plane."
        )
        raise AnalysisError(msg)
    finest = min(0.008 * slab.height_mm, 0.02 / sigma_t_per_mm)
    coarsest = min(0.5 / sigma_t_per_mm, slab.height_mm)
    wanted = np.log1p(slab.depth_mm / finest) + slab.depth_mm / coarsest
    n_x = max(24, round(1.8 * math.sqrt(fineness) * wanted))
    if n_x > MOST_DEPTHS:
        msg = (
            f"a layer {slab.depth_mm / slab.height_mm:.3g} times as deep as it is high, and "
            f"{depth:.3g} mean free paths deep, takes {n_x:.3g} nodes in depth; at most "
            f"{MOST_DEPTHS} can be solved for: give less depth."
        )
        raise AnalysisError(msg)
    return graded_depths(slab.depth_mm, n_x, finest_mm=finest, coarsest_mm=coarsest)


def directions(
    g: float, slab: Slab, x_mm: Array, *, wavenumber_per_mm: float, fineness: float
) -> SlabGrid:
    """Return a grid of directions that resolves an asymmetry and a wave number.

    Parameters
    ----------
    fineness : one leaves about 0.1 % of a sum of orders; directions grow with its square
    """
    phase = min(wavenumber_per_mm * slab.height_mm, 40.0)
    # Under stripes directions near the beam get out of step with depth: more keep that apart.
    ahead = (10.0 + 8.0 * g**2 + 0.1 * phase) * (1.0 + 0.35 * min(0.2 * phase, 1.0))
    n_forward = max(6, round(fineness * ahead))
    n_backward = max(4, round(fineness * (6.0 + 6.0 * g**4)))
    wave = phase * (0.15 + 0.15 * g**8)
    n_phi = 2 * max(2, round(0.5 * fineness * (10.0 + 4.0 * g**2 + wave)))
    theta, weight = polar_angles(n_forward, n_backward, CROWDING)
    return SlabGrid(
        x_mm=x_mm,
        n_z=max(3, round(3.0 + 2.0 * fineness)),
        theta_rad=theta,
        weight=weight,
        n_phi=n_phi,
        degree=round(min(n_forward, 10.0 + 14.0 * g**2)),
        n_second=max(6, round(min(fineness, 1.0) * angles_for(g))),
        level=LEVEL / (1.0 + (wavenumber_per_mm * slab.height_mm) ** 2),
    )
