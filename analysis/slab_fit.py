"""sigma_t, sigma_s and g of a liquid in a slab, from stripes and white light together.

The harmonic of the stripes and the white light against depth are ``scale A(x; q)`` and ``scale
A(x; 0)``, with A the sum of all orders; nothing is taken to be single scattering.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from analysis.errors import AnalysisError
from analysis.medium import Slab
from analysis.phase_function import Array
from analysis.slab_table import Range, SlabTable, camera_orders
from analysis.transport.slab_resolution import depths, directions

Scales = Literal["one", "each"]
Choice = tuple[Range, Range, float, tuple[int, int]]
Orders = Callable[[float, float], list[Array]]

TABLES = (  # range of g, of sigma_t over the decay of the profile, fineness, nodes
    ((-0.4, 0.6), (0.9, 1.35), 0.55, (3, 4)),
    ((0.5, 0.82), (0.9, 1.5), 0.7, (4, 4)),
    ((0.75, 0.96), (0.95, 2.1), 0.85, (4, 4)),
)
FINE, FINER = 1.2, 0.5  # of what corrects a table: at g = 0, and how much more where g is one
COARSE_TAIL = 1e-3
WALLS = 0.8  # fineness of what height and index change
CORRECTIONS = 8
SETTLED = 0.02  # of a standard deviation, or of this times a percent
SUB_BINS = 4  # Gauss points in a bin of depth
FEWEST = 6  # bins of depth
MOST_SEEN = 7.0  # mean free paths beyond the last bin that are still solved for
ALBEDO = (1e-3, 1.0)
AT_END = 0.02  # of a range of g: then the next one is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabProfiles:
    """What was measured against depth; NaN where nothing was.

    Attributes
    ----------
    depth_mm : (n_x,), middles of bins of depth
    bin_mm : their width; zero for points
    wavenumbers_per_mm : (n_q,), 2 pi over the stripes' periods; may be empty
    harmonics : (n_q, n_x), amplitudes over the stripes' own contrast, so that harmonic and white
        light share one scale; complex ones with the stripes' phase taken out, whose real part is
        fitted: at normal incidence A(x; q) is real
    variance : (n_q, n_x)
    white, white_variance : (n_x,), or None
    """

    depth_mm: Array
    bin_mm: float
    wavenumbers_per_mm: Array
    harmonics: Array | NDArray[np.complex128]
    variance: Array
    white: Array | None
    white_variance: Array | None

    def stacked(self) -> tuple[Array, Array, Array]:
        """Return wave numbers (n,), values and variances (n, n_x), white light last.

        Raises
        ------
        AnalysisError
            If shapes differ, nothing was measured, or a number is impossible.
        """
        q = np.atleast_1d(np.asarray(self.wavenumbers_per_mm, dtype=np.float64))
        values, variance = list(np.real(self.harmonics)), list(self.variance)
        if self.white is not None and self.white_variance is not None:
            q = np.append(q, 0.0)
            values.append(self.white)
            variance.append(self.white_variance)
        if any(np.shape(v) != np.shape(self.depth_mm) for v in (*values, *variance)) or not (
            len(values) == len(variance) == q.size
        ):
            msg = "depths, harmonics, white light and variances differ in shape; give one per depth."
            raise AnalysisError(msg)
        if q.size == 0 or not (np.isfinite(q).all() and q.min() >= 0.0):
            msg = f"wave numbers {q.tolist()} / mm: give stripes' 2 pi / period, white light, or both."
            raise AnalysisError(msg)
        found, noise = np.array(values, dtype=np.float64), np.array(variance, dtype=np.float64)
        found = np.where(np.isfinite(noise) & (noise > 0.0), found, np.nan)
        if np.isfinite(found).sum(axis=1).min() < FEWEST:
            msg = (
                f"a profile has fewer than {FEWEST} depths with a value and a variance; "
                "measure deeper, or leave it out."
            )
            raise AnalysisError(msg)
        return q, found, noise


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabFit:
    """The medium whose orders explain the profiles.

    Attributes
    ----------
    scales : (n,), of each profile; equal if one was asked for
    covariance : (3, 3) of (sigma_t, sigma_s, g), of the camera's noise
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
    covariance: Array
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
        """Return the covariance with what is not known of height and index, (3, 3)."""
        found = self.covariance.copy()
        for slope, std in ((self.by_height, height_std_mm), (self.by_index, index_std)):
            if std > 0.0:
                found += np.outer(slope, slope) * std**2
        return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Problem:
    """The profiles, and how orders on the table's depths become them.

    Attributes
    ----------
    at_mm, weight : (n_x, s) points of each bin and their weights
    to_points : (n_x s, n_nodes), spline from the table's depths
    """

    wavenumbers: Array
    values: Array
    std: Array
    use: NDArray[np.bool_]
    at_mm: Array
    weight: Array
    to_points: Array
    scales: Scales

    def profiles(self, orders: list[Array], sigma_t: float, albedo: float) -> Array:
        """Return A(x; q) of every profile, (n, n_x)."""
        decay = np.exp(-sigma_t * self.at_mm)
        found = [
            ((self.to_points @ summed(of_q, albedo)).reshape(decay.shape) * decay) @ self.weight
            for of_q in orders
        ]
        return np.array(found)

    def scaled(self, shapes: Array) -> tuple[Array, Array]:
        """Return the best scales (n,), and scaled shapes."""
        weighted = np.where(self.use, shapes / self.std**2, 0.0)
        up = np.where(self.use, weighted * self.values, 0.0).sum(axis=1)
        down = (weighted * shapes).sum(axis=1)
        if self.scales == "one":
            up, down = np.full_like(up, up.sum()), np.full_like(down, down.sum())
        scales = up / down
        return scales, scales[:, None] * shapes


