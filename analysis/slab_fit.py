"""sigma_t, sigma_s and g of a liquid in a slab, from stripes and white light together.

The harmonic of the stripes and the white light against depth are ``scale A(x; q)`` and ``scale
A(x; 0)``, with A the sum of all orders; nothing is taken to be single scattering.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.errors import AnalysisError
from analysis.medium import Slab
from analysis.phase_function import Array
from analysis.slab_gain import gain
from analysis.slab_profiles import Problem, SlabProfiles
from analysis.slab_search import Contrasts, Found, search, search_table
from analysis.slab_table import SlabTable, camera_orders
from analysis.transport.slab_resolution import directions

WALLS = 0.7  # fineness of what height and index change


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabFit:
    """The medium whose orders explain the profiles.

    Attributes
    ----------
    scales : (n_q + 1,), of each harmonic and, last, of white light; they differ by what the
        contrasts are found to be other than they were told
    scale_std : of the scale of white light, of the camera's noise
    covariance, model_covariance : (3, 3) of (sigma_t, sigma_s, g), of the camera's noise, and of
        the model's own error and that of the contrasts
    by_height, by_index : (3,), what the three change by per mm of height and per unit of index:
        the fit does not see such a mistake, and its misfit does not show it; NaN if not asked for
    model : (n, n_x), for the profiles in the order of `SlabProfiles.stacked`
    chi2_per_dof, rms_relative : misfit, in units of the noise and of the light
    at_limit : whether a parameter stopped at the end of its range, or corrections never settled: no
        minimum was found inside
    solver_shift : (3,), by what the last correction by a finer solution still moved the answer
    n_solved : solutions of the transport that were called for; zero with a table
    """

    sigma_t_per_mm: float
    sigma_s_per_mm: float
    g: float
    scales: Array
    scale_std: float
    covariance: Array
    model_covariance: Array
    by_height: Array
    by_index: Array
    model: Array
    chi2_per_dof: float
    rms_relative: float
    at_limit: bool
    solver_shift: Array
    n_solved: int

    @property
    def correlation(self) -> Array:
        """Correlation of (sigma_t, sigma_s, g), (3, 3)."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))


def fit_slab(
    profiles: SlabProfiles,
    slab: Slab,
    *,
    table: SlabTable | None = None,
    contrasts: Contrasts | None = None,
    unknown_walls: bool = False,
) -> SlabFit:
    """Find sigma_t, sigma_s and g by least squares, each datum weighed by its variance.

    Without a table a coarse one is made around what the decay says; the answer is then corrected
    by finer solutions until it stands still. With one, nothing is solved.

    Parameters
    ----------
    table : for these wave numbers, height, index and at least these depths
    contrasts : of (sigma_t, sigma_s, g), returns the stripes' contrasts over what the harmonics
        were divided by, and their relative standard deviations, (n_q,) each; for contrasts that
        are measured in the same light
    unknown_walls : whether what height and index do to the answer is wanted, at some more solutions

    Raises
    ------
    AnalysisError
        If the profiles are unfit, do not decay, or the table is about something else.
    """
    if table is not None:
        _refuse_other(table, slab, profiles)
        found = search_table(profiles, table, contrasts)
    else:
        found = search(profiles, slab, contrasts)
    by_errors = gain(found.problem, found.orders, found.at)
    by_walls = np.full((2, 3), np.nan)
    if unknown_walls:
        by_walls = _by_walls(found, by_errors)
    return _told(found, by_errors, by_walls)


