"""Commands that make sessions and look after them."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import labrig
from labrig.cli.exits import EXIT_DAMAGED
from labrig.cli.say import AsJson, bars, one, say, say_json, say_session


def capture(
    plan: Annotated[Path, typer.Argument(help="Plan file.")],
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[Path, typer.Option(help="Scene file, for a simulated rig.")],
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    as_json: AsJson = False,
) -> None:
    """Run a capture plan and keep it as a session."""
    wanted = labrig.load_plan(plan)
    with (
        bars() as follow,
        labrig.open_rig(rig, scene, wanted, progress=one(follow, "light")) as opened,
    ):
        path = labrig.capture(wanted, opened, out, progress=one(follow, "capture"))
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
