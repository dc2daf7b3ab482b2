"""The front door of transport: tolerance in, every bounce with a stated error out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField
from analysis.medium import Beam, Medium, Tank
from analysis.transport.choose import (
    Resolution,
    Wanted,
    field_bytes,
    guess,
    refuse_too_large,
)
from analysis.transport.engines import solve_by_sampling, solve_exhaustively, solve_in_depth
from analysis.transport.ordinates import solve_on
from analysis.transport.peaked import aside, solve_peaked
from analysis.transport.refine import solve_ordinates
from analysis.transport.series import MAX_ORDERS, orders_needed

Engine = Literal["auto", "ordinates", "plane", "montecarlo", "exhaustive"]
TOLERANCES = (1e-6, 0.5)
GUESSED = 4.0  # times the memory at hand, that a guessed grid may take before it is refused


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What `solve` would do and why.

    Attributes
    ----------
    engine : one of those of `solve`, or "peaked", the limit of light that keeps its line, or
        "beam" where nothing scatters
    resolution : the first grid of ordinates; a measured error above the tolerance refines it
    memory_bytes : for the result and the work
    """

    engine: str
    reason: str
    resolution: Resolution
    orders: int
    tolerance: float
    memory_bytes: float

    @property
    def radiances(self) -> float:
        """Number of radiances that ordinates would compute; their time is proportional to it."""
        return self.resolution.radiances(self.orders)


def solve(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    *,
    orders: int | None = None,
    tolerance: float = 1e-3,
    engine: Engine = "auto",
    light_field: bool = True,
    memory_bytes: float = math.inf,
    progress: Callable[[int, int], None] | None = None,
) -> BounceField:
    """Return bounces 1 .. orders, with a relative rms error of each below the tolerance.

    Parameters
    ----------
    orders : how many; None for as many as leave less than the tolerance of the light to come
    tolerance : of each order's fluence, see `choose.relative_error`; measured, and returned as
        ``error_estimate``
    engine : "ordinates" is the default; "plane" takes light and tank to be uniform along the
        face and to have no side walls; "montecarlo" returns cell means with their noise;
        "exhaustive" is the paper's recursion, whose error is stated but not to be chosen
    light_field : whether radiance is wanted too
    memory_bytes : what is at hand; more is refused
    progress : called with (batches done, batches in all) by the Monte Carlo

    Raises
    ------
    AnalysisError
        If a parameter is out of range, the beam misses the face, the series of bounces diverges,
        the result exceeds the memory, or the tolerance cannot be met.
    """
    choice = choose(
        medium,
        tank,
        beam,
        orders=orders,
        tolerance=tolerance,
        engine=engine,
        light_field=light_field,
        memory_bytes=memory_bytes,
    )
    beam, n = beam.entering(tank), choice.orders
    if choice.engine == "beam":
        return _beam_alone(medium, tank, beam, choice, light_field=light_field)
    if choice.engine == "peaked":
        return solve_peaked(medium, beam, choice.resolution.grid(tank), n_bounces=n)
    if choice.engine == "exhaustive":
        return solve_exhaustively(medium, tank, beam, orders=n)
    wanted = Wanted(
        orders=n, tolerance=tolerance, light_field=light_field, memory_bytes=memory_bytes
    )
    if choice.engine == "plane":
        return solve_in_depth(medium, tank, beam, choice.resolution, wanted)
    if choice.engine == "montecarlo":
        return solve_by_sampling(medium, tank, beam, wanted, progress)
    return solve_ordinates(medium, tank, beam, choice.resolution, wanted)


def choose(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    *,
    orders: int | None,
    tolerance: float,
    engine: Engine = "auto",
    light_field: bool = True,
    memory_bytes: float = math.inf,
) -> Choice:
    """Return what `solve` would do, without solving; it raises the same errors."""
    _refuse_nonsense(orders, tolerance, engine)
    beam = beam.entering(tank)
    if medium.phase == "hg-paper" and abs(medium.g) == 1.0:
        msg = f"hg-paper at g = {medium.g} scatters infinite power; choose hg-plane or |g| < 1."
        raise AnalysisError(msg)
    n_orders = orders if orders is not None else orders_needed(medium, tank, beam, tolerance)
    resolution = guess(medium, tank, beam, tolerance)
    name, reason = str(engine), "asked for"
    if medium.sigma_s_per_mm == 0.0 or n_orders == 1:
        name, reason = "beam", "nothing but the beam itself is called for"
    elif _keeps_to_its_line(medium, engine, n_orders, tolerance):
        name = "peaked"
        resolution = guess(replace(medium, g=0.0), tank, beam, tolerance)
        reason = f"a tolerance of {tolerance:g} does not tell g = {medium.g} from its limit"
    elif engine == "auto":
        name, reason = "ordinates", "cheapest with a light field free of noise"
    needed = field_bytes(resolution, n_orders, light_field=light_field and name != "peaked")
    # The grid of ordinates is a guess yet: whether less does, pilots tell.
    allowed = {"peaked": 1.0, "ordinates": GUESSED}.get(name, math.inf)
    if needed > allowed * memory_bytes:
        refuse_too_large(
            needed, memory_bytes, f"{resolution} for g = {medium.g}, {n_orders} orders"
        )
    return Choice(
        engine=name,
        reason=reason,
        resolution=resolution,
        orders=n_orders,
        tolerance=tolerance,
        memory_bytes=needed,
    )


def _keeps_to_its_line(medium: Medium, engine: str, orders: int, tolerance: float) -> bool:
    if engine not in ("auto", "ordinates") or medium.phase != "hg-plane":
        return False
    return bool(aside(medium.g, orders).max() <= tolerance)


def _beam_alone(
    medium: Medium, tank: Tank, beam: Beam, choice: Choice, *, light_field: bool
) -> BounceField:
    """Return the beam, and orders that nothing feeds: they are exactly zero."""
    grid = choice.resolution.grid(tank)
    first = solve_on(medium, beam, grid, n_bounces=1, light_field=False).fluence
    later = np.zeros((choice.orders - 1, *first.shape[1:]))
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=np.concatenate([first, later]),
        light_field=np.zeros((*later.shape, grid.n_theta)) if light_field else None,
        engine="beam",
        error_estimate=np.zeros(choice.orders),
    )


def _refuse_nonsense(orders: int | None, tolerance: float, engine: str) -> None:
    if orders is not None and not 1 <= orders <= MAX_ORDERS:
        msg = f"orders = {orders}: 1 to {MAX_ORDERS} can be solved for."
        raise AnalysisError(msg)
    if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
        msg = f"tolerance = {tolerance}: {TOLERANCES[0]:g} to {TOLERANCES[1]:g} can be asked for."
        raise AnalysisError(msg)
    if engine not in get_args(Engine):
        msg = f"engine = {engine!r} is unknown; choose {', '.join(get_args(Engine))}."
        raise AnalysisError(msg)
