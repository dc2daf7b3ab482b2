"""What is present, missing or misconfigured on this machine, and the command that mends it."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from labrig.models.rig import Rig

SLOW_FSYNC_S = 0.05
PACKAGES = ("labrig", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "tifffile")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing looked at; ``remedy`` is the command or deed that mends it."""

    name: str
    ok: bool
    text: str
    remedy: str = ""


def examine(out: Path, rig: Rig | None = None) -> list[Finding]:
    """Look at everything; nothing is changed, and no device is opened."""
    checks: list[Callable[[], Finding]] = [
        _python,
        _tkinter,
        _display,
        _cameras,
        _serial_ports,
        _udev_rules,
        lambda: _disk(out),
        _versions,
    ]
    found = [check() for check in checks]
    return found if rig is None else [*found, _rig(rig)]


def _python() -> Finding:
    text = f"Python {platform.python_version()} on {platform.system()} {platform.release()}"
    return Finding(
        name="python",
        ok=sys.version_info >= (3, 11) and sys.platform == "linux",
        text=text,
        remedy="use Linux and Python 3.11 or newer",
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


def _devices(pattern: str, name: str, group: str) -> Finding:
    nodes = sorted(Path("/dev").glob(pattern))
    denied = [str(node) for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if denied:
        text = f"no permission for {', '.join(denied)}"
        return Finding(
            name=name, ok=False, text=text, remedy=f"sudo usermod -aG {group} $USER, log in again"
        )
    text = ", ".join(map(str, nodes)) if nodes else f"no /dev/{pattern}"
    return Finding(name=name, ok=bool(nodes), text=text, remedy="plug it in; then: ls -l /dev")


def _cameras() -> Finding:
    return _devices("video*", "cameras", "video")


def _serial_ports() -> Finding:
    found = _devices("serial/by-id/*", "serial ports", "dialout")
    return (
        found
        if found.ok or "permission" in found.text
        else _devices("tty[UA][SC][BM]*", "serial ports", "dialout")
    )


def _udev_rules() -> Finding:
    folders = [Path(p) for p in ("/etc/udev/rules.d", "/usr/lib/udev/rules.d")]
    rules = [rule for folder in folders if folder.is_dir() for rule in folder.glob("*labrig*")]
    return Finding(
        name="udev rules",
        ok=bool(rules),
        text=", ".join(map(str, rules)) or "no udev rule of labrig: USB devices may be root's only",
        remedy="add a rule with the device's idVendor and MODE=0660, GROUP=plugdev",
    )


def _disk(out: Path) -> Finding:
    """Time fsync where sessions will be written, and say how much room there is."""
    place = next(p for p in (out.absolute(), *out.absolute().parents) if p.is_dir())
    try:
        with tempfile.NamedTemporaryFile(dir=place, prefix=".labrig-doctor-") as stream:
            times = []
            for _ in range(10):
                begun = time.perf_counter()
                stream.write(bytes(1 << 16))
                stream.flush()
                os.fsync(stream.fileno())
                times.append(time.perf_counter() - begun)
    except OSError as error:
        text = f"{place} cannot be written ({error.strerror})"
        return Finding(name="disk", ok=False, text=text, remedy="choose another folder by --out")
    median_s = sorted(times)[len(times) // 2]
    free = shutil.disk_usage(place).free
    text = f"{place}: {free / 1e9:.1f} GB free, fsync of 64 kB takes {1e3 * median_s:.2f} ms"
    return Finding(
        name="disk",
        ok=median_s < SLOW_FSYNC_S and free > 1 << 30,
        text=text,
        remedy="make room, or choose a faster local disk by --out",
    )


def _versions() -> Finding:
    lines, missing = [], []
    for package in PACKAGES:
        try:
            lines.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            missing.append(package)
    text = ", ".join(lines) + (f"; missing: {', '.join(missing)}" if missing else "")
    return Finding(name="versions", ok=not missing, text=text, remedy="make install")


def _rig(rig: Rig) -> Finding:
    drivers = f"camera {rig.camera.driver}, projector {rig.projector.driver}"
    text = f"rig {rig.name!r}: {drivers}, trigger {rig.trigger.driver}"
    return Finding(name="rig", ok=True, text=text)
