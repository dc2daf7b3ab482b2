"""What every camera is to the rest of the program.

All instants are on the host's monotonic clock, in seconds. A call that may block takes an instant
``deadline_s`` and a cancel token, keeps the first within a fifth and the second within 0.2 s; none
waits for ever.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.receipts import TriggerReceipt
from drivers.waiting import CancelToken

TriggerMode = Literal["free-run", "software", "external"]
TimestampSource = Literal["start", "end", "arrival", "none"]
FrameFlag = Literal["error", "truncated"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCapabilities:
    """What a camera can do.

    Attributes
    ----------
    rows, cols : the whole sensor, px
    bits, white_level_dn : depth of the present format; counts at the white level are clipped
    exposure_range_s, exposure_step_s : a step of 0 is a continuum
    gain_range_db : both ends alike if the gain is fixed
    formats : names of pixel formats, the preferred one first
    trigger_modes : those `Camera.arm` takes
    queue_depth : frames that may wait uncollected
    exposure_latency_frames : whole frames that still have the old exposure after `Camera.apply`
    readout_s : from the end of an exposure to the arrival of its frame, at most
    shutter, row_time_s : of a rolling shutter, each row begins this much after the one above
    timestamp_source : what the camera's own time stamps mean; "none" if they cannot be trusted
    uncertainty_s : of ``t_start_s`` and ``t_end_s`` of a frame
    """

    rows: int
    cols: int
    bits: int
    white_level_dn: int
    exposure_range_s: tuple[float, float]
    readout_s: float
    exposure_step_s: float = 0.0
    gain_range_db: tuple[float, float] = (0.0, 0.0)
    formats: tuple[str, ...] = ("mono16",)
    trigger_modes: tuple[TriggerMode, ...] = ("software",)
    queue_depth: int = 4
    exposure_latency_frames: int = 0
    shutter: Literal["global", "rolling"] = "global"
    row_time_s: float = 0.0
    timestamp_source: TimestampSource = "start"
    uncertainty_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """All that is set before frames are taken; what a device returns is what it really has.

    ``roi`` is x, y, width, height in px, None for the whole sensor; ``pixel_format`` None keeps
    the preferred one. Automatic functions are always off.
    """

    exposure_s: float
    gain_db: float = 0.0
    roi: tuple[int, int, int, int] | None = None
    pixel_format: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Flushed:
    """What a flush found: frames thrown away, and the number of the newest frame ever seen."""

    discarded: int
    last_sequence: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One picture, owned and read-only, with when and how it was exposed.

    Attributes
    ----------
    pixels : (rows, cols) uint16, counts (DN)
    sequence : rises by one with every frame of the sensor, lost ones too
    t_start_s, t_end_s : begin of the first row and end of the last, each sure to
        ``uncertainty_s``; None from a camera whose timestamp source is "none"
    t_arrival_s : when the host had the frame
    exposure_s, gain_db : as the camera reports them *for this frame*; None if it reports none
    flags : what the driver says is wrong with the picture
    extras : what else the driver knows, as JSON
    """

    pixels: NDArray[np.uint16]
    sequence: int
    t_start_s: float | None
    t_end_s: float | None
    t_arrival_s: float
    uncertainty_s: float = 0.0
    exposure_s: float | None = None
    gain_db: float | None = None
    flags: frozenset[FrameFlag] = frozenset()
    extras: dict[str, Any] = field(default_factory=dict)


class Camera(Protocol):
    """A monochrome area camera. A frame is never an error: errors are exceptions."""

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``."""

    def open(self) -> CameraCapabilities:
        """Connect, disarmed; say what the camera can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError
            With the remedy. An open camera is busy to a second `open`.
        """

    def close(self) -> None:
        """Disarm and disconnect; harmless if done twice, bounded, never raises."""

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device, as JSON."""

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set everything, automatic functions off; return what the device really has.

        Raises
        ------
        SettingRefusedError
            If a value is out of range; nothing is clipped silently.
        """

    def arm(self, mode: TriggerMode) -> None:
        """Begin to take frames: by itself, at `trigger`, or at an external edge."""

    def disarm(self) -> None:
        """Take no more frames; harmless if not armed. Queued frames are lost."""

    def flush(self) -> Flushed:
        """Throw away every frame that waits, without waiting for another."""

    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:
        """Start one exposure in mode "software"; return at once, not when it has ended.

        Raises
        ------
        TriggerNotFiredError, DeviceLostError, DeadlineError, CancelledError
        """

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the oldest frame that waits, or wait for the next.

        Raises
        ------
        NoFrameError, FrameCorruptError, DeviceLostError, CancelledError
        """

    def make_safe(self) -> None:
        """Disarm whatever the state; bounded, never raises."""
