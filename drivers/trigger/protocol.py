"""What every trigger is to the rest of the program: a box on a wire, or the camera's own.

All instants are on the host's monotonic clock, in seconds. A call that may block takes an instant
``deadline_s`` and a cancel token, keeps the first within a fifth and the second within 0.2 s; none
waits for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from drivers.receipts import TriggerReceipt
from drivers.waiting import CancelToken

__all__ = ["Trigger", "TriggerCapabilities", "TriggerCounters", "TriggerReceipt", "TriggerSettings"]

TriggerSource = Literal["host", "projector-sync"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggerCapabilities:
    """Range of pulses and delays, sources, and how late a pulse may be after `Trigger.fire`, s."""

    pulse_range_s: tuple[float, float]
    delay_range_s: tuple[float, float]
    sources: tuple[TriggerSource, ...] = ("host",)
    latency_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggerSettings:
    """Width of a pulse, its delay after the source, and the source."""

    pulse_s: float = 1e-3
    delay_s: float = 0.0
    source: TriggerSource = "host"


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggerCounters:
    """Pulses given, camera strobes seen and projector syncs seen since `open`.

    None where a line is not wired. Read before and after a group they tell a trigger that was
    lost from a frame that was lost.
    """

    pulses: int
    strobes: int | None = None
    syncs: int | None = None


class Trigger(Protocol):
    """Gives one pulse when told to."""

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``."""

    def open(self) -> TriggerCapabilities:
        """Connect, quiet; say what the trigger can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError
            With the remedy. An open trigger is busy to a second `open`.
        """

    def close(self) -> None:
        """Go quiet and disconnect; harmless if done twice, bounded, never raises."""

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device, as JSON."""

    def configure(self, settings: TriggerSettings) -> TriggerSettings:
        """Set pulse, delay and source; return what the device really has.

        Raises
        ------
        SettingRefusedError
            If a value is out of range; nothing is clipped silently.
        """

    def fire(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:
        """Give one pulse; return when it was given.

        Raises
        ------
        TriggerNotFiredError, DeviceLostError, DeadlineError, CancelledError
        """

    def counters(self) -> TriggerCounters:
        """Return the counts since `open`; raise `DeviceLostError` if they cannot be had."""

    def make_safe(self) -> None:
        """Give no more pulses whatever the state; bounded, never raises."""
