"""The command that solves a scene's transport."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

import labrig
from analysis.light_field import Grid
from labrig.cli.say import AsJson, bars, one, out_console, say, say_json

if TYPE_CHECKING:
    from labrig.solving import Cost, Solved


class EngineName(StrEnum):
    """Methods of solution."""

    auto = "auto"
    ordinates = "ordinates"
    plane = "plane"
    montecarlo = "montecarlo"
    exhaustive = "exhaustive"


def solve(
    scene: Annotated[Path, typer.Argument(help="Scene file.")],
    orders: Annotated[
        int | None, typer.Option(help="Bounces; else as many as the tolerance calls for.")
    ] = None,
    tolerance: Annotated[float, typer.Option(help="Relative rms error of each bounce.")] = 1e-3,
    engine: Annotated[EngineName, typer.Option(help="Method.")] = EngineName.auto,
    out: Annotated[Path | None, typer.Option("--out", help="NetCDF file to write.")] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Say what it would cost; solve nothing.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Compute every bounce of a scene's light to a stated accuracy."""
    wanted = labrig.load_scene(scene)
    if explain:
        costs = labrig.explain(wanted, orders=orders, tolerance=tolerance, engine=engine.value)
        _say_costs(costs, tolerance, as_json)
        return
    with bars() as follow:
        solved = labrig.solve(
            wanted,
            orders=orders,
            tolerance=tolerance,
            engine=engine.value,
            light_field=out is not None,
            progress=one(follow, "paths"),
        )
    if out is not None:
        labrig.write_solution(out, solved)
    if as_json:
        say_json({**_summary(solved), "out": None if out is None else str(out)})
        return
    _say_solution(solved)
    if out is not None:
        say(f"solution {out}")


def _summary(solved: Solved) -> dict[str, Any]:
    field = solved.field
    kind = "nodes" if isinstance(field.grid, Grid) else "cells"
    errors = field.error_estimate
    return {
        "engine": field.engine,
        "grid": {"y": field.grid.n_y, "x": field.grid.n_x, "of": kind},
        "angles": field.grid.n_theta,
        "orders": field.n_bounces,
        "seconds": solved.seconds,
        "cpu_seconds": solved.cpu_seconds,
        "error_estimate": None if errors is None else errors.tolist(),
    }


def _say_solution(solved: Solved) -> None:
    field, summary = solved.field, _summary(solved)
    grid = summary["grid"]
    say(
        f"{field.engine}: {grid['y']} x {grid['x']} {grid['of']}, {summary['angles']} angles, "
        f"{solved.cpu_seconds:.3g} s of processor time"
    )
    table = Table()
    for heading in ("bounce", "brightest fluence", "relative error"):
        table.add_column(heading, justify="right")
    errors = field.error_estimate
    for k, picture in enumerate(field.fluence):
        error = "—" if errors is None else f"{errors[k]:.1e}"
        table.add_row(str(k + 1), f"{picture.max():.4g}", error)
    out_console.print(table)


def _say_costs(costs: list[Cost], tolerance: float, as_json: bool) -> None:
    if as_json:
        say_json([_cost(cost) for cost in costs])
        return
    chosen = next(cost.choice for cost in costs if cost.choice.tolerance == tolerance)
    say(f"{chosen.engine}: {chosen.reason}; {chosen.orders} orders")
    table = Table()
    for heading in ("tolerance", "engine", "cells", "angles", "seconds", "memory"):
        table.add_column(heading, justify="right")
    for cost in costs:
        choice = cost.choice
        r = choice.resolution
        table.add_row(
            f"{choice.tolerance:g}",
            choice.engine,
            f"{r.cells_y} x {r.cells_x}",
            str(r.n_theta),
            f"{cost.seconds:.2g}" if choice.engine in {"ordinates", "slab"} else "—",
            f"{choice.memory_bytes / 1e6:.3g} MB",
        )
    out_console.print(table)
    of = "all grids, by a coarse solution and" if chosen.engine == "slab" else "the first grid, by"
    say(f"Times are of {of} a rate measured now; a measured error may refine it.")


def _cost(cost: Cost) -> dict[str, Any]:
    choice, r = cost.choice, cost.choice.resolution
    return {
        "tolerance": choice.tolerance,
        "engine": choice.engine,
        "reason": choice.reason,
        "orders": choice.orders,
        "cells": {"y": r.cells_y, "x": r.cells_x},
        "angles": r.n_theta,
        "seconds": cost.seconds if math.isfinite(cost.seconds) else None,
        "memory_bytes": choice.memory_bytes,
    }
