"""The search for the medium of a slab: a coarse table first, then finer solutions where it leads.

A table of few nodes finds the neighbourhood. There its orders are moved to what a better solution
says they are, with their derivatives by sigma_t and g, which few nodes do not tell well enough: at
g = 0.9 sigma_t and sigma_s are so alike that without them the search does not settle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from analysis.errors import AnalysisError
from analysis.medium import Slab
from analysis.phase_function import Array
from analysis.slab_gain import Orders, gain
from analysis.slab_profiles import FEWEST, Problem, SlabProfiles
from analysis.slab_table import Range, SlabTable, camera_orders
from analysis.transport.slab_grid import SlabGrid
from analysis.transport.slab_resolution import depths, directions

Choice = tuple[Range, Range, float, tuple[int, int]]
Contrasts = Callable[[float, float, float], tuple[Array, Array]]

TABLES: tuple[Choice, ...] = (  # range of g, of sigma_t over the decay, fineness, nodes
    ((-0.4, 0.6), (0.9, 1.35), 0.35, (3, 4)),
    ((0.5, 0.82), (0.9, 1.5), 0.38, (3, 4)),
    ((0.75, 0.96), (1.0, 2.1), 0.45, (4, 4)),
)
FINE, FINER = 1.0, 0.9  # of the last solutions: at g = 0, and how much more where g is one
MEDIUM, MORE = 0.55, 0.45  # fineness at which derivatives are taken: likewise
COARSE_TAIL = 1e-3
APPROACHES, CORRECTIONS = 3, 16
AFRESH = 0.5  # of the room, after which derivatives are taken again for finer solutions
LESS = 0.2  # of the room, once a step went uphill
UPHILL = 1.0005  # of the least sum of squares: a correction that ends above it went too far
STEPS = (0.002, 0.002)  # of the derivatives: relative in sigma_t, and in g
ROOM = (0.1, 0.05)  # within which the moved orders are believed: likewise
NEAR = 3.0  # likewise, before finer solutions are called for
CONVINCING = 2.0  # chi^2 per degree of freedom below which no other start is tried
SETTLED = 0.1  # of a standard deviation, or of a thousandth if that is more
LEAST = 1e-3
MOST_SEEN = 7.0  # mean free paths beyond the last bin that are still solved for
ALBEDO = (1e-3, 1.0)
AT_END = 0.02  # of a range of g: then the next one is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
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


def search(profiles: SlabProfiles, slab: Slab, contrasts: Contrasts | None) -> Found:
    """Find the medium with a coarse table, then with better solutions around what it says."""
    at, problem, table, n_solved = _first(profiles, slab)
    descent = _Descent(problem=problem, contrasts=contrasts)
    for _ in range(APPROACHES):
        grids = _Grids.of(table, at, MEDIUM + MORE * at[2] ** 8)
        local = _Local.of(table, at, grids)
        at = descent.run(local, grids, NEAR)
        n_solved += 2 * len(grids.of_q)
        if abs(at[2] - grids.g) < ROOM[1]:
            break
    if np.any(np.abs(at - local.where) > AFRESH * local.room):
        descent.local = _Local.of(table, at, grids)
        n_solved += 2 * len(grids.of_q)
    fine = _Grids.of(table, at, FINE + FINER * at[2] ** 8)
    at = descent.run(descent.local, fine, SETTLED)
    return Found(
        at=at,
        orders=descent.local.orders,
        problem=descent.problem,
        table=table,
        shift=descent.shift,
        sure=descent.inside and descent.settled,
        n_solved=n_solved + descent.n_solved,
    )


def search_table(profiles: SlabProfiles, table: SlabTable, contrasts: Contrasts | None) -> Found:
    """Find the medium by a table alone."""
    problem = Problem.of(profiles, table.x_mm)
    bounds = _bounds_of(table)
    at, sure = minimise(problem, table.orders, bounds, None)
    if contrasts is not None:
        problem = problem.with_ratio(*contrasts(at[0], at[0] * at[1], at[2]))
        at, sure = minimise(problem, table.orders, bounds, at)
    return Found(
        at=at,
        orders=table.orders,
        problem=problem,
        table=table,
        shift=np.zeros(3),
        sure=sure,
        n_solved=0,
    )


def _first(profiles: SlabProfiles, slab: Slab) -> tuple[Array, Problem, SlabTable, int]:
    """Return what a coarse table says, of the range of g that holds it."""
    n_solved = 0
    for choice in TABLES:
        table = _first_table(profiles, slab, choice)
        n_solved += table.wavenumbers_per_mm.size * choice[3][0] * choice[3][1]
        problem = Problem.of(profiles, table.x_mm)
        at, _ = minimise(problem, table.orders, _bounds_of(table), None)
        if at[2] < table.g[1] - AT_END:
            break
    return at, problem, table, n_solved


def _cost(problem: Problem, orders: Orders, at: Array) -> float:
    """Return the sum of squares that orders leave at a place."""
    sigma_t, albedo, g = (float(v) for v in at)
    scales, model = problem.scaled(problem.profiles(orders(sigma_t, g), sigma_t, albedo))
    return float((problem.pulls(model, scales) ** 2).sum())


def _stands(problem: Problem, orders: Orders, at: Array, before: Array, share: float) -> bool:
    """Return whether two places are the same but for a share of what is known of them.

    Where the model misses the light by more than its errors, less is known by as much.
    """
    misfit = max(_cost(problem, orders, at) / problem.degrees_of_freedom, 1.0)
    std = np.linalg.norm(gain(problem, orders, at)[:3], axis=1) * np.sqrt(misfit)
    return bool(np.all(np.abs(at - before) < share * np.maximum(std, LEAST * np.abs(at))))


@dataclass(slots=True, kw_only=True)
class _Descent:
    """Steps to the minimum, each by orders that were moved to what a solution says at the last.

    A step that ends higher than it began is taken back; what was solved there mends the slope.
    """

    problem: Problem
    contrasts: Contrasts | None
    local: _Local = field(init=False)
    shift: Array = field(init=False)
    inside: bool = False
    settled: bool = False
    n_solved: int = 0

    def run(self, local: _Local, grids: _Grids, share: float) -> Array:
        """Return (sigma_t, albedo, g) once a step is less than a share of what is known of it."""
        least, room, at, tried = np.inf, 1.0, local.where, local
        for _ in range(CORRECTIONS):
            tried = tried.moved_to(at, grids)
            self.n_solved += len(grids.of_q)
            if self.contrasts is not None:
                told = self.contrasts(at[0], at[0] * at[1], at[2])
                self.problem = self.problem.with_ratio(*told)
            cost = _cost(self.problem, tried.orders, at)
            if cost < UPHILL * least:
                best, least, self.local = at, min(cost, least), tried
                room = min(2.0 * room, 1.0)
            else:
                room *= LESS
                self.local = self.local.sloping_as(tried)
            orders = self.local.orders
            at, inside = minimise(self.problem, orders, self.local.bounds(room), best)
            self.shift = at - best
            self.inside = inside or room < 1.0
            self.settled = inside and _stands(self.problem, orders, at, best, share)
            if self.settled:
                return at
        return best


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grids:
    """Grids that do not change with the medium, so that solutions differ by the medium alone."""

    g: float
    of_q: tuple[SlabGrid, ...]

    @classmethod
    def of(cls, table: SlabTable, at: Array, fineness: float) -> _Grids:
        x_mm, g = depths(float(at[0]), table.slab, fineness=fineness), float(at[2])
        return cls(
            g=g,
            of_q=tuple(
                directions(g, table.slab, x_mm, wavenumber_per_mm=float(q), fineness=fineness)
                for q in table.wavenumbers_per_mm
            ),
        )

    def orders(self, table: SlabTable, sigma_t: float, g: float) -> list[Array]:
        """Return the orders at the table's depths."""
        found = []
        kept = zip(table.wavenumbers_per_mm, self.of_q, table.coefficients, strict=True)
        for q, grid, coefficients in kept:
            n = coefficients.shape[2]
            fine = camera_orders(sigma_t, g, table.slab, grid, float(q), n)
            found.append(CubicSpline(grid.x_mm, fine, axis=1)(table.x_mm))
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class _Local:
    """A table's orders, moved to what solutions say of them and their derivatives at a place.

    Attributes
    ----------
    where : sigma_t, albedo, g
    moves : of each wave number (3, K, n_x): the orders, their derivatives by sigma_t and by g
    """

    table: SlabTable
    where: Array
    moves: tuple[Array, ...]
    by: _Grids

    @classmethod
    def of(cls, table: SlabTable, where: Array, grids: _Grids) -> _Local:
        sigma_t, g = float(where[0]), float(where[2])
        step_t, step_g = STEPS[0] * sigma_t, -STEPS[1]
        places = ((sigma_t, g), (sigma_t + step_t, g), (sigma_t, g + step_g))
        off = [_off(table, grids, *place) for place in places]
        moves = tuple(
            np.array([here, (by_t - here) / step_t, (by_g - here) / step_g])
            for here, by_t, by_g in zip(*off, strict=True)
        )
        return cls(table=table, where=where, moves=moves, by=grids)

    def moved_to(self, where: Array, grids: _Grids) -> _Local:
        """Return the orders moved to better solutions at another place.

        Where they are those of such solutions already, derivatives are turned to what the two
        places say of them (Broyden's update).
        """
        if self.by is grids and np.array_equal(where, self.where):
            return self
        off = _off(self.table, grids, float(where[0]), float(where[2]))
        scale = np.array([STEPS[0] * self.where[0], STEPS[1]])
        step = (where - self.where)[[0, 2]] / scale
        turn = step / (step @ step) / scale if self.by is grids else np.zeros(2)
        moves = tuple(
            np.concatenate([one[None], move[1:] + turn[:, None, None] * (one - told)])
            for one, move, told in zip(
                off, self.moves, self._moved(where[0], where[2]), strict=True
            )
        )
        return replace(self, where=where, moves=moves, by=grids)

    def sloping_as(self, other: _Local) -> _Local:
        """Return these orders with the derivatives of others."""
        moves = tuple(
            np.concatenate([mine[:1], theirs[1:]])
            for mine, theirs in zip(self.moves, other.moves, strict=True)
        )
        return replace(self, moves=moves)

    def orders(self, sigma_t_per_mm: float, g: float) -> list[Array]:
        """Return the orders near the place, one array (K, n_x) for each wave number."""
        there = self.table.orders(sigma_t_per_mm, g)
        moved = self._moved(sigma_t_per_mm, g)
        return [one + move for one, move in zip(there, moved, strict=True)]

    def _moved(self, sigma_t_per_mm: float, g: float) -> list[Array]:
        d_t, d_g = sigma_t_per_mm - self.where[0], g - self.where[2]
        return [move[0] + d_t * move[1] + d_g * move[2] for move in self.moves]

    @property
    def room(self) -> Array:
        """How far from the place the moved orders are believed, (3,)."""
        return np.array([ROOM[0] * self.where[0], np.inf, ROOM[1]])

    def bounds(self, share: float) -> Array:
        """Return where the moved orders are believed, a share of the room they have, (2, 3)."""
        bounds = _bounds_of(self.table)
        near = self.where + np.array([[-1.0], [1.0]]) * share * self.room
        low, high = np.maximum(bounds[0], near[0]), np.minimum(bounds[1], near[1])
        return np.array([low, high])