def summed(orders: Array, albedo: float) -> Array:
    """Return the sum of all orders at an albedo, (n_x,), from those at one, (K, n_x).

    Orders beyond the last go on with the ratio of the last two.
    """
    total = np.polynomial.polynomial.polyval(albedo, orders)
    if orders.shape[0] < 3:
        return np.asarray(total)
    before, last = orders[-2], orders[-1]
    ratio = np.divide(last, before, out=np.zeros_like(last), where=before > 0.0)
    ratio = albedo * np.clip(ratio, 0.0, 0.99)
    return np.asarray(total + albedo ** (orders.shape[0] - 1) * last * ratio / (1.0 - ratio))


def fit_slab(
    profiles: SlabProfiles,
    slab: Slab,
    *,
    table: SlabTable | None = None,
    scales: Scales = "one",
    unknown_walls: bool = False,
) -> SlabFit:
    """Find sigma_t, sigma_s and g by least squares, each datum weighed by its variance.

    Without a table a coarse one is made around what the decay says; the answer is then corrected
    by finer solutions until it stands still. With one, nothing is solved.

    Parameters
    ----------
    table : for these wave numbers, height, index and at least these depths
    scales : "one" where the stripes' contrast is known, else "each"
    unknown_walls : whether what height and index do to the answer is wanted, at some more solutions

    Raises
    ------
    AnalysisError
        If the profiles are unfit, do not decay, or the table is about something else.
    """
    q, values, variance = profiles.stacked()
    std, use = np.sqrt(variance), np.isfinite(values)
    n_solved, corrections = 0, 0 if table else CORRECTIONS
    if table is not None:
        _refuse_other(table, slab, q, profiles)
        problem = _problem(profiles, q, values, std, use, table.x_mm, scales)
        at, limit = _minimise(problem, table.orders, table, None)
    else:
        for choice in TABLES:
            table = _first_table(profiles, q, values, variance, slab, choice)
            n_solved += q.size * math.prod(choice[3])
            problem = _problem(profiles, q, values, std, use, table.x_mm, scales)
            at, limit = _minimise(problem, table.orders, table, None)
            if at[2] < table.g[1] - AT_END:
                break
    shift, orders, settled = np.zeros(3), table.orders, corrections == 0
    for _ in range(corrections):
        orders = _corrected(table, at)
        n_solved += q.size
        before = at
        at, limit = _minimise(problem, orders, table, at)
        shift = at - before
        std = np.sqrt(np.diag(_covariance(problem, orders, at)[0]))
        if np.all(np.abs(shift) < SETTLED * np.maximum(std, 0.01 * np.abs(at))):
            settled = True
            break
    covariance, gain = _covariance(problem, orders, at)
    by_walls = np.full((2, 3), np.nan)
    if unknown_walls:
        by_walls = _by_walls(problem, table, at, gain)
        n_solved += 3 * q.size
    return _told(problem, orders, at, limit or not settled, covariance, by_walls, shift, n_solved)


def _told(
    problem: _Problem,
    orders: Orders,
    at: Array,
    limit: bool,
    covariance: Array,
    by_walls: Array,
    shift: Array,
    n_solved: int,
) -> SlabFit:
    sigma_t, albedo, g = at
    scales, model = problem.scaled(problem.profiles(orders(sigma_t, g), sigma_t, albedo))
    residual = np.where(problem.use, problem.values - model, 0.0)
    chi2 = float(((residual / np.where(problem.use, problem.std, 1.0)) ** 2).sum())
    dof = max(int(problem.use.sum()) - 3 - (1 if problem.scales == "one" else scales.size), 1)
    light = float((np.where(problem.use, problem.values, 0.0) ** 2).sum())
    to_sigma_s = _to_sigma_s(at)
    return SlabFit(
        sigma_t_per_mm=float(sigma_t),
        sigma_s_per_mm=float(sigma_t * albedo),
        g=float(g),
        scales=scales,
        covariance=to_sigma_s @ covariance @ to_sigma_s.T,
        by_height=to_sigma_s @ by_walls[0],
        by_index=to_sigma_s @ by_walls[1],
        model=model,
        chi2_per_dof=chi2 / dof,
        rms_relative=math.sqrt(float((residual**2).sum()) / light),
        at_limit=limit,
        solver_shift=to_sigma_s @ shift,
        n_solved=n_solved,
    )


