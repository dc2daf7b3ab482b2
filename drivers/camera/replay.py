"""A recorded session as a camera: gives out its frames again, in order, as they were captured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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


class ReplayCamera:
    """Each trigger gives out the next recorded frame; the recording's end is a missing frame.

    ``frames`` are those of a session in the order they were taken; whoever reads the session
    makes them, for a driver knows no session.
    """

    def __init__(
        self, frames: Sequence[Frame], capabilities: CameraCapabilities, clock: Clock
    ) -> None:
        self._frames = frames
        self._capabilities = capabilities
        self._clock = clock
        self._left: Iterator[Frame] = iter(())
        self._waiting: list[Frame] = []
        self._last_sequence = 0
        self._pulses = 0
        self._open = self._armed = False
        self._settings = CameraSettings(exposure_s=capabilities.exposure_range_s[0])

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig replay", "serial": f"{len(self._frames)} frames", "firmware": "1"}

    def open(self) -> CameraCapabilities:
        """Begin at the first frame."""
        if self._open:
            msg = "the recording is already open; close it first."
            raise DeviceBusyError(msg)
        self._open = True
        self._left = iter(self._frames)
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
        recorded = sorted({f.exposure_s for f in self._frames if f.exposure_s is not None})
        if all(abs(settings.exposure_s - e) > 1e-3 * e for e in recorded):
            msg = f"{settings.exposure_s} s was not recorded; there are {recorded} s."
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
        """Let the next frame of the recording wait."""
        cancel.check()
        self._require_open()
        if not self._armed:
            msg = "the recording is not armed; call arm() first."
            raise SettingRefusedError(msg)
        frame = next(self._left, None)
        if frame is not None:
            self._waiting.append(frame)
        now = self._clock.now_s()
        self._pulses += 1
        return TriggerReceipt(earliest_s=now, latest_s=now, count=self._pulses)

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the frame that waits; where the recording is over, none comes."""
        self._require_open()
        cancel.check()
        if not self._waiting:
            self._clock.wait_until(deadline_s, cancel)
            msg = "the recording has no frame left; was it triggered more often than captured?"
            raise NoFrameError(msg)
        frame = self._waiting.pop(0)
        self._last_sequence = max(self._last_sequence, frame.sequence)
        return frame

    def _require_open(self) -> None:
        if not self._open:
            msg = "the recording is not open; call open() first."
            raise NotOpenError(msg)
