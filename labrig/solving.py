"""Solve a scene's transport: what it will cost, every bounce, and the file it is kept in."""

from __future__ import annotations

import math
import os
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium, Tank
from analysis.transport.ordinates import solve_on
from analysis.transport.solve import TOLERANCES, Choice, Engine, choose, solve
from labrig.errors import RunError
from labrig.models.scene import Scene
from labrig.results import write_fields
from labrig.scene.filled import refuse_layer
from labrig.solving_layer import layer_bounces
from labrig.steps.bounce_fields import bounce_fields

STEP = 10.0  # between the tolerances that an explanation compares
MEMINFO = Path("/proc/meminfo")


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """Every bounce of a scene, and what it took, the kernels being warm."""

    field: BounceField
    seconds: float
    cpu_seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a tolerance would take: the first grid's time by a rate measured just now."""

    choice: Choice
    seconds: float


def solve_scene(
    scene: Scene,
    *,
    orders: int | None = None,
    tolerance: float = 1e-3,
    engine: Engine = "auto",
    light_field: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Solved:
    """Return every bounce of a scene to a tolerance; see `analysis.transport.solve.solve`.

    Where the liquid's height is given it is a slab's, see `analysis.slab_field`.

    Raises
    ------
    analysis.errors.AnalysisError
        If no answer exists, or it would not fit in the memory at hand.
    """
    if scene.tank.height_mm is not None:
        return solve_layer(scene, orders=orders, tolerance=tolerance, engine=engine)
    medium, tank, beam = records(scene)
    _rate_s()  # loads the kernels, so that the time is that of the solver alone
    wall, cpu = time.perf_counter(), time.process_time()
    field = solve(
        medium,
        tank,
        beam,
        orders=orders,
        tolerance=tolerance,
        engine=engine,
        light_field=light_field,
        memory_bytes=memory_at_hand_bytes(),
        progress=progress,
    )
    return Solved(
        field=field,
        seconds=time.perf_counter() - wall,
        cpu_seconds=time.process_time() - cpu,
    )


def solve_layer(scene: Scene, *, orders: int | None, tolerance: float, engine: Engine) -> Solved:
    """Return what the camera sees of every bounce of a layer.

    Raises
    ------
    PlanError
        If another engine is asked for than the slab's own.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    field = layer_bounces(scene, orders=orders, tolerance=tolerance, engine=engine)
    return Solved(
        field=field,
        seconds=time.perf_counter() - wall,
        cpu_seconds=time.process_time() - cpu,
    )


def explain(
    scene: Scene, *, orders: int | None = None, tolerance: float = 1e-3, engine: Engine = "auto"
) -> list[Cost]:
    """Return what the wished tolerance would take, and what looser and tighter ones would.

    Ordered from loose to tight. Nothing is solved; the memory is not refused but stated.

    Raises
    ------
    analysis.errors.AnalysisError
        If no answer exists.
    """
    refuse_layer(scene, "an estimate of the cost")
    medium, tank, beam = records(scene)
    rate_s = _rate_s()
    asked = [tolerance * STEP, tolerance, tolerance / STEP]
    inside = [t for t in asked if t == tolerance or TOLERANCES[0] <= t <= TOLERANCES[1]]
    choices = [
        choose(medium, tank, beam, orders=orders, tolerance=t, engine=engine) for t in inside
    ]
    return [Cost(choice=one, seconds=one.radiances * rate_s) for one in choices]


def write_solution(path: Path, solved: Solved) -> None:
    """Write the bounces as NetCDF, beside its place first and renamed into it when complete.

    Raises
    ------
    RunError
        If the place cannot be written.
    """
    field = solved.field
    attributes: dict[str, str | float] = {
        "engine": field.engine,
        "beam_direction_rad": math.radians(field.beam.angle_deg),
        "sigma_t_per_mm": field.medium.sigma_t_per_mm,
        "sigma_s_per_mm": field.medium.sigma_s_per_mm,
        "g": field.medium.g,
        "phase": field.medium.phase,
        "values": "point values" if isinstance(field.grid, Grid) else "cell means",
    }
    part = path.with_name(f".{path.name}.{secrets.token_hex(2)}.part")
    try:
        write_fields(part, bounce_fields(field, "mm"), attributes)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        msg = f"{path}: cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error


def records(scene: Scene) -> tuple[Medium, Tank, Beam]:
    """Return what a forward calculation of a scene is about."""
    return scene.medium.record(), scene.tank.record(), scene.beam.record()


def memory_at_hand_bytes() -> float:
    """Return the memory that a new allocation can have without swapping."""
    try:
        for line in MEMINFO.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def _rate_s() -> float:
    """Return the processor time of one radiance, measured on a small tank."""
    grid = Grid(tank=Tank(depth_mm=4.0, width_mm=3.0), n_x=65, n_y=49, n_theta=32)
    medium = Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=0.5, g=0.4)
    beam, n_bounces = Beam(from_mm=1.0, to_mm=2.0), 5
    best = math.inf
    for _ in range(3):
        begin = time.process_time()
        solve_on(medium, beam, grid, n_bounces=n_bounces)
        best = min(best, time.process_time() - begin)
    return best / (grid.n_x * grid.n_y * grid.n_theta * (n_bounces - 1))
