"""A recorded session as a camera: gives out its frames again, as they were captured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.camera.protocol import (
    CameraCapabilities,
    CameraSettings,
    Flushed,
    Frame,
    TriggerMode,
)
from drivers.errors import (
    DeviceBusyError,
    NoFrameError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.receipts import TriggerReceipt
from drivers.waiting import CancelToken, Clock

SAME = 1e-3  # of an exposure: it was that one


class ReplayCamera:
    """Each trigger gives out a frame that was recorded of what is shown, at the exposure set.

    Parameters
    ----------
    recall : from an exposure in seconds to such a frame, or None if there is none; whoever reads
        the session makes it, for a driver knows no session
    exposures_s : those that were recorded
    name : of the recording
    """

    def __init__(
        self,
        recall: Callable[[float], Frame | None],
        exposures_s: tuple[float, ...],
        capabilities: CameraCapabilities,
        clock: Clock,
        name: str,
    ) -> None:
        self._recall = recall
        self._exposures_s = exposures_s
        self._capabilities = capabilities
        self._clock = clock
        self._name = name
        self._waiting: list[Frame] = []
        self._last_sequence = 0
        self._pulses = 0
        self._open = self._armed = False
        self._settings = CameraSettings(exposure_s=exposures_s[0])

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig replay", "serial": self._name, "firmware": "1"}

    def open(self) -> CameraCapabilities:
        """Make the recording ready."""
        if self._open:
            msg = "the recording is already open; close it first."
            raise DeviceBusyError(msg)
        self._open = True
        return self._capabilities

    def close(self) -> None:
        """End; harmless if done twice."""
        self.disarm()
        self._open = False

    def snapshot(self) -> dict[str, Any]:
        """Return the exposure asked for last."""
        return {"exposure_s": self._settings.exposure_s}

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Take on any exposure that was recorded; the frames say themselves which they had."""
        self._require_open()
        if all(abs(settings.exposure_s - e) > SAME * e for e in self._exposures_s):
            there = ", ".join(f"{e:g}" for e in self._exposures_s)
            msg = f"{settings.exposure_s:g} s was not recorded; there are {there} s."
            raise SettingRefusedError(msg)
        self._settings = settings
        return settings

    def arm(self, mode: TriggerMode) -> None:
        """Wait for triggers; a recording does not run by itself."""
        self._require_open()
        if mode != "software":
            msg = f"a recording cannot be armed for {mode}; use software."
            raise SettingRefusedError(msg)
        self._armed = True

    def disarm(self) -> None:
        """Give out no more frames; those that wait are lost."""
        self._armed = False
        self._waiting.clear()

    def make_safe(self) -> None:
        """Disarm whatever the state."""
        self.disarm()

    def flush(self) -> Flushed:
        """Throw away every frame that waits."""
        self._require_open()
        discarded = len(self._waiting)
        newest = max((frame.sequence for frame in self._waiting), default=self._last_sequence)
        self._waiting.clear()
        self._last_sequence = max(newest, self._last_sequence)
        return Flushed(discarded=discarded, last_sequence=self._last_sequence)

    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:  # noqa: ARG002
        """Let a frame of what is shown wait."""
        cancel.check()
        self._require_open()
        if not self._armed:
            msg = "the recording is not armed; call arm() first."
            raise SettingRefusedError(msg)
        frame = self._recall(self._settings.exposure_s)
        now = self._clock.now_s()
        self._pulses += 1
        if frame is not None:
            self._waiting.append(replace(frame, sequence=self._pulses))
        return TriggerReceipt(earliest_s=now, latest_s=now, count=self._pulses)

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the frame that waits; of what was not recorded, none comes."""
        self._require_open()
        cancel.check()
        if not self._waiting:
            self._clock.wait_until(deadline_s, cancel)
            msg = (
                f"the recording {self._name} holds no frame of this picture at "
                f"{self._settings.exposure_s:g} s; run the plan that it was captured by."
            )
            raise NoFrameError(msg)
        frame = self._waiting.pop(0)
        self._last_sequence = max(self._last_sequence, frame.sequence)
        return frame

    def _require_open(self) -> None:
        if not self._open:
            msg = "the recording is not open; call open() first."
            raise NotOpenError(msg)
