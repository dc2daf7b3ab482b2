"""A window under test on an X server of its own: pump, press keys, look at the pixels.

Nothing here waits for a fixed time: what is waited for either happens, or `LONG_S` is over.
"""

from __future__ import annotations

import _tkinter
import ctypes
import gc
import os
import shutil
import signal
import subprocess
import threading
import time
import tkinter as tk
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from PIL import Image, ImageGrab

from drivers.simulation.faults import Fault, FaultScript
from labrig.gui import settings as kept
from labrig.gui.app import App, Places

if TYPE_CHECKING:
    from labrig.station.shown import Shown
    from labrig.station.station import Station

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
EVENTS = 60  # between two looks at what is waited for
LONG_S = float(os.environ.get("LABRIG_PATIENCE_S", "300"))  # then a thing has not happened


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
        self._process.wait(timeout=60)


Open = Callable[..., "Window"]
SLANT_DEG = 12  # of the second session of `results_root`


class Watched:
    """Tk's interpreter, which hears of every call out of a thread that does not own it."""

    def __init__(self, tk: Any, heard: list[str]) -> None:
        self._tk, self._heard, self._owner = tk, heard, threading.get_ident()

    def __getattr__(self, name: str) -> Any:
        if threading.get_ident() != self._owner:
            where = traceback.extract_stack(limit=3)[0]
            thread = threading.current_thread().name
            self._heard.append(f"{thread}: {name} at {where.filename}:{where.lineno}")
        return getattr(self._tk, name)


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
        out: Path | None = None,
        scale: float | None = None,
        size: tuple[int, int] | None = None,
        helper: bool = True,
        **settings: Any,
    ) -> None:
        self.display = display
        file = folder / "settings" / "window.json"
        found, _ = kept.load(file)
        if size is not None:
            settings |= {"width": size[0], "height": size[1]}
        found = replace(found, **settings)
        self.root = tk.Tk(screenName=display.name, className="labrig")
        self.calls_of_other_threads: list[str] = []
        self.root.tk = Watched(self.root.tk, self.calls_of_other_threads)  # type: ignore[assignment]
        self.root.report_callback_exception = self._raise  # type: ignore[method-assign]
        self.errors: list[BaseException] = []
        places = Places(
            rig=rig or CONFIGS / "rigs" / "simulated-live.yaml",
            scene=scene or CONFIGS / "scenes" / "dilute-milk.yaml",
            plan=plan or CONFIGS / "plans" / "six-shifts.yaml",
            out=out or folder / "sessions",
            settings=file,
        )
        self.app = App(self.root, places, found, scale=scale)
        if not helper:  # which loads the solvers, seconds of processor time
            self.app.outcomes._begun_s = float("inf")
        self.root.update_idletasks()
        assert self.pump(self.root.winfo_viewable)
        self.root.focus_force()
        self.events()

    def _raise(self, _kind: object, error: BaseException, _trace: object) -> None:
        self.errors.append(error)

    def events(self) -> None:
        """Let Tk do what waits, and not all that comes meanwhile, as update() would."""
        for _ in range(EVENTS):
            if not self.root.tk.dooneevent(_tkinter.DONT_WAIT):
                break
        if self.errors:
            raise self.errors[0]

    def pump(self, until: Callable[[], object] = lambda: False, limit_s: float = LONG_S) -> bool:
        """Let the window live until something holds, or a time is over; return whether it does."""
        end = time.monotonic() + limit_s
        while True:
            self.events()
            if until():
                return True
            if time.monotonic() > end:
                return False
            time.sleep(0.003)

    def beats(self, n: int = 3) -> None:
        """Let the window live through so many of its beats, and what they draw."""
        begun = time.monotonic()
        assert self.pump(lambda: sum(beat > begun for beat in self.app.beats[-n:]) == n)
        self.root.update_idletasks()

    def key(self, sequence: str, widget: tk.Misc | None = None) -> None:
        """Press a key where the focus is."""
        target = widget or self.root.focus_get() or self.root
        target.event_generate(f"<{sequence}>")
        self.events()

    def type(self, text: str) -> None:
        """Type into what has the focus."""
        for letter in text:
            name = {" ": "space", ".": "period", "/": "slash", "-": "minus"}.get(letter, letter)
            self.key(f"Key-{name}")

    def connected(self) -> None:
        """Wait for live pictures."""
        ready = self.pump(lambda: self.app.live.picture is not None and self.app.devices.plan)
        assert ready, self.log

    def said(self, words: str) -> bool:
        """Whether the log says something."""
        return any(words in text for _, _, text in self.log)

    @property
    def log(self) -> list[tuple[str, str, str]]:
        """The log's lines."""
        return self.app.log.lines

    def grab(self) -> Image.Image:
        """Return the window's pixels."""
        self.root.update_idletasks()
        self.events()
        x, y = self.root.winfo_rootx(), self.root.winfo_rooty()
        size = (self.root.winfo_width(), self.root.winfo_height())
        return self.display.grab().crop((x, y, x + size[0], y + size[1]))

    def close(self) -> None:
        """Close the window, and free the root in this thread; no other one may have called Tk."""
        self.app.close()
        del self.app, self.root
        gc.collect()
        assert self.calls_of_other_threads == []


