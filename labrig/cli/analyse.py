"""Commands that turn sessions into results and results into pages."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import labrig
from labrig.cli.say import AsJson, Out, out_console, say, say_json, spinner


class Until(StrEnum):
    """Where an analysis stops."""

    separation = "separation"
    results = "results"


def analyse(
    session: Annotated[Path, typer.Argument(help="Session folder.")],
    config: Annotated[Path | None, typer.Option(help="Analysis file.")] = None,
    until: Annotated[Until, typer.Option(help="Stop after a stage.")] = Until.results,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Separate a session and find sigma_t, sigma_s and g."""
    with spinner() as follow:
        result = labrig.analyse(session, config, until=until.value, out=out, progress=follow)
    if as_json:
        say_json({**result.run, "path": str(result.path)})
        return
    say(f"session  {result.run['session']['id']}")
    table = Table()
    table.add_column("parameter")
    table.add_column("value", justify="right")
    for name, found in result.run.items():
        if isinstance(found, dict) and "value" in found:
            std = "—" if found["std"] is None else f"{found['std']:.2g}"
            unknown = found["value"] is None
            told = "not determined" if unknown else f"{found['value']:.5g} ± {std}"
            if found.get("walls_std"):
                told += f" ± {found['walls_std']:.2g} (height, index)"
            table.add_row(name, told)
    closure = result.run["quality"].get("closure")
    if closure is not None and closure["mean"] is not None:
        table.add_row("closure, mean", f"{100 * closure['mean']:+.2f} %")
    out_console.print(table)
    plane = result.run["alternatives"].get("flatland")
    if plane is not None:
        beside = (f"{name} {plane[name]['value']:.5g}" for name in plane if name[0] in "sg")
        say(f"a plane instead of the layer would say {', '.join(beside)}")
    for note in result.run["notes"]:
        say(f"note: {note}")
    say(f"results  {result.path}")


def report(
    session: Annotated[Path, typer.Argument(help="Session or results folder.")],
    beside: Annotated[Path | None, typer.Option(help="A second one, to show side by side.")] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Write figures and a self-contained HTML page of a session's newest results."""
    page = labrig.report(session, out, beside=beside)
    if as_json:
        say_json({"report": str(page)})
    else:
        say(str(page))
