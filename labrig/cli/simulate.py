"""The command that simulates a scene and tells what its effects do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import labrig
from labrig.cli.say import AsJson, bars, out_console, say, say_json
from labrig.folders import config_folder
from labrig.simulating import Simulation, simulate, told_as_json, write_simulation


def simulate_(
    scene: Annotated[Path, typer.Argument(help="Scene file.")],
    plan: Annotated[Path, typer.Option(help="Plan file, whose patterns are shown.")],
    rig: Annotated[
        Path | None, typer.Option(help="Rig file; else the simulated rig that comes along.")
    ] = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="Measure what each effect does and costs.")
    ] = False,
    force: Annotated[
        list[str] | None, typer.Option(help="Effect to use although it could be left out.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="NetCDF file to write.")] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate what a camera sees of a scene, with only the effects that it calls for."""
    wanted, shown = labrig.load_scene(scene), labrig.load_plan(plan)
    apparatus = labrig.load_rig(rig or config_folder() / "rigs" / "simulated.yaml")
    with bars() as follow:
        found = simulate(
            wanted,
            apparatus,
            shown,
            force=tuple(force or ()),
            explained=explain,
            progress=follow,
        )
    if out is not None:
        write_simulation(out, found)
    if as_json:
        say_json({**told_as_json(found), "out": None if out is None else str(out)})
        return
    if explain:
        _say_effects(found)
    _say_summary(found)
    if out is not None:
        say(f"light {out}")


def _say_effects(found: Simulation) -> None:
    table = Table(title=f"{found.scene.name}, tolerance {found.scene.tolerance:g}")
    for heading in ("effect", "asked", "used"):
        table.add_column(heading, no_wrap=True)
    table.add_column("CPU s", justify="right", no_wrap=True)
    table.add_column("rms %", justify="right", no_wrap=True)
    table.add_column("why", overflow="fold")
    for told in found.told:
        d = told.decision
        seconds = "" if told.seconds is None else f"{told.seconds:.2f}"
        percent = "" if told.rms_percent is None else f"{told.rms_percent:.3g}"
        table.add_row(d.name, d.asked, "yes" if d.used else "no", seconds, percent, d.why)
    out_console.print(table)


def _say_summary(found: Simulation) -> None:
    summary = found.seen.summary()
    used, named = len(summary["used"]), len(found.seen.decisions)
    kept = found.seen.picture.answer
    origin = ""
    if kept is not None:
        state = "kept from before" if kept.from_cache else f"{found.seen.transport_s:.2f} s"
        origin = f"; multiple scattering by {kept.method} to order {kept.n_bounces} ({state})"
        noise = found.seen.picture.noise()
        if noise:
            origin += f", whose noise is at most {100.0 * noise:.2g} % of the white picture"
    say(
        f"{found.scene.name}: {len(found.light)} pictures in {found.seconds:.2f} CPU s, {used} of "
        f"{named} effects used{origin}"
    )
