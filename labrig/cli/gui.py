"""The command that opens the operator's window."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def gui(
    rig: Annotated[
        Path | None, typer.Option(help="Rig file; else the one used last, or a simulated rig.")
    ] = None,
    scene: Annotated[Path | None, typer.Option(help="Scene file: the tank and its beam.")] = None,
    plan: Annotated[Path | None, typer.Option(help="Capture plan to begin with.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Data root.")] = None,
    operator: Annotated[
        str | None, typer.Option(help="Who captures; kept in the sessions and for the next time.")
    ] = None,
    scale: Annotated[
        int | None, typer.Option(min=75, max=300, help="Size of everything, percent.")
    ] = None,
) -> int:
    """Open the operator's window; every step of a day's work, also without a mouse."""
    from labrig.gui.start import start  # noqa: PLC0415 - tkinter is loaded for the window alone

    return start(rig=rig, scene=scene, plan=plan, out=out, operator=operator, scale=scale)