def _off(table: SlabTable, grids: _Grids, sigma_t: float, g: float) -> list[Array]:
    """Return what solutions say beyond a table."""
    solved, kept = grids.orders(table, sigma_t, g), table.orders(sigma_t, g)
    return [one - other for one, other in zip(solved, kept, strict=True)]


def _bounds_of(table: SlabTable) -> Array:
    low, high = table.sigma_t_per_mm
    return np.array([[low, ALBEDO[0], table.g[0]], [high, ALBEDO[1], table.g[1]]])


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


def minimise(
    problem: Problem, orders: Orders, bounds: Array, at: Array | None
) -> tuple[Array, bool]:
    """Return (sigma_t, albedo, g) within bounds (2, 3), and whether it lies inside them."""
    kept: dict[tuple[float, float], list[Array]] = {}

    def residual(p: Array) -> Array:
        at_orders = (float(p[0]), float(p[2]))
        if at_orders not in kept:
            kept.clear()
            kept[at_orders] = orders(*at_orders)
        scales, model = problem.scaled(problem.profiles(kept[at_orders], p[0], p[1]))
        return problem.pulls(model, scales)

    span = bounds[1] - bounds[0]
    starts = [bounds[0] + span * np.array([0.2, 0.7, s]) for s in (0.8, 0.3)]
    tried: list[tuple[float, Array, bool]] = []
    for start in starts if at is None else [at]:
        found = least_squares(
            residual,
            np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6),
            bounds=bounds,
            x_scale=[0.1 * bounds[0, 0], 0.1, 0.1],
            xtol=1e-7,
            ftol=1e-8,
        )
        inside = not np.any(found.active_mask)
        tried.append((2.0 * float(found.cost), np.asarray(found.x), inside))
        if tried[-1][0] < CONVINCING * problem.degrees_of_freedom:
            break
    _, best, inside = min(tried, key=lambda one: one[0])
    return best, inside