def _told(found: Found, by_errors: Array, by_walls: Array) -> SlabFit:
    problem, at = found.problem, found.at
    noise = (problem.noise / problem.std)[problem.use]
    by_noise = by_errors[:3, : noise.size] * noise
    by_common = _by_common(problem, by_noise)
    by_model = by_errors[:3].copy()
    by_model[:, : noise.size] *= np.sqrt(1.0 - noise**2)
    sigma_t, albedo, g = (float(v) for v in at)
    shapes = problem.profiles(found.orders(sigma_t, g), sigma_t, albedo)
    scales, model = problem.scaled(shapes)
    chi2 = float((problem.pulls(model, scales) ** 2).sum())
    light = problem.values[problem.use]
    left = light - model[problem.use]
    to_sigma_s = np.array([[1.0, 0.0, 0.0], [albedo, sigma_t, 0.0], [0.0, 0.0, 1.0]])
    return SlabFit(
        sigma_t_per_mm=sigma_t,
        sigma_s_per_mm=sigma_t * albedo,
        g=g,
        scales=scales,
        scale_std=float(np.linalg.norm(by_errors[3, : noise.size] * noise)),
        covariance=to_sigma_s @ (by_noise @ by_noise.T + by_common) @ to_sigma_s.T,
        model_covariance=to_sigma_s @ by_model @ by_model.T @ to_sigma_s.T,
        by_height=to_sigma_s @ by_walls[0],
        by_index=to_sigma_s @ by_walls[1],
        model=model,
        chi2_per_dof=chi2 / problem.degrees_of_freedom,
        rms_relative=math.sqrt(float((left**2).sum() / (light**2).sum())),
        at_limit=not found.sure,
        solver_shift=to_sigma_s @ found.shift,
        n_solved=found.n_solved,
    )


def _by_common(problem: Problem, by_noise: Array) -> Array:
    """Return the covariance (3, 3) by noise that stripes and white light have in common."""
    each = np.zeros((3, *problem.values.shape))
    each[:, problem.use] = by_noise
    crossed = np.einsum(
        "akx,kx,bx->ab", each[:, : len(problem.correlation)], problem.correlation, each[:, -1]
    )
    return np.asarray(crossed + crossed.T)


def _by_walls(found: Found, by_errors: Array) -> Array:
    """Return what (sigma_t, albedo, g) change by per mm of height and per unit of index, (2, 3)."""
    problem, table = found.problem, found.table
    sigma_t, albedo, g = (float(v) for v in found.at)

    def model(slab: Slab) -> Array:
        orders = []
        for q, kept in zip(table.wavenumbers_per_mm, table.coefficients, strict=True):
            grid = directions(g, slab, table.x_mm, wavenumber_per_mm=q, fineness=WALLS)
            orders.append(camera_orders(sigma_t, g, slab, grid, q, kept.shape[2]))
        return problem.profiles(orders, sigma_t, albedo)

    here = model(table.slab)
    scales, _ = problem.scaled(here)
    moved = []
    height, index = table.slab.height_mm, table.slab.surface_index
    for changed, step in (
        (replace(table.slab, height_mm=1.02 * height), 0.02 * height),
        (replace(table.slab, surface_index=index + 0.02), 0.02),
    ):
        seen = scales[: len(here), None] * (model(changed) - here) / step
        shift = (seen / problem.std)[problem.use]
        # The model changes by this; the parameters move to undo it.
        moved.append(-by_errors[:3, : shift.size] @ shift)
    return np.array(moved)


def _refuse_other(table: SlabTable, slab: Slab, profiles: SlabProfiles) -> None:
    q = profiles.stacked()[0]
    told = (table.slab.height_mm, table.slab.surface_index)
    if told != (slab.height_mm, slab.surface_index):
        msg = f"the table is of height and index {told}, the slab is another; make a table for it."
        raise AnalysisError(msg)
    if table.wavenumbers_per_mm.shape != q.shape or not np.allclose(table.wavenumbers_per_mm, q):
        msg = (
            f"the table is of wave numbers {table.wavenumbers_per_mm.tolist()} / mm, the profiles "
            f"of {q.tolist()}; make a table for them."
        )
        raise AnalysisError(msg)
    if profiles.depth_mm.max() > table.x_mm[-1]:
        msg = f"the table ends at {table.x_mm[-1]:g} mm, before the profiles; make a deeper one."
        raise AnalysisError(msg)
