"""sigma_t, sigma_s and g of a liquid in a slab, from stripes and white light together.

The harmonic of the stripes and the white light against depth are ``scale A(x; q)`` and ``scale
A(x; 0)``, with A the sum of all orders; nothing is taken to be single scattering.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from analysis.errors import AnalysisError
from analysis.medium import Slab
from analysis.phase_function import Array
from analysis.slab_profiles import FEWEST, Problem, SlabProfiles
from analysis.slab_table import Range, SlabTable, camera_orders
from analysis.transport.slab_resolution import depths, directions

Choice = tuple[Range, Range, float, tuple[int, int]]
Orders = Callable[[float, float], list[Array]]
Contrasts = Callable[[float, float, float], tuple[Array, Array]]

TABLES = (  # range of g, of sigma_t over the decay of the profile, fineness, nodes
    ((-0.4, 0.6), (0.9, 1.35), 0.55, (3, 4)),
    ((0.5, 0.82), (0.9, 1.5), 0.7, (4, 4)),
    ((0.75, 0.96), (1.0, 2.1), 1.0, (4, 4)),
)
FINE, FINER = 1.2, 0.5  # of what corrects a table: at g = 0, and how much more where g is one
COARSE_TAIL = 1e-3
WALLS = 0.8  # fineness of what height and index change
CORRECTIONS = 8
CONVINCING = 2.0  # chi^2 per degree of freedom below which no other start is tried
SETTLED = 0.1  # of a standard deviation or of half a percent, if that is more
MOST_SEEN = 7.0  # mean free paths beyond the last bin that are still solved for
ALBEDO = (1e-3, 1.0)
AT_END = 0.02  # of a range of g: then the next one is tried


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

    def covariance_with(self, *, height_std_mm: float, index_std: float) -> Array:
        """Return all covariance, with what is not known of height and index, (3, 3)."""
        found = self.covariance + self.model_covariance
        for slope, std in ((self.by_height, height_std_mm), (self.by_index, index_std)):
            if std > 0.0:
                found += np.outer(slope, slope) * std**2
        return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """A minimum, and what led to it.

    Attributes
    ----------
    at : sigma_t, albedo, g
    shift : by how much the last correction moved it
    sure : whether it lies inside its ranges, and corrections have settled
    """

    at: Array
    orders: Orders
    problem: Problem
    table: SlabTable
    shift: Array
    sure: bool
    n_solved: int


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
        problem = Problem.of(profiles, table.x_mm)
        at, sure = _minimise(problem, table.orders, table, None)
        if contrasts is not None:
            problem = problem.with_ratio(*contrasts(at[0], at[0] * at[1], at[2]))
            at, sure = _minimise(problem, table.orders, table, at)
        found = _Found(
            at=at,
            orders=table.orders,
            problem=problem,
            table=table,
            shift=np.zeros(3),
            sure=sure,
            n_solved=0,
        )
    else:
        found = _solve_and_fit(profiles, slab, contrasts)
    gain = _gain(found.problem, found.orders, found.at)
    by_walls = np.full((2, 3), np.nan)
    if unknown_walls:
        by_walls = _by_walls(found, gain)
    return _told(found, gain, by_walls)


def _solve_and_fit(profiles: SlabProfiles, slab: Slab, contrasts: Contrasts | None) -> _Found:
    """Fit with a coarse table for the range of g it takes, then correct that where the fit is."""
    n_solved = 0
    for choice in TABLES:
        table = _first_table(profiles, slab, choice)
        n_solved += table.wavenumbers_per_mm.size * math.prod(choice[3])
        problem = Problem.of(profiles, table.x_mm)
        at, _ = _minimise(problem, table.orders, table, None)
        if at[2] < table.g[1] - AT_END:
            break
    settled = False
    for _ in range(CORRECTIONS):
        orders = _corrected(table, at)
        n_solved += table.wavenumbers_per_mm.size
        if contrasts is not None:
            problem = problem.with_ratio(*contrasts(at[0], at[0] * at[1], at[2]))
        before = at
        at, sure = _minimise(problem, orders, table, at)
        std = np.linalg.norm(_gain(problem, orders, at)[:3], axis=1)
        settled = bool(np.all(np.abs(at - before) < SETTLED * np.maximum(std, 0.005 * np.abs(at))))
        if settled:
            break
    return _Found(
        at=at,
        orders=orders,
        problem=problem,
        table=table,
        shift=at - before,
        sure=sure and settled,
        n_solved=n_solved,
    )


def _told(found: _Found, gain: Array, by_walls: Array) -> SlabFit:
    problem, at = found.problem, found.at
    noise = (problem.noise / problem.std)[problem.use]
    by_noise = gain[:3, : noise.size] * noise
    by_model = gain[:3].copy()
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
        scale_std=float(np.linalg.norm(gain[3, : noise.size] * noise)),
        covariance=to_sigma_s @ by_noise @ by_noise.T @ to_sigma_s.T,
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


def _first_table(profiles: SlabProfiles, slab: Slab, choice: Choice) -> SlabTable:
    """Return a coarse table around the decay of the first profile, no deeper than is needed."""
    g, share, fineness, n_nodes = choice
    q, values, variance = profiles.stacked()
    sigma_t = _decay(profiles.depth_mm, values[0], variance[0])
    seen = float(profiles.depth_mm[np.isfinite(values).any(axis=0)].max() + profiles.bin_mm)
    deep = min(slab.depth_mm, seen + min(MOST_SEEN / sigma_t, 4.0 * slab.height_mm))
    solved = replace(slab, depth_mm=max(deep, seen))
    return SlabTable.build(
        solved,
        q,
        depths(sigma_t, solved, fineness=fineness),
        sigma_t_per_mm=(share[0] * sigma_t, share[1] * sigma_t),
        g=g,
        n_nodes=n_nodes,
        fineness=fineness,
        tail=COARSE_TAIL,
    )


def _decay(depth_mm: Array, values: Array, variance: Array) -> float:
    """Return the rate at which a profile falls, 1/mm: Eq. 9, with whatever else is in it."""
    with np.errstate(invalid="ignore"):
        clear = np.isfinite(values) & (values > 5.0 * np.sqrt(variance))
    if clear.sum() < FEWEST:
        msg = "the profile stands above its noise at too few depths; expose longer, or bin wider."
        raise AnalysisError(msg)
    weight = values[clear] / np.sqrt(variance[clear])
    slope = float(np.polyfit(depth_mm[clear], np.log(values[clear]), 1, w=weight)[0])
    if not slope < 0.0:
        msg = "the light does not fall with depth; is the lit side named rightly?"
        raise AnalysisError(msg)
    return -slope


def _minimise(
    problem: Problem, orders: Orders, table: SlabTable, at: Array | None
) -> tuple[Array, bool]:
    """Return (sigma_t, albedo, g) within the table's ranges, and whether it lies inside them."""
    low, high = table.sigma_t_per_mm
    bounds = np.array([[low, ALBEDO[0], table.g[0]], [high, ALBEDO[1], table.g[1]]])

    def residual(p: Array) -> Array:
        scales, model = problem.scaled(problem.profiles(orders(p[0], p[2]), p[0], p[1]))
        return problem.pulls(model, scales)

    span = table.g[1] - table.g[0]
    starts = [np.array([low + 0.2 * (high - low), 0.7, table.g[0] + s * span]) for s in (0.8, 0.3)]
    tried: list[tuple[float, Array, bool]] = []
    for start in starts if at is None else [at]:
        found = least_squares(
            residual,
            np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6),
            bounds=bounds,
            x_scale=[0.1 * low, 0.1, 0.1],
            xtol=1e-8,
            ftol=1e-8,
        )
        inside = not np.any(found.active_mask)
        tried.append((2.0 * float(found.cost), np.asarray(found.x), inside))
        if tried[-1][0] < CONVINCING * problem.degrees_of_freedom:
            break
    _, best, inside = min(tried, key=lambda one: one[0])
    return best, inside