def widgets(root: tk.Misc) -> Iterator[tk.Misc]:
    """Every widget of the window that is on the screen."""
    for child in root.winfo_children():
        if child.winfo_ismapped():
            yield child
            yield from widgets(child)


def tab_order(window: Window) -> set[str]:
    """The widgets that Tab comes to, from the first round to where it began."""
    seen: list[str] = []
    widget = window.app.tabs
    widget.focus_force()
    for _ in range(300):
        widget = widget.tk_focusNext()
        if str(widget) in seen:
            break
        seen.append(str(widget))
    return set(seen)


def controls(window: Window) -> list[tk.Misc]:
    """Everything on the screen that can be used now."""
    classes = ("TButton", "TEntry", "TSpinbox", "TCombobox", "TCheckbutton", "TScale", "Treeview")
    return [
        widget
        for widget in widgets(window.root)
        if widget.winfo_class() in classes and "disabled" not in widget.state()
    ]


def clipped(window: Window) -> list[str]:
    """Words and controls that have less room than they ask for, or reach over their parent."""
    found = []
    for widget in widgets(window.root):
        if widget.winfo_class() not in ("TLabel", "TButton", "TCheckbutton", "TEntry", "TSpinbox"):
            continue
        wide = widget.winfo_reqwidth() - widget.winfo_width()
        high = widget.winfo_reqheight() - widget.winfo_height()
        parent = widget.nametowidget(widget.winfo_parent())
        over = widget.winfo_x() + widget.winfo_width() - parent.winfo_width()
        below = widget.winfo_y() + widget.winfo_height() - parent.winfo_height()
        typed = widget.winfo_class() in ("TEntry", "TSpinbox")  # these share what room there is
        if max(0 if typed else wide, high, over, below) > 1:
            text = "" if typed else widget.cget("text")
            found.append(f"{widget} {text!r}: {wide} {high} {over} {below}")
    return found


def overlapping(window: Window) -> list[str]:
    """Pairs of words or controls of one parent that lie over one another."""
    found = []
    parents: dict[str, list[tk.Misc]] = {}
    for widget in widgets(window.root):
        if widget.winfo_manager() != "place":  # that is meant to lie over something
            parents.setdefault(widget.winfo_parent(), []).append(widget)
    for children in parents.values():
        boxes = [(w, w.winfo_x(), w.winfo_y(), w.winfo_width(), w.winfo_height()) for w in children]
        for k, (one, x, y, width, height) in enumerate(boxes):
            for other, left, top, wide, high in boxes[k + 1 :]:
                across = min(x + width, left + wide) - max(x, left)
                down = min(y + height, top + high) - max(y, top)
                if min(across, down) > 1:
                    found.append(f"{one} over {other}")
    return found


def strike(window: Window, kind: str, times: int = 1, shot: str | None = None) -> None:
    """Let a fault strike the simulated rig from now on."""
    script = FaultScript([Fault(kind=kind, times=times, shot=shot)])
    done = threading.Event()

    def inject(station: Station) -> None:
        station._rig._world.faults._faults = script._faults
        station._rig._world.faults._left = script._left
        done.set()

    window.app.devices.door.ask(inject)
    assert window.pump(done.is_set)


def shown_of(root: Path, number: int = 0) -> Shown:
    """What the window shows of a session of a data root, the oldest first."""
    from labrig.station.showing import show  # noqa: PLC0415 - the solvers load with it

    return show(sorted(root.glob("*/*"))[number])
