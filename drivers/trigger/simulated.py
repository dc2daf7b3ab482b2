"""A trigger box in the simulated world, wired to every camera there."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from drivers.errors import (
    DeviceBusyError,
    NotOpenError,
    SettingRefusedError,
    TriggerNotFiredError,
)
from drivers.simulation.world import World
from drivers.trigger.protocol import (
    TriggerCapabilities,
    TriggerCounters,
    TriggerReceipt,
    TriggerSettings,
)
from drivers.waiting import CancelToken


class SimulatedTrigger:
    """Raises the world's trigger line ``latency_s`` after it was told to."""

    def __init__(self, world: World, *, latency_s: float = 1e-4) -> None:
        self._world = world
        self._can = TriggerCapabilities(
            pulse_range_s=(1e-6, 1.0), delay_range_s=(0.0, 10.0), latency_s=latency_s
        )
        self._settings = TriggerSettings()
        self._open = False
        self._pulses = 0

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig simulated trigger", "serial": "sim", "firmware": "1"}

    def open(self) -> TriggerCapabilities:
        """Connect, quiet; say what the trigger can do."""
        if self._open:
            msg = "the simulated trigger is already open; close it first."
            raise DeviceBusyError(msg)
        self._open, self._pulses = True, 0
        return self._can

    def close(self) -> None:
        """Go quiet and disconnect; harmless if done twice."""
        self._open = False

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""
        return {**asdict(self._settings), "latency_s": self._can.latency_s}

    def configure(self, settings: TriggerSettings) -> TriggerSettings:
        """Set pulse, delay and source; return what the device really has."""
        self._require_open()
        for name, value, (low, high) in (
            ("pulse_s", settings.pulse_s, self._can.pulse_range_s),
            ("delay_s", settings.delay_s, self._can.delay_range_s),
        ):
            if not low <= value <= high:
                msg = f"{name} = {value} is outside {low} .. {high} s; change the rig file."
                raise SettingRefusedError(msg)
        if settings.source not in self._can.sources:
            msg = f"source {settings.source!r} is none of {', '.join(self._can.sources)}."
            raise SettingRefusedError(msg)
        self._settings = settings
        return settings

    def fire(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:  # noqa: ARG002
        """Give one pulse; return when it was given."""
        cancel.check()
        self._require_open()
        now = self._world.clock.now_s()
        edge_s = now + self._can.latency_s + self._settings.delay_s
        if self._world.faults.strikes("stuck-trigger"):
            msg = "the simulated trigger is stuck; it gave no pulse."
            raise TriggerNotFiredError(msg)
        if not self._world.faults.strikes("silent-trigger"):
            self._pulses += 1
            self._world.edge(edge_s)
        return TriggerReceipt(earliest_s=now, latest_s=edge_s, count=self._pulses)

    def counters(self) -> TriggerCounters:
        """Return the count since `open`."""
        self._require_open()
        return TriggerCounters(pulses=self._pulses)

    def make_safe(self) -> None:
        """Give no more pulses: this one gives none by itself."""

    def _require_open(self) -> None:
        if not self._open:
            msg = "the simulated trigger is not open; call open() first."
            raise NotOpenError(msg)
