"""A window under test on an X server of its own: pump, press keys, look at the pixels."""

from __future__ import annotations

import _tkinter
import ctypes
import gc
import os
import shutil
import signal
import subprocess
import time
import tkinter as tk
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image, ImageGrab

from labrig.gui import settings as kept
from labrig.gui.app import App, Places

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
EVENTS = 60  # between two looks at what is waited for


def die_with_parent() -> None:
    """Let a child be ended with the test, whatever ends it."""
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)


class Display:
    """Xvfb on a number of the server's own choice."""

    def __init__(self, width: int = 1440, height: int = 900) -> None:
        if shutil.which("Xvfb") is None:
            pytest.skip("Xvfb is not installed: apt-get install xvfb")
        read, write = os.pipe()
        self._process = subprocess.Popen(
            [
                "Xvfb",
                "-displayfd",
                str(write),
                "-screen",
                "0",
                f"{width}x{height}x24",
                "-dpi",
                "96",
                "-nolisten",
                "tcp",
            ],
            pass_fds=[write],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=die_with_parent,  # noqa: PLW1509 - no thread runs yet
        )
        os.close(write)
        with os.fdopen(read) as answer:
            self.name = f":{answer.readline().strip()}"

    def grab(self) -> Image.Image:
        """Return what the display shows."""
        return ImageGrab.grab(xdisplay=self.name)

    def stop(self) -> None:
        """End the server."""
        self._process.terminate()
        self._process.wait(timeout=10)


class Window:
    """The app on a display, driven from the test."""

    def __init__(
        self,
        display: Display,
        folder: Path,
        *,
        rig: Path | None = None,
        scene: Path | None = None,
        plan: Path | None = None,
        scale: float | None = None,
        size: tuple[int, int] | None = None,
        helper: bool = True,
        **settings: Any,
    ) -> None:
        self.display = display
        file = folder / "settings" / "window.json"
        found, self.said = kept.load(file)
        if size is not None:
            settings |= {"width": size[0], "height": size[1]}
        found = replace(found, **settings)
        self.root = tk.Tk(screenName=display.name, className="labrig")
        self.root.report_callback_exception = self._raise  # type: ignore[method-assign]
        self.errors: list[BaseException] = []
        places = Places(
            rig=rig or CONFIGS / "rigs" / "simulated-live.yaml",
            scene=scene or CONFIGS / "scenes" / "dilute-milk.yaml",
            plan=plan or CONFIGS / "plans" / "six-shifts.yaml",
            out=folder / "sessions",
            settings=file,
        )
        self.app = App(self.root, places, found, scale=scale)
        if not helper:  # which loads the solvers, seconds of processor time
            self.app.outcomes._begun_s = float("inf")
        self.root.update()
        self.root.focus_force()

    def _raise(self, _kind: object, error: BaseException, _trace: object) -> None:
        self.errors.append(error)

    def pump(self, until: Callable[[], object] = lambda: False, limit_s: float = 30.0) -> bool:
        """Let the window live until something holds, or a time is over; return whether it does."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            for _ in range(EVENTS):  # update() would never end where every beat is late
                if not self.root.tk.dooneevent(_tkinter.DONT_WAIT):
                    break
            if self.errors:
                raise self.errors[0]
            if until():
                return True
            time.sleep(0.003)
        return False

    def key(self, sequence: str, widget: tk.Misc | None = None) -> None:
        """Press a key where the focus is."""
        target = widget or self.root.focus_get() or self.root
        target.event_generate(f"<{sequence}>")
        self.root.update()

    def type(self, text: str) -> None:
        """Type into what has the focus."""
        for letter in text:
            name = {" ": "space", ".": "period", "/": "slash", "-": "minus"}.get(letter, letter)
            self.key(f"Key-{name}")

    def connected(self, limit_s: float = 120.0) -> None:
        """Wait for live pictures."""
        assert self.pump(
            lambda: self.app.live.picture is not None and self.app.devices.plan, limit_s
        ), self.log

    @property
    def log(self) -> list[tuple[str, str, str]]:
        """The log's lines."""
        return self.app.log.lines

    def grab(self) -> Image.Image:
        """Return the window's pixels."""
        self.root.update_idletasks()
        self.root.update()
        x, y = self.root.winfo_rootx(), self.root.winfo_rooty()
        size = (self.root.winfo_width(), self.root.winfo_height())
        return self.display.grab().crop((x, y, x + size[0], y + size[1]))

    def close(self) -> None:
        """Close the window, and free the root in this thread."""
        self.app.close()
        del self.app, self.root
        gc.collect()
