"""What is present, missing or misconfigured on this machine, and the command that mends it."""

from __future__ import annotations

import importlib.util
import os
import platform
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path

from labrig.doctor.devices import of_rig, plugged_in
from labrig.doctor.finding import Finding
from labrig.doctor.storage import disk
from labrig.models.rig import Rig

PACKAGES = ("labrig", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "tifffile")


def examine(out: Path, rig: Rig | None = None) -> list[Finding]:
    """Look at everything; nothing is changed, and no device is opened but to ask what it is.

    Needed are Python, the packages, and the devices that ``rig`` names.
    """
    found = [_python(), _tkinter(), _display(), *plugged_in(), disk(out), _versions()]
    of_this = [] if rig is None else [replace(finding, needed=True) for finding in of_rig(rig)]
    return [*found, *of_this]


def _python() -> Finding:
    text = f"Python {platform.python_version()} on {platform.system()} {platform.release()}"
    return Finding(
        name="python",
        ok=sys.version_info >= (3, 11) and sys.platform == "linux",
        text=text,
        remedy="use Linux and Python 3.11 or newer",
        needed=True,
    )


def _tkinter() -> Finding:
    ok = importlib.util.find_spec("tkinter") is not None
    return Finding(
        name="tkinter",
        ok=ok,
        text="tkinter is there" if ok else "tkinter is missing: no window, no projector screen",
        remedy="sudo apt-get install python3-tk",
    )


def _display() -> Finding:
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return Finding(
        name="display",
        ok=bool(display),
        text=f"display {display}" if display else "no display: headless runs only",
        remedy="log in at the machine's own screen, or: export DISPLAY=:0",
    )


def _versions() -> Finding:
    lines, missing = [], []
    for package in PACKAGES:
        try:
            lines.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            missing.append(package)
    text = ", ".join(lines) + (f"; missing: {', '.join(missing)}" if missing else "")
    return Finding(name="versions", ok=not missing, text=text, remedy="make install", needed=True)
