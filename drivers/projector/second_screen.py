"""A projector as a second screen: a process of its own shows the patterns on one output."""

from __future__ import annotations

import fcntl
import hashlib
import os
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from drivers.errors import (
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.projector.protocol import Image, PatternHandle, ProjectorCapabilities, ShowReceipt
from drivers.projector.window_process import WindowProcess
from drivers.transport.x_display import (
    Output,
    draw_curtain,
    has_compositor,
    lift_curtain,
    outputs,
)
from drivers.waiting import CancelToken

LOAD_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScreenSettings:
    """Where the projector is plugged, and what was measured of it.

    Attributes
    ----------
    output : name of the output as ``labrig devices`` lists it
    rows, cols : native size, px; an output of another size is refused
    refresh_hz : needed only where the X server does not say
    latency_s, settle_s, calibrated : see `ProjectorCapabilities`
    allow_compositor : take a screen that a compositor redraws
    black_after : leave the output black after `close`; else its desktop comes back
    """

    output: str
    rows: int
    cols: int
    display: str = ""
    refresh_hz: float | None = None
    latency_s: tuple[float, float] = (0.0, 0.1)
    settle_s: float = 0.05
    calibrated: str | None = None
    colour_wheel: bool = False
    gamma_note: str = ""
    allow_compositor: bool = False
    black_after: bool = True


class ScreenProjector:
    """Shows images on a named output, one pixel of the image on one pixel of the output."""

    def __init__(self, settings: ScreenSettings) -> None:
        self._settings = settings
        self._display = settings.display or os.environ.get("DISPLAY", "")
        self._output: Output | None = None
        self._window: WindowProcess | None = None
        self._lock: IO[str] | None = None
        self._handles: tuple[PatternHandle, ...] = ()
        self._current: PatternHandle | None = None

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``; a screen has no more than its output's name."""
        return {"model": "second screen", "serial": self._settings.output, "firmware": ""}

    def open(self) -> ProjectorCapabilities:
        """Put a black window on the output; say what the projector can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError, SettingRefusedError
            If the output is not there, used already, or not shown pixel for pixel.
        """
        output = find_output(self._display, self._settings.output)
        refresh_hz = self._refuse_unfit(output)
        self._lock = _lock(self._display, output.name)
        try:
            draw_curtain(self._display, output)
            self._window = WindowProcess(self._display, output)
            found = self._window.start()
            _refuse_moved(output, found)
        except BaseException:
            self.close()
            raise
        self._output, self._handles, self._current = output, (), None
        return ProjectorCapabilities(
            rows=output.height,
            cols=output.width,
            refresh_hz=refresh_hz,
            latency_s=self._settings.latency_s,
            settle_s=self._settings.settle_s,
            calibrated=self._settings.calibrated,
            colour_wheel=self._settings.colour_wheel,
            gamma_note=self._settings.gamma_note,
        )

    def close(self) -> None:
        """Go black and disconnect; harmless if done twice, never raises."""
        window, self._window = self._window, None
        if window is not None:
            window.stop()
        if self._lock is not None:
            if not self._settings.black_after:
                with suppress(DriverError):
                    lift_curtain(self._display, self._settings.output)
            self._lock.close()
            self._lock = None
        self._current = None

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, the output's read back from the X server."""
        self._opened()
        output = find_output(self._display, self._settings.output)
        return {
            **asdict(self._settings),
            "display": self._display,
            "geometry": asdict(output),
            "compositor": has_compositor(self._display),
        }

    def load(self, images: Sequence[Image]) -> tuple[PatternHandle, ...]:
        """Take (rows, cols) uint8 images of native size, in place of those loaded before.

        Raises
        ------
        SettingRefusedError
            If size or depth do not fit; nothing is scaled.
        """
        window, output = self._opened()
        native = (output.height, output.width)
        for image in images:
            if image.shape != native or image.dtype != np.uint8:
                msg = (
                    f"image of {image.shape} {image.dtype} on a projector of {native} uint8: it is "
                    "never scaled; draw it in native size."
                )
                raise SettingRefusedError(msg)
        self._ask(window, "clear")
        self._current = None
        handles = []
        for index, image in enumerate(images):
            pixels = np.ascontiguousarray(image).tobytes()
            answer = self._ask(window, "load", payload=pixels)
            if answer["digest"] != hashlib.sha256(pixels).hexdigest():
                msg = f"image {index} reached the projector's window damaged; load it again."
                raise DeviceLostError(msg)
            handles.append(PatternHandle(index=index, digest=answer["digest"]))
        self._handles = tuple(handles)
        return self._handles

    def show(self, handle: PatternHandle, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:
        """Show a loaded image and say when its light can have come.

        Raises
        ------
        SettingRefusedError, DeadlineError, DeviceLostError, CancelledError
        """
        self._opened()
        if handle not in self._handles:
            msg = (
                f"image {handle.index} of digest {handle.digest[:8]} is not loaded; load it first."
            )
            raise SettingRefusedError(msg)
        return self._show(handle, deadline_s, cancel)

    def black(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:
        """Show level 0 everywhere; its leak remains. Raises as `show`."""
        return self._show(None, deadline_s, cancel)

    def lamp_off(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:  # noqa: ARG002
        """Refuse: no X server can switch a lamp.

        Raises
        ------
        SettingRefusedError
        """
        msg = "a second screen cannot switch its lamp; cover the projector's lens instead."
        raise SettingRefusedError(msg)

    def current(self) -> PatternHandle | None:
        """Return what is shown; None for black."""
        return self._current

    def make_safe(self) -> None:
        """Go black whatever the state; a window that does not answer is removed."""
        if self._window is None:
            return
        try:
            self.black(deadline_s=time.monotonic() + 1.0, cancel=CancelToken())
        except DriverError:
            self._window.kill()
        self._current = None

    def _show(
        self, handle: PatternHandle | None, deadline_s: float, cancel: CancelToken
    ) -> ShowReceipt:
        window, _ = self._opened()
        cancel.check()
        requested_s = time.monotonic()
        index = None if handle is None else handle.index
        answer = window.ask("show", {"index": index}, deadline_s=deadline_s, cancel=cancel)
        self._current = handle
        if answer["obscured"]:
            msg = f"another window covers output {self._settings.output}; close or move it."
            raise DeviceLostError(msg)
        low_s, high_s = self._settings.latency_s
        return ShowReceipt(
            handle=handle,
            requested_s=requested_s,
            earliest_s=answer["begin_s"] + low_s,
            latest_s=answer["drawn_s"] + high_s,
        )

    def _ask(self, window: WindowProcess, order: str, *, payload: bytes = b"") -> dict[str, Any]:
        limit_s = time.monotonic() + LOAD_S
        return window.ask(order, {}, payload=payload, deadline_s=limit_s, cancel=CancelToken())

    def _refuse_unfit(self, output: Output) -> float:
        """Return the refresh rate of an output that shows pixel for pixel.

        Raises
        ------
        SettingRefusedError
            If it does not.
        """
        s = self._settings
        refresh_hz = s.refresh_hz if output.refresh_hz is None else output.refresh_hz
        reason = ""
        if (output.height, output.width) != (s.rows, s.cols):
            reason = (
                f"is {output.width}x{output.height}, {s.cols}x{s.rows} was wanted: set its mode"
            )
        elif output.scaled:
            reason = "is scaled by the X server: xrandr --output NAME --scale 1x1"
        elif os.environ.get("XDG_SESSION_TYPE") == "wayland" and not s.display:
            reason = (
                "is drawn by a Wayland compositor, which may scale it: log in to an Xorg session"
            )
        elif not s.allow_compositor and has_compositor(self._display):
            reason = "is redrawn by a compositor: stop it, or set allow_compositor in the rig file"
        elif refresh_hz is None:
            reason = "does not say its refresh rate: set refresh_hz in the rig file"
        if reason or refresh_hz is None:
            msg = f"output {s.output} {reason}."
            raise SettingRefusedError(msg)
        return refresh_hz

    def _opened(self) -> tuple[WindowProcess, Output]:
        if self._window is None or self._output is None:
            msg = f"the projector on output {self._settings.output} is not open; call open() first."
            raise NotOpenError(msg)
        return self._window, self._output


def find_output(display: str, name: str) -> Output:
    """Return the named output of a display.

    Raises
    ------
    DeviceNotFoundError
        If there is no such output; the message lists those that are there.
    """
    found = outputs(display)
    for output in found:
        if output.name == name:
            return output
    there = ", ".join(f"{o.name} ({o.width}x{o.height})" for o in found) or "none"
    msg = f"output {name!r} is not on display {display}; there are: {there}."
    raise DeviceNotFoundError(msg)


def _refuse_moved(output: Output, found: dict[str, Any]) -> None:
    wanted = {key: getattr(output, key) for key in ("x", "y", "width", "height")}
    if any(found[key] != value for key, value in wanted.items()):
        msg = f"the window lies at {found}, {wanted} was wanted; is a window manager moving it?"
        raise SettingRefusedError(msg)
    if found["depth"] < 24 or found["visual"] != "truecolor":
        msg = (
            f"output {output.name} has {found['depth']} bits {found['visual']}, 24 bits truecolor "
            "are wanted: grey levels would be merged; set DefaultDepth 24."
        )
        raise SettingRefusedError(msg)


def _lock(display: str, output_name: str) -> IO[str]:
    """Hold the output for this process.

    Raises
    ------
    DeviceBusyError
        If another process holds it.
    """
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    safe = "".join(c if c.isalnum() else "-" for c in f"{display}-{output_name}")
    lock = (folder / f"labrig-screen-{safe}.lock").open("a+")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        msg = f"output {output_name} is used by another labrig or opened twice; close that first."
        raise DeviceBusyError(msg) from error
    return lock
