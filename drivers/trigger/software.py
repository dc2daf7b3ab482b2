"""A trigger without a box: it asks the camera, which exposes on the computer's word."""

from __future__ import annotations

from typing import Any, Protocol

from drivers.errors import SettingRefusedError
from drivers.trigger.protocol import (
    TriggerCapabilities,
    TriggerCounters,
    TriggerReceipt,
    TriggerSettings,
)
from drivers.waiting import CancelToken


class _Fires(Protocol):
    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt: ...


class SoftwareTrigger:
    """Calls the camera, and counts."""

    def __init__(self, camera: _Fires) -> None:
        self._camera = camera
        self._pulses = 0

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "software trigger", "serial": "of the camera", "firmware": "1"}

    def open(self) -> TriggerCapabilities:
        """Begin to count; the camera has the connection."""
        self._pulses = 0
        return TriggerCapabilities(pulse_range_s=(0.0, 1e-3), delay_range_s=(0.0, 0.0))

    def close(self) -> None:
        """Do nothing: the camera has the connection."""

    def snapshot(self) -> dict[str, Any]:
        """Return nothing: there is nothing to set."""
        return {}

    def configure(self, settings: TriggerSettings) -> TriggerSettings:
        """Refuse a delay and another source, which a camera's own trigger has not."""
        if settings.delay_s or settings.source != "host":
            msg = f"{settings}: a software trigger has no delay and no source but the host."
            raise SettingRefusedError(msg)
        return settings

    def fire(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:
        """Let the camera expose once."""
        receipt = self._camera.trigger(deadline_s=deadline_s, cancel=cancel)
        self._pulses += 1
        return receipt

    def counters(self) -> TriggerCounters:
        """Return how often the camera was asked and did not refuse."""
        return TriggerCounters(pulses=self._pulses)

    def make_safe(self) -> None:
        """Do nothing: a camera that is disarmed is not triggered."""
