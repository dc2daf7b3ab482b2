"""The sub-commands of `labrig calibrate`, each a function of a module of its own."""

from __future__ import annotations

import typer

from labrig.cli.calibrate_latency import latency

calibrate = typer.Typer(
    help="Measure what turns counts into light and requests into pictures.",
    rich_markup_mode=None,
)


@calibrate.callback()
def _group() -> None:
    """Keep a single command from standing for the group."""


calibrate.command()(latency)