def _corrected(table: SlabTable, at: Array) -> Orders:
    """Return the table's orders, moved to what a fine solution says they are at one place."""
    sigma_t, g = float(at[0]), float(at[2])
    fineness = FINE + FINER * g**8
    fine_x = depths(sigma_t, table.slab, fineness=fineness)
    moves = []
    for q, here in zip(table.wavenumbers_per_mm, table.orders(sigma_t, g), strict=True):
        grid = directions(g, table.slab, fine_x, wavenumber_per_mm=q, fineness=fineness)
        fine = camera_orders(sigma_t, g, table.slab, grid, q, here.shape[0])
        moves.append(CubicSpline(fine_x, fine, axis=1)(table.x_mm) - here)

    def orders(sigma_t_per_mm: float, asymmetry: float) -> list[Array]:
        there = table.orders(sigma_t_per_mm, asymmetry)
        return [one + move for one, move in zip(there, moves, strict=True)]

    return orders


def _gain(problem: Problem, orders: Orders, at: Array) -> Array:
    """Return what errors of data and contrasts do to (sigma_t, albedo, g, scale of white light).

    The scales are fitted along; errors are in units of their std, so that the rows' products are
    the covariance: (4, n_data + n_q).
    """

    def model(p: Array) -> Array:
        return problem.profiles(orders(p[0], p[2]), p[0], p[1])

    here = model(at)
    scales, _ = problem.scaled(here)
    n_q = problem.ratio.size
    nothing = np.zeros(n_q)
    columns = []

    def told(change: Array, of_contrast: Array) -> Array:
        return np.concatenate([(change / problem.std)[problem.use], of_contrast])

    for i, step in enumerate((1e-3 * at[0], 1e-4, 1e-3)):
        ahead, behind = at.copy(), at.copy()
        ahead[i] += step
        behind[i] -= step
        change = scales[: len(here), None] * (model(ahead) - model(behind)) / (2.0 * step)
        columns.append(told(change, nothing))
    off = scales[:-1] / (scales[-1] * problem.ratio * problem.ratio_std)
    for i, shape in enumerate(here):
        change = np.zeros_like(here)
        change[i] = shape
        of_contrast = np.where(np.arange(n_q) == i, off, 0.0) / scales[i]
        columns.append(told(change, of_contrast if i < n_q else -off / scales[-1]))
    if len(here) == n_q:
        columns.append(told(np.zeros_like(here), -off / scales[-1]))
    jacobian = np.array(columns)
    normal = np.linalg.pinv(jacobian @ jacobian.T, rcond=1e-14, hermitian=True)
    return np.asarray(normal @ jacobian)[[0, 1, 2, 3 + n_q]]


def _by_walls(found: _Found, gain: Array) -> Array:
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
        moved.append(-gain[:3, : shift.size] @ shift)
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
