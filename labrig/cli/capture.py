"""Commands that make sessions and look after them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import labrig
from labrig.acquisition.capturing import prepare, prepare_resume
from labrig.cli.live import drive
from labrig.cli.say import AsJson, bars, one, out_console, say, say_json, say_session
from labrig.exits import EXIT_DAMAGED
from labrig.session.catalogue import catalogue


def capture(
    plan: Annotated[Path, typer.Argument(help="Plan file.")],
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[Path | None, typer.Option(help="Scene file, for a simulated rig.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    operator: Annotated[str | None, typer.Option(help="Who captures; kept in the session.")] = None,
    as_json: AsJson = False,
) -> None:
    """Run a capture plan and keep it as a session."""
    wanted = labrig.load_plan(plan)
    with bars() as follow:
        opened = labrig.open_rig(rig, scene, wanted, progress=one(follow, "light"))
    with opened:
        path = drive(prepare(wanted, opened, out, operator=operator))
    say_session(path, as_json)


def resume(
    session: Annotated[Path, typer.Argument(help="Session folder.")],
    rig: Annotated[
        Path | None, typer.Option(help="Rig file; else the rig as the session keeps it.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Take the shots that an interrupted session lacks."""
    with bars() as follow:
        opened = labrig.reopen_rig(session, rig, progress=one(follow, "light"))
    with opened:
        path = drive(prepare_resume(session, opened))
    say_session(path, as_json)


def import_(
    manifest: Annotated[Path, typer.Argument(help="Manifest of existing image files.")],
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    as_json: AsJson = False,
) -> None:
    """Make a session of existing image files."""
    with bars() as follow:
        path = labrig.import_session(manifest, out, progress=one(follow, "import"))
    say_session(path, as_json)


def verify(
    session: Annotated[Path, typer.Argument(help="Session folder.")], as_json: AsJson = False
) -> int:
    """Check every file of a session; the exit code is 3 if anything is wrong."""
    with bars() as follow:
        problems = labrig.verify(session, progress=one(follow, "verify"))
    if as_json:
        say_json({"session": str(session), "problems": [asdict(p) for p in problems]})
    else:
        for problem in problems:
            say(f"{problem.file}: {problem.what}")
        say(f"{session}: {len(problems)} problems" if problems else f"{session}: whole")
    return EXIT_DAMAGED if problems else 0


def ls(
    root: Annotated[Path, typer.Argument(help="Data root.")] = Path("sessions"),
    as_json: AsJson = False,
) -> None:
    """List the sessions below a data root, and how each stands."""
    entries = catalogue(root)
    if as_json:
        say_json([asdict(entry) for entry in entries])
        return
    table = Table()
    for heading in ("session", "state", "saved", "segments", "MB"):
        right = heading in ("saved", "segments", "MB")
        table.add_column(heading, justify="right" if right else "left", overflow="fold")
    for entry in entries:
        saved = f"{entry.saved}/{entry.planned}"
        size = f"{entry.bytes / 1e6:.1f}"
        table.add_row(entry.path, entry.state, saved, str(entry.segments), size)
    out_console.print(table)
