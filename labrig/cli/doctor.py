"""The command that looks at the machine."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import labrig
from labrig.cli.say import AsJson, say, say_json
from labrig.doctor import examine, udev
from labrig.exits import EXIT_DEVICE


def doctor(
    rig: Annotated[Path | None, typer.Option(help="Rig file.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    fix_udev: Annotated[
        bool, typer.Option("--fix-udev", help="Install the rules that open devices to users.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Say what is present, missing or misconfigured, and the command that mends it.

    The exit code is 4 if a device of the rig, or a package, is missing.
    """
    if fix_udev:
        say(f"{udev.INSTALLED} would hold:\n\n{udev.rules()}")
        if typer.confirm("Install these rules?"):
            udev.install()
        else:
            say("Nothing was installed.")
        return 0
    found = examine(out, None if rig is None else labrig.load_rig(rig))
    code = EXIT_DEVICE if any(f.needed and not f.ok for f in found) else 0
    if as_json:
        say_json([asdict(finding) for finding in found])
        return code
    for finding in found:
        say(f"{'ok' if finding.ok else 'missing':8}{finding.name}: {finding.text}")
        if not finding.ok and finding.remedy:
            say(f"{'':8}  to mend: {finding.remedy}")
    return code
