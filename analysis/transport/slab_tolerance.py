"""A slab solved to a tolerance: the resolution is chosen, the error measured, and refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.medium import Medium, Slab
from analysis.phase_function import Array
from analysis.transport.slab import SlabField, solve_slab
from analysis.transport.slab_resolution import depths, directions

AT_ONE = 3e-3  # error of a bounce that fineness one leaves, about
RATE = 2.0  # with what power of the fineness it falls
COARSEST, FINEST = 0.85, 5.0
FINER = 1.4  # first step of fineness
LEAST_STEP, MOST_STEP, SURE = 1.2, 2.0, 1.05
DEEPEST = 6.0  # optical depth down to which bounces are compared
N_COMPARED = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class SettledSlab:
    """A slab's orders, and how well they are known.

    Attributes
    ----------
    error : (K,), relative rms over depth of each bounce that the camera sees: what the last step
        of refinement changed, which is more than what the next would; or a third of what two
        steps did, if that is more, for where a surface begins to reflect all, errors do not fall
        evenly and one step alone may change little
    fineness : of `slab_resolution.directions`
    reached : whether every bounce is within the tolerance
    """

    field: SlabField
    error: Array
    fineness: float
    reached: bool

    def fineness_for(self, tolerance: float, n_bounces: int) -> float:
        """Return what fineness the error that was found asks for, for fewer bounces."""
        share = float(self.error[:n_bounces].max()) / tolerance
        return float(max(self.fineness * share ** (1.0 / RATE), first_fineness(tolerance)))


def first_fineness(tolerance: float) -> float:
    """Return the fineness that is tried first."""
    return float(np.clip((AT_ONE / tolerance) ** (1.0 / RATE), COARSEST, FINEST))


def solve_to(
    medium: Medium,
    slab: Slab,
    *,
    tolerance: float,
    n_bounces: int,
    wavenumber_per_mm: float = 0.0,
) -> SettledSlab:
    """Return bounces 1 .. n_bounces for an albedo of one, each to a relative rms error.

    The resolution follows from g and the tolerance, and is raised until the error that is found is
    below it, up to a fineness of five; ``reached`` tells whether that was enough.

    Raises
    ------
    AnalysisError
        As `solve_slab` does.
    """

    def at(fineness: float) -> SlabField:
        x_mm = depths(medium.sigma_t_per_mm, slab, fineness=fineness)
        grid = directions(
            medium.g, slab, x_mm, wavenumber_per_mm=wavenumber_per_mm, fineness=fineness
        )
        return solve_slab(
            medium, slab, grid, n_bounces=n_bounces, wavenumber_per_mm=wavenumber_per_mm
        )

    fineness = first_fineness(tolerance)
    before, coarse = fineness / FINER, at(fineness / FINER)
    while True:
        fine = at(fineness)
        half = _changed(at(0.5 * fineness), fine) / (2.0**RATE - 1.0)
        step = _changed(coarse, fine) / max((fineness / before) ** RATE - 1.0, 1.0)
        error = np.maximum(step, half)
        reached = bool(error.max() <= tolerance)
        if reached or fineness * LEAST_STEP > FINEST:
            return SettledSlab(field=fine, error=error, fineness=fineness, reached=reached)
        # As far as the error that was found asks for, a little more, and no further than is sure.
        wanted = SURE * float(error.max() / tolerance) ** (1.0 / RATE)
        before, coarse = fineness, fine
        fineness = min(fineness * float(np.clip(wanted, LEAST_STEP, MOST_STEP)), FINEST)


def _changed(coarse: SlabField, fine: SlabField) -> Array:
    """Return the rms over depth of what changed of each bounce's light, relative, (K,)."""
    deep = min(float(fine.x_mm[-1]), DEEPEST / fine.sigma_t_per_mm)
    x = np.linspace(0.0, deep, N_COMPARED)
    decay = np.exp(-fine.sigma_t_per_mm * x)
    one, other = (CubicSpline(f.x_mm, f.camera, axis=1)(x) * decay for f in (coarse, fine))
    rms = np.sqrt(np.mean(other**2, axis=1))
    off = np.sqrt(np.mean((one - other) ** 2, axis=1))
    return np.asarray(np.divide(off, rms, out=np.zeros_like(off), where=rms > 0.0))
