"""The command that does the main job from end to end."""

from __future__ import annotations

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
    scene: Annotated[Path | None, typer.Option(help="Scene file; else diluted milk.")] = None,
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
    table = Table(title="recovered from the simulated capture")
    for heading in ("parameter", "truth", "recovered", "deviation"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, p in found.parameters.items():
        std = "—" if p.std is None else f"{p.std:.2g}"
        off = (
            f"{p.value - p.truth:+.3f}"
            if name == "g"
            else f"{100 * (p.value / p.truth - 1):+.2f} %"
        )
        table.add_row(name, f"{p.truth:.5g}", f"{p.value:.5g} ± {std}", off)
    out_console.print(table)
    say("± is statistical; the paper's way (Eqs. 9, 10) stands in the report beside it.")
    if found.verification is not None:
        figure, misses = found.verification
        told = ", ".join(f"{k}: {100 * rms:.1f} %" for k, rms in misses.items())
        say(f"bounces off the truth (rms)  {told}")
        say(f"figure   {figure}")
    say(f"session  {found.session}")
    say(f"report   {found.report}")
