"""Makes the real devices that a rig file names, ours and those of third parties."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

from drivers.camera.genicam import GenicamCamera, GenicamSettings
from drivers.camera.protocol import Camera
from drivers.camera.v4l2 import V4l2Camera, V4l2Settings
from drivers.projector.protocol import Projector
from drivers.projector.second_screen import ScreenProjector, ScreenSettings
from drivers.simulation.faults import FaultScript
from drivers.trigger.protocol import Trigger
from drivers.trigger.serial import SerialTrigger
from drivers.trigger.usb import UsbTrigger
from drivers.waiting import Clock, MonotonicClock
from labrig.errors import ConfigError, RunError
from labrig.models.devices import (
    GenicamCameraConfig,
    PluginCameraConfig,
    PluginProjectorConfig,
    PluginTriggerConfig,
    ScreenProjectorConfig,
    SerialTriggerConfig,
    UsbTriggerConfig,
    V4l2CameraConfig,
)
from labrig.models.latency import LatencyRecord

CameraEntry = V4l2CameraConfig | GenicamCameraConfig | PluginCameraConfig
ProjectorEntry = ScreenProjectorConfig | PluginProjectorConfig
TriggerEntry = SerialTriggerConfig | UsbTriggerConfig | PluginTriggerConfig


class RealWorld:
    """The world as it is: real time, a lens cap in the operator's hand, no scripted faults.

    Parameters
    ----------
    ask : called with True to cover the lens and with False to uncover it, returns when it is done
    """

    def __init__(self, ask: Callable[[bool], None]) -> None:
        self.clock: Clock = MonotonicClock()
        self.faults = FaultScript(())
        self._ask = ask
        self._covered = False

    @property
    def covered(self) -> bool:
        """Whether the lens is covered."""
        return self._covered

    @covered.setter
    def covered(self, wanted: bool) -> None:
        if wanted != self._covered:
            self._ask(wanted)
        self._covered = wanted


def ask_operator(covered: bool) -> None:
    """Ask on the terminal to cover or uncover the lens, and wait for Enter.

    Raises
    ------
    RunError
        If nobody is there to answer.
    """
    if not sys.stdin.isatty():
        msg = (
            "this plan has shots with a covered lens and no operator at a terminal to cover it; "
            "run it from a terminal, or leave the dark set out and import dark frames."
        )
        raise RunError(msg)
    word = "Cover" if covered else "Uncover"
    sys.stderr.write(f"{word} the camera's lens, then press Enter: ")
    sys.stderr.flush()
    sys.stdin.readline()


def make_camera(entry: CameraEntry) -> Camera:
    """Return the camera of a rig file, not yet open."""
    if isinstance(entry, PluginCameraConfig):
        camera: Camera = _plugin("labrig.cameras", entry.name, entry.settings)
        return camera
    common: dict[str, Any] = {
        "device": entry.device,
        "pixel_format": entry.pixel_format,
        "exposure_latency_frames": entry.exposure_latency_frames,
        "uncertainty_s": entry.uncertainty_s,
        "shutter": "rolling" if entry.row_time_s else "global",
        "row_time_s": entry.row_time_s,
        "queue_depth": entry.queue_depth,
    }
    if isinstance(entry, GenicamCameraConfig):
        return GenicamCamera(
            GenicamSettings(
                **common,
                trigger_line=entry.trigger_line,
                readout_s=entry.readout_s,
                size=(entry.cols, entry.rows),
            )
        )
    return V4l2Camera(
        V4l2Settings(
            **common,
            size=(entry.cols, entry.rows),
            controls=entry.controls,
            timestamp=entry.timestamp,
            allow_uncalibrated=entry.allow_uncalibrated,
        )
    )


def make_projector(entry: ProjectorEntry, latency: LatencyRecord | None) -> Projector:
    """Return the projector of a rig file, not yet open, with its latency as last measured."""
    if isinstance(entry, PluginProjectorConfig):
        projector: Projector = _plugin("labrig.projectors", entry.name, entry.settings)
        return projector
    bounds = (entry.latency_s, entry.latency_s + entry.jitter_s + 1.0 / entry.refresh_hz)
    return ScreenProjector(
        ScreenSettings(
            output=entry.output,
            rows=entry.rows,
            cols=entry.cols,
            display=entry.display,
            refresh_hz=entry.refresh_hz,
            latency_s=bounds if latency is None else (latency.earliest_s, latency.latest_s),
            settle_s=entry.settle_s if latency is None else latency.settle_s,
            calibrated=None if latency is None else latency.date,
            allow_compositor=entry.compositor == "accepted",
            black_after=entry.after == "black",
        )
    )


def make_trigger(entry: TriggerEntry) -> Trigger:
    """Return the trigger box of a rig file, not yet open."""
    if isinstance(entry, PluginTriggerConfig):
        trigger: Trigger = _plugin("labrig.triggers", entry.name, entry.settings)
        return trigger
    if isinstance(entry, UsbTriggerConfig):
        return UsbTrigger(
            vendor_id=entry.vendor_id,
            product_id=entry.product_id,
            serial=entry.serial,
            watchdog_s=entry.watchdog_s,
        )
    return SerialTrigger(entry.port, baud=entry.baud, watchdog_s=entry.watchdog_s)


def plugins() -> list[str]:
    """Return the installed drivers of third parties, with their kind."""
    kinds = ("cameras", "projectors", "triggers")
    return [
        f"{point.name} ({kind})"
        for kind in kinds
        for point in sorted(entry_points(group=f"labrig.{kind}"), key=lambda p: p.name)
    ]


def _plugin(group: str, name: str, settings: dict[str, Any]) -> Any:
    """Return what a third party's factory makes of its settings.

    Raises
    ------
    ConfigError
        If no driver of this name is installed.
    """
    known = {point.name: point for point in entry_points(group=group)}
    if name not in known:
        there = ", ".join(sorted(known)) or "none"
        msg = f"no driver {name!r} is registered for {group}; installed: {there}; pip install it."
        raise ConfigError(msg)
    return known[name].load()(**settings)
