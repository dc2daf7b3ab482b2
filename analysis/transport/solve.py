"""The front door of transport: tolerance in, every bounce with a stated error out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import Array, power_removed
from analysis.transport import plane
from analysis.transport.choose import (
    MARGIN,
    SECOND_RATE,
    Resolution,
    expected,
    extrapolate,
    guess,
    relative_error,
    relative_errors,
)
from analysis.transport.ordinates import DType, march, second_fluence, solve_on
from analysis.transport.peaked import aside, solve_peaked

Engine = Literal["auto", "ordinates", "plane"]
TOLERANCES = (1e-6, 0.5)
MAX_ORDERS = 400
MAX_ATTEMPTS = 6
MAX_SECOND = 16384
WORKING_FIELDS = 3  # light fields that a bounce takes beside those returned
SINGLE_TOLERANCE = 1e-5  # single precision costs 1e-6 of the brightest
SINGLE_DEPTH = 60.0  # optical depth; darker than exp(-87) it has no numbers for
SETTLED = 1e-4  # relative change of the ratio of successive orders
SERIES_ORDERS = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What `solve` would do: the engine, its first grid, and why.

    Attributes
    ----------
    field_bytes : memory for the result and the work
    """

    engine: str
    resolution: Resolution
    orders: int
    tolerance: float
    reason: str
    field_bytes: float

    @property
    def radiances(self) -> float:
        """Number of radiances to compute, which the time is proportional to."""
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
) -> BounceField:
    """Return bounces 1 .. orders with a relative rms error of each below the tolerance.

    Parameters
    ----------
    orders : how many; None for as many as leave less than the tolerance of the light to come
    tolerance : of each order's fluence, see `choose.relative_error`; measured, and returned as
        ``error_estimate``
    engine : "plane" takes light and tank to be uniform along the face, without side walls
    light_field : whether radiance is wanted too
    memory_bytes : what is at hand; more is refused

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
    beam = beam.entering(tank)
    if choice.engine == "peaked":
        return solve_peaked(medium, beam, choice.resolution.grid(tank), n_bounces=choice.orders)
    if choice.engine == "plane":
        return _solve_plane(medium, tank, beam, choice, light_field=light_field)
    return _solve_ordinates(
        medium, tank, beam, choice, light_field=light_field, memory_bytes=memory_bytes
    )


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
    n_orders = orders if orders is not None else orders_needed(medium, tank, beam, tolerance)
    resolution = guess(medium, tank, beam, tolerance)
    if medium.sigma_s_per_mm == 0.0 or n_orders == 1:
        reason = "nothing scatters" if medium.sigma_s_per_mm == 0.0 else "the beam alone"
        name = "plane" if engine == "plane" else "ordinates"
    elif engine == "plane":
        name, reason = "plane", "asked for: uniform along the face, no side walls"
    elif aside(medium.g, n_orders).max() <= tolerance:
        name = "peaked"
        reason = (
            f"g = {medium.g} is so near its limit that {tolerance:.0e} does not tell them apart"
        )
    else:
        name, reason = (
            "ordinates",
            "the tank in two dimensions" if engine == "auto" else "asked for",
        )
    choice = Choice(
        engine=name,
        resolution=resolution,
        orders=n_orders,
        tolerance=tolerance,
        reason=reason,
        field_bytes=_bytes(resolution, n_orders, light_field=light_field and name != "peaked"),
    )
    if name == "ordinates":
        _refuse_too_large(choice, medium, memory_bytes)
    return choice


def orders_needed(medium: Medium, tank: Tank, beam: Beam, tolerance: float) -> int:
    """Return how many orders leave less than a tolerance of all light to come.

    The ratio of successive orders tends to sigma_s times the tank's largest eigenvalue; orders
    are counted by it once it has settled, on a coarse grid.

    Raises
    ------
    AnalysisError
        If that ratio is one or more: the series diverges. Or if too many orders are needed.
    """
    if medium.sigma_s_per_mm == 0.0:
        return 1
    if abs(medium.g) > 0.999:
        return _orders_of_peaked(medium, tank, tolerance)
    grid = guess(medium, tank, beam, 0.1).coarser(tank, 2, medium.g)
    remaining = _energy(grid, medium, beam)
    total, previous, ratio = 0.0, math.nan, math.nan
    for k, energy in enumerate(remaining, start=1):
        total += energy
        now = energy / previous if k > 1 else math.nan
        settled = abs(now / ratio - 1.0) < SETTLED
        ratio, previous = now, energy
        if settled and k > 3:
            if ratio >= 1.0:
                least = medium.sigma_s_per_mm / ratio
                f0 = power_removed(medium.g, medium.phase)
                msg = (
                    f"the bounces grow by {ratio:.4g} from order to order and their sum diverges: "
                    f"sigma_s f0 = {medium.sigma_s_per_mm * f0:.4g} / mm feeds more light than the "
                    f"tank loses; below sigma_s = {least:.4g} / mm it converges, and orders "
                    "1 .. K can be had by asking for K."
                )
                raise AnalysisError(msg)
            tail = energy * ratio / (1.0 - ratio)
            more = math.log(max(tail / (tolerance * (total + tail)), 1.0)) / -math.log(ratio)
            needed = k + math.ceil(more)
            if needed > MAX_ORDERS:
                break
            return needed
        if k > 2 and ratio < 1.0 and energy * ratio / (1.0 - ratio) < 0.1 * tolerance * total:
            return k
    msg = (
        f"more than {MAX_ORDERS} bounces are needed for a tolerance of {tolerance}: "
        "ask for a number of orders."
    )
    raise AnalysisError(msg)


def _energy(grid: Grid, medium: Medium, beam: Beam):  # type: ignore[no-untyped-def]
    """Yield the integrated fluence of each order on a grid."""
    depth = grid.tank.depth_mm / math.cos(math.radians(beam.angle_deg))
    y, irradiance = beam.profile_points()
    t = medium.sigma_t_per_mm
    yield float(np.trapezoid(irradiance, y)) * (-math.expm1(-t * depth) / t if t > 0.0 else depth)
    cell = grid.cell_x_mm * grid.cell_y_mm
    for k, radiance in enumerate(march(medium, beam, grid, n_bounces=SERIES_ORDERS), start=2):
        power = (k - 1) * math.log(medium.sigma_s_per_mm) + radiance.log_scale
        yield float(radiance.fluence.sum()) * cell * math.exp(min(power, 600.0))


def _orders_of_peaked(medium: Medium, tank: Tank, tolerance: float) -> int:
    """Return how many terms of exp(sigma_s d) matter, g being near one in absolute value."""
    depth = medium.sigma_s_per_mm * tank.depth_mm
    k, term, total = 1, 1.0, 1.0
    while term > 0.1 * tolerance * total or k < depth:
        term *= depth / k
        total += term
        k += 1
        if k > MAX_ORDERS:
            msg = f"more than {MAX_ORDERS} bounces are needed; ask for a number of orders."
            raise AnalysisError(msg)
    return k


def _solve_ordinates(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    choice: Choice,
    *,
    light_field: bool,
    memory_bytes: float,
) -> BounceField:
    """Solve on finer grids until the measured error meets the tolerance."""
    if medium.sigma_s_per_mm == 0.0 or choice.orders == 1:
        return _unscattered(medium, tank, beam, choice, light_field=light_field)
    tolerance, worst, dtype = choice.tolerance, math.nan, _precision(medium, tank, choice)
    for _ in range(MAX_ATTEMPTS):
        _refuse_too_large(choice, medium, memory_bytes)
        resolution = choice.resolution
        coarse, middle = (
            solve_on(
                medium,
                beam,
                resolution.coarser(tank, times, medium.g),
                n_bounces=choice.orders,
                light_field=False,
                dtype=dtype,
            )
            for times in (4, 2)
        )
        before = relative_errors(coarse.fluence, middle.fluence)
        foreseen = expected(before[2:]) / tolerance
        if foreseen > 3.0:
            choice = _finer(choice, min(foreseen, 64.0) ** 0.5, light_field=light_field)
            continue
        grid = resolution.grid(tank)
        field = solve_on(
            medium, beam, grid, n_bounces=choice.orders, light_field=light_field, dtype=dtype
        )
        change = relative_errors(middle.fluence, field.fluence)
        error = extrapolate(before, change)
        error[0] = 0.0
        error[1] = _mend_second(field, resolution, float(change[1]), tolerance)
        worst = float(error[2:].max(initial=0.0))
        if worst <= tolerance:
            return replace(field, error_estimate=error)
        choice = _finer(choice, 1.1 * (worst / tolerance) ** 0.5, light_field=light_field)
    msg = (
        f"a tolerance of {tolerance} was not met, the error is still {worst:.2g}; "
        "ask for a looser one."
    )
    raise AnalysisError(msg)


def _precision(medium: Medium, tank: Tank, choice: Choice) -> DType:
    """Return single precision where neither the tolerance nor the darkness needs double."""
    optical = medium.sigma_t_per_mm * math.hypot(tank.depth_mm, tank.width_mm)
    single = choice.tolerance >= SINGLE_TOLERANCE and optical < SINGLE_DEPTH
    return np.float32 if single else np.float64


def _finer(choice: Choice, times: float, *, light_field: bool) -> Choice:
    resolution = choice.resolution.refined(times)
    return replace(
        choice,
        resolution=resolution,
        field_bytes=_bytes(resolution, choice.orders, light_field=light_field),
    )


def _mend_second(
    field: BounceField, resolution: Resolution, change: float, tolerance: float
) -> float:
    """Sum the second order over more directions where that is needed; return its error."""
    fall = MARGIN / float(2.0**SECOND_RATE - 1.0)
    n_theta, error = field.grid.n_theta, float(fall * change)
    n_second = max(resolution.n_second, n_theta)
    while n_second > n_theta or error > tolerance:
        n_second = max(n_second, 2 * n_theta)
        halves = second_fluence(field.medium, field.beam, field.grid, n_theta=n_second)
        mean = 0.5 * (halves[0] + halves[1])
        field.fluence[1] = field.medium.sigma_s_per_mm * mean
        error = fall * max(relative_error(halves[0], mean), relative_error(halves[1], mean))
        if error <= tolerance:
            break
        if n_second >= MAX_SECOND:
            msg = (
                f"the second bounce is not found to {tolerance} with {n_second} directions, the "
                f"error is still {error:.2g}; ask for a looser tolerance."
            )
            raise AnalysisError(msg)
        n_second *= 2
    return error


def _unscattered(
    medium: Medium, tank: Tank, beam: Beam, choice: Choice, *, light_field: bool
) -> BounceField:
    """Return the beam alone: orders that nothing feeds are exactly zero."""
    grid = choice.resolution.grid(tank)
    first = solve_on(medium, beam, grid, n_bounces=1, light_field=False).fluence
    later = np.zeros((choice.orders - 1, *first.shape[1:]))
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=np.concatenate([first, later]),
        light_field=np.zeros((*later.shape, grid.n_theta)) if light_field else None,
        engine="ordinates",
        error_estimate=np.zeros(choice.orders),
    )


def _solve_plane(
    medium: Medium, tank: Tank, beam: Beam, choice: Choice, *, light_field: bool
) -> BounceField:
    """Solve in depth alone, doubling nodes and directions until they change little enough."""
    fine = choice.resolution
    grid = Grid(tank=tank, n_x=fine.cells_x + 1, n_y=4, n_theta=fine.n_theta)
    n_x, n_theta, before = 64, 64, None
    for _ in range(MAX_ATTEMPTS):
        nodes = plane.PlaneGrid.graded(
            tank.depth_mm, sigma_t_per_mm=medium.sigma_t_per_mm, n_x=n_x, n_theta=n_theta
        )
        if light_field:
            nodes = nodes.watching(grid.theta_rad)
        found = plane.solve_plane(
            medium, nodes, n_bounces=choice.orders, angle_deg=beam.angle_deg
        ).at(grid.x_mm, medium.sigma_s_per_mm, n_watched=grid.n_theta if light_field else 0)
        if before is not None:
            pairs = zip(before, found.fluence, strict=True)
            error = np.array([MARGIN * relative_error(one, other) for one, other in pairs])
            error /= 2.0**SECOND_RATE - 1.0
            if error.max() <= choice.tolerance:
                return _along_the_face(medium, beam, grid, found, error)
        before = found.fluence
        n_x, n_theta = 2 * n_x, 2 * n_theta
    msg = f"a tolerance of {choice.tolerance} was not met in depth alone; ask for a looser one."
    raise AnalysisError(msg)


def _along_the_face(
    medium: Medium, beam: Beam, grid: Grid, found: plane.DepthField, error: Array
) -> BounceField:
    """Repeat what was found against depth along the face."""
    n_bounces = found.fluence.shape[0]
    fluence = np.repeat(found.fluence[:, None, :], grid.n_y, axis=1)
    light = found.radiance
    if light is not None:
        shape = (n_bounces - 1, grid.n_y, grid.n_x, grid.n_theta)
        light = np.broadcast_to(light.transpose(0, 2, 1)[:, None], shape)
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=fluence,
        light_field=light,
        engine="plane",
        error_estimate=error,
    )


def _bytes(resolution: Resolution, orders: int, *, light_field: bool) -> float:
    nodes = (resolution.cells_x + 1.0) * (resolution.cells_y + 1.0)
    fields = WORKING_FIELDS + (max(orders - 1, 0) if light_field else 0)
    return 8.0 * nodes * (resolution.n_theta * fields + orders)


def _refuse_too_large(choice: Choice, medium: Medium, memory_bytes: float) -> None:
    if choice.field_bytes > memory_bytes:
        r = choice.resolution
        msg = (
            f"g = {medium.g} at a tolerance of {choice.tolerance:g} takes {r.cells_y} x "
            f"{r.cells_x} cells and {r.n_theta} directions, {choice.field_bytes / 1e9:.3g} GB for "
            f"{choice.orders} orders; {memory_bytes / 1e9:.3g} GB are at hand. Ask for a looser "
            "tolerance, fewer orders, or no light field."
        )
        raise AnalysisError(msg)


def _refuse_nonsense(orders: int | None, tolerance: float, engine: str) -> None:
    if orders is not None and not 1 <= orders <= MAX_ORDERS:
        msg = f"orders = {orders}: 1 to {MAX_ORDERS} can be solved for."
        raise AnalysisError(msg)
    if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
        msg = f"tolerance = {tolerance}: {TOLERANCES[0]:g} to {TOLERANCES[1]:g} can be asked for."
        raise AnalysisError(msg)
    if engine not in ("auto", "ordinates", "plane"):
        msg = f"engine = {engine!r} is unknown; choose auto, ordinates or plane."
        raise AnalysisError(msg)