def _to_sigma_s(at: Array) -> Array:
    """Return the derivatives of (sigma_t, sigma_s, g) by (sigma_t, albedo, g)."""
    return np.array([[1.0, 0.0, 0.0], [at[1], at[0], 0.0], [0.0, 0.0, 1.0]])


def _first_table(
    profiles: SlabProfiles, q: Array, values: Array, variance: Array, slab: Slab, choice: Choice
) -> SlabTable:
    """Return a coarse table around the decay of the first profile, no deeper than is needed."""
    g, share, fineness, n_nodes = choice
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


def _problem(
    profiles: SlabProfiles,
    q: Array,
    values: Array,
    std: Array,
    use: NDArray[np.bool_],
    x_mm: Array,
    scales: Scales,
) -> _Problem:
    node, weight = np.polynomial.legendre.leggauss(SUB_BINS if profiles.bin_mm > 0.0 else 1)
    at_mm = profiles.depth_mm[:, None] + 0.5 * profiles.bin_mm * node
    to_points = CubicSpline(x_mm, np.eye(x_mm.size))(at_mm.ravel())
    return _Problem(
        wavenumbers=q,
        values=values,
        std=std,
        use=use,
        at_mm=at_mm,
        weight=0.5 * weight,
        to_points=to_points,
        scales=scales,
    )


def _minimise(
    problem: _Problem, orders: Orders, table: SlabTable, at: Array | None
) -> tuple[Array, bool]:
    """Return (sigma_t, albedo, g) within the table's ranges, and whether it stopped at an end."""
    low, high = table.sigma_t_per_mm
    bounds = np.array([[low, ALBEDO[0], table.g[0]], [high, ALBEDO[1], table.g[1]]])

    def residual(p: Array) -> Array:
        _, model = problem.scaled(problem.profiles(orders(p[0], p[2]), p[0], p[1]))
        return np.asarray(((problem.values - model) / problem.std)[problem.use])

    starts = [at] if at is not None else [
        np.array([low + 0.2 * (high - low), 0.7, table.g[0] + share * (table.g[1] - table.g[0])])
        for share in (0.3, 0.8)
    ]
    tried = [
        least_squares(
            residual,
            np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6),
            bounds=bounds,
            x_scale=[0.1 * low, 0.1, 0.1],
            xtol=1e-8,
            ftol=1e-8,
        )
        for start in starts
    ]
    best = min(tried, key=lambda found: float(found.cost))
    return np.asarray(best.x), bool(np.any(best.active_mask != 0))


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


def _covariance(problem: _Problem, orders: Orders, at: Array) -> tuple[Array, Array]:
    """Return the covariance of (sigma_t, albedo, g), and what data errors do to them, (3, n n_x).

    The scales are fitted along; errors are in units of the noise.
    """
    sigma_t, albedo, g = (float(v) for v in at)

    def model(p: Array) -> Array:
        return problem.profiles(orders(p[0], p[2]), p[0], p[1])

    steps = np.array([1e-3 * sigma_t, 1e-4, 1e-3])
    scales, _ = problem.scaled(model(at))
    columns = []
    for i, step in enumerate(steps):
        ahead, behind = at.copy(), at.copy()
        ahead[i] += step
        behind[i] -= step
        columns.append(scales[:, None] * (model(ahead) - model(behind)) / (2.0 * step))
    here = model(at)
    if problem.scales == "one":
        columns.append(here)
    else:
        columns.extend(np.diag(np.ones(len(here)))[i][:, None] * here for i in range(len(here)))
    jacobian = np.array([(c / problem.std)[problem.use] for c in columns])
    normal = np.linalg.pinv(jacobian @ jacobian.T, rcond=1e-14)
    return normal[:3, :3], np.asarray(normal @ jacobian)[:3]


def _by_walls(problem: _Problem, table: SlabTable, at: Array, gain: Array) -> Array:
    """Return what (sigma_t, albedo, g) change by per mm of height and per unit of index, (2, 3)."""
    sigma_t, albedo, g = (float(v) for v in at)

    def model(slab: Slab) -> Array:
        orders = []
        for q, kept in zip(table.wavenumbers_per_mm, table.coefficients, strict=True):
            grid = directions(g, slab, table.x_mm, wavenumber_per_mm=q, fineness=WALLS)
            orders.append(camera_orders(sigma_t, g, slab, grid, q, kept.shape[2]))
        return problem.profiles(orders, sigma_t, albedo)

    here = model(table.slab)
    scales, _ = problem.scaled(here)
    found = []
    height, index = table.slab.height_mm, table.slab.surface_index
    for changed, step in (
        (replace(table.slab, height_mm=1.02 * height), 0.02 * height),
        (replace(table.slab, surface_index=index + 0.02), 0.02),
    ):
        seen = scales[:, None] * (model(changed) - here) / step
        # The model changes by this; the parameters move to undo it.
        found.append(-gain @ (seen / problem.std)[problem.use])
    return np.array(found)


def _refuse_other(table: SlabTable, slab: Slab, q: Array, profiles: SlabProfiles) -> None:
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
