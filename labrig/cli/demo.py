"""The command that does the main job from end to end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from labrig import demo as demonstration
from labrig.cli.say import AsJson, bars, out_console, say, say_json


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for session and report.")] = Path(
        "demo"
    ),
    scene: Annotated[
        Path | None, typer.Option(help="Scene file; else diluted milk in a layer of 5 mm.")
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Also draw every bounce beside the true one.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Capture, analyse and report diluted milk on the simulated rig."""
    with bars() as follow:
        found = demonstration.run(out, scene=scene, verify=verify, progress=follow)
    if as_json:
        say_json(
            {
                **{name: asdict(p) for name, p in found.parameters.items()},
                "session": str(found.session),
                "report": str(found.report),
            }
        )
        return
    _say_parameters(found.parameters)
    if found.verification is not None:
        figure, misses = found.verification
        told = ", ".join(f"{k}: {100 * rms:.1f} %" for k, rms in misses.items())
        say(f"bounces off the truth (rms)  {told}")
        say(f"figure   {figure}")
    say(f"session  {found.session}")
    say(f"report   {found.report}")


def _say_parameters(parameters: Mapping[str, demonstration.Recovered]) -> None:
    layered = any(p.plane is not None for p in parameters.values())
    table = Table(title="recovered from the simulated capture")
    headings = ("parameter", "truth", "recovered", "deviation")
    for heading in (*headings, "by a plane") if layered else headings:
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, p in parameters.items():
        std = "—" if p.std is None else f"{p.std:.2g}"
        row = [name, f"{p.truth:.5g}", f"{p.value:.5g} ± {std}", _off(name, p.value, p.truth)]
        if layered:
            told = "—" if p.plane is None else f"{p.plane:.3g} ({_off(name, p.plane, p.truth)})"
            row.append(told)
        table.add_row(*row)
    out_console.print(table)
    say("± is of camera noise and model; the paper's way (Eqs. 9, 10) stands in the report.")


def _off(name: str, value: float, truth: float) -> str:
    return f"{value - truth:+.3f}" if name == "g" else f"{100 * (value / truth - 1):+.2f} %"
