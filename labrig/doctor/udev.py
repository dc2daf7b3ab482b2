"""The rules that let a user at the bench open its devices."""

from __future__ import annotations

import subprocess
from pathlib import Path

from labrig.errors import RunError
from labrig.folders import config_folder

INSTALLED = Path("/etc/udev/rules.d/70-labrig.rules")


def rules() -> str:
    """Return the rules that come with the program."""
    return (config_folder() / "udev" / INSTALLED.name).read_text(encoding="utf-8")


def install(target: Path = INSTALLED) -> None:
    """Write the rules and let udev read them.

    Raises
    ------
    RunError
        If this user may not.
    """
    try:
        target.write_text(rules(), encoding="utf-8")
        for words in (["control", "--reload"], ["trigger"]):
            subprocess.run(["udevadm", *words], check=True, capture_output=True)  # noqa: S603, S607
    except (OSError, subprocess.CalledProcessError) as error:
        msg = f"{target} cannot be installed ({error}); run: sudo labrig doctor --fix-udev"
        raise RunError(msg) from error
