"""A camera of the kernel's video subsystem: UVC cameras, laptop cameras, frame grabbers."""

from __future__ import annotations

import errno
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from drivers.camera.pixel_formats import MJPEG, V4L2_FORMATS, PixelFormat, decode
from drivers.camera.protocol import (
    CameraCapabilities,
    CameraSettings,
    Flushed,
    Frame,
    TimestampSource,
    TriggerMode,
)
from drivers.camera.v4l2_controls import EXPOSURE_ABSOLUTE, EXPOSURE_UNIT_S, Controls
from drivers.errors import (
    DeviceBusyError,
    DeviceLostError,
    DriverError,
    FrameCorruptError,
    NoFrameError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.receipts import TriggerReceipt
from drivers.transport.v4l2_device import DeviceInfo, FrameFormat, VideoDevice, open_device
from drivers.transport.v4l2_stream import Filled, Stream
from drivers.waiting import SLICE_S, CancelToken


@dataclass(frozen=True, slots=True, kw_only=True)
class V4l2Settings:
    """Which camera, and what the kernel cannot know of it.

    Attributes
    ----------
    device : best a link in /dev/v4l/by-id, which survives a replug
    pixel_format : None for the deepest grey format the camera has
    size : width and height, px; None for the present ones
    controls : further controls by name, such as ``{gain: 0}``
    exposure_latency_frames : as `V4l2Camera.probe` measures it
    timestamp : what the camera's time stamp marks; None as it declares
    uncertainty_s : of that time stamp
    shutter, row_time_s : of a rolling shutter; None for a whole frame interval over the rows
    allow_uncalibrated : take a format whose counts are not proportional to light
    """

    device: str
    pixel_format: str | None = None
    size: tuple[int, int] | None = None
    controls: Mapping[str, int] = field(default_factory=dict)
    exposure_latency_frames: int = 3
    timestamp: Literal["start", "end"] | None = None
    uncertainty_s: float = 0.005
    shutter: Literal["global", "rolling"] = "rolling"
    row_time_s: float | None = None
    queue_depth: int = 4
    allow_uncalibrated: bool = False


class V4l2Camera:
    """A camera that runs freely; frames are told apart by sequence number and time stamp."""

    def __init__(self, settings: V4l2Settings) -> None:
        self._settings = settings
        self._device: VideoDevice | None = None
        self._controls: Controls | None = None
        self._stream: Stream | None = None
        self._info = DeviceInfo(driver="", card="", bus="")
        self._format = FrameFormat(width=0, height=0, letters="", stride=0, interval_s=1.0)
        self._pixels = V4L2_FORMATS[0]
        self._exposure_s = 0.0
        self._last_sequence = -1

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``; its serial is its place on the bus."""
        return {"model": self._info.card, "serial": self._info.bus, "firmware": self._info.driver}

    def open(self) -> CameraCapabilities:
        """Connect, disarmed, automatic functions off; say what the camera can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError, AccessDeniedError, SettingRefusedError
            With the remedy.
        """
        if self._device is not None:
            msg = f"camera {self._settings.device} is open already; close it first."
            raise DeviceBusyError(msg)
        device = open_device(self._settings.device)
        try:
            self._info = device.info()
            self._device, self._controls = device, Controls(device.node)
            self._set_format(self._settings.pixel_format, None)
            self._controls.automatics_off()
            for name, value in self._settings.controls.items():
                self._controls.set(name, value)
        except OSError as error:
            self.close()
            raise self._explained(error, "set up") from error
        except DriverError:
            self.close()
            raise
        self._exposure_s = self._read_exposure()
        return self._capabilities()

    def close(self) -> None:
        """Disarm and disconnect; harmless if done twice, never raises."""
        self.disarm()
        device, self._device, self._controls = self._device, None, None
        if device is not None:
            with suppress(OSError):
                device.node.close()

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device."""
        device, controls = self._opened()
        try:
            fmt = device.frame_format()
        except OSError as error:
            raise self._explained(error, "read") from error
        return {
            "device": self._settings.device,
            "format": asdict(fmt),
            "pixel_format": self._pixels.name,
            "pixel_format_note": self._pixels.note,
            "exposure_s": self._read_exposure(),
            "exposure_control": controls.has(EXPOSURE_ABSOLUTE),
            "controls": controls.snapshot(),
        }

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set everything; return what the device really has.

        The exposure is the nearest whole step of 100 us. V4L2 gives gain no unit: set the raw
        control in the rig file, and 0 dB is that.

        Raises
        ------
        SettingRefusedError
            If a value is out of range; format and region cannot change while armed.
        """
        _, controls = self._opened()
        if settings.gain_db != 0.0:
            msg = f"gain {settings.gain_db} dB is not known to V4L2; set a raw control in the rig."
            raise SettingRefusedError(msg)
        self._set_exposure(controls, settings.exposure_s)
        wanted = settings.pixel_format or self._settings.pixel_format or self._pixels.name
        if wanted != self._pixels.name or settings.roi != self._format.roi:
            if self._stream is not None:
                msg = "format and region of a V4L2 camera cannot change while it streams; disarm."
                raise SettingRefusedError(msg)
            try:
                self._set_format(wanted, settings.roi)
            except OSError as error:
                raise self._explained(error, "set the format of") from error
        return replace(
            settings,
            exposure_s=self._exposure_s,
            roi=self._format.roi,
            pixel_format=self._pixels.name,
        )

    def arm(self, mode: TriggerMode) -> None:
        """Begin to take frames by itself.

        Raises
        ------
        SettingRefusedError
            For another mode than free-run, or if the stream does not start.
        DeviceBusyError, DeviceLostError
        """
        device, _ = self._opened()
        if mode != "free-run":
            msg = f"a V4L2 camera runs freely and cannot be armed for {mode}; choose free-run."
            raise SettingRefusedError(msg)
        self.disarm()
        try:
            self._stream = Stream(device.node, depth=self._settings.queue_depth)
        except OSError as error:
            raise self._explained(error, "start") from error
        self._last_sequence = -1

    def disarm(self) -> None:
        """Take no more frames; queued frames are lost."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.stop()

    def flush(self) -> Flushed:
        """Throw away every frame that waits, without waiting for another."""
        stream = self._armed()
        discarded = 0
        # A camera faster than this loop must not keep it here.
        for _ in range(2 * stream.depth):
            filled = self._take(stream, copy=False)
            if filled is None:
                break
            discarded += 1
        return Flushed(discarded=discarded, last_sequence=self._last_sequence)

    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:  # noqa: ARG002
        """Refuse: V4L2 has no software trigger.

        Raises
        ------
        SettingRefusedError
        """
        msg = "a V4L2 camera has no software trigger; arm it for free-run."
        raise SettingRefusedError(msg)

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the oldest frame that waits, or wait for the next.

        Raises
        ------
        NoFrameError, FrameCorruptError, DeviceLostError, CancelledError
        """
        stream = self._armed()
        while True:
            cancel.check()
            before = self._last_sequence
            filled = self._take(stream)
            if filled is not None:
                return self._frame(filled, lost=max(filled.sequence - before - 1, 0))
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                msg = (
                    f"no frame from {self._settings.device} before the deadline; check the cable "
                    "and that no exposure is longer than the wait."
                )
                raise NoFrameError(msg)
            if stream.wait(min(left_s, SLICE_S)):
                cancel.wait(1e-3)  # poll also returns for a device in error, at once and always

    def make_safe(self) -> None:
        """Disarm whatever the state."""
        self.disarm()

    def _frame(self, filled: Filled, *, lost: int) -> Frame:
        """Make a frame of a filled buffer.

        Raises
        ------
        FrameCorruptError
            If the kernel marked it faulty, or bytes are missing.
        """
        if filled.faulty:
            msg = (
                f"frame {filled.sequence} of {self._settings.device} was marked faulty by the "
                "kernel: data were lost on the way; check cable and bandwidth."
            )
            raise FrameCorruptError(msg)
        f, arrival_s = self._format, time.monotonic()
        start, end = self._exposed(filled)
        if end is not None:
            end = min(end, arrival_s)  # the exposure may be known as an upper bound only
        return Frame(
            pixels=decode(filled.content, self._pixels, f.height, f.width, f.stride),
            sequence=filled.sequence,
            t_start_s=start,
            t_end_s=end,
            t_arrival_s=arrival_s,
            uncertainty_s=self._settings.uncertainty_s,
            extras={"stamp_s": filled.stamp_s, "lost_before": lost, "note": self._pixels.note},
        )

    def _exposed(self, filled: Filled) -> tuple[float | None, float | None]:
        source = self._timestamp_source(declares_start=filled.at_start, monotonic=filled.monotonic)
        rolled_s = self._row_time_s() * (self._format.height - 1)
        if source == "none":
            return None, None
        if source == "start":
            return filled.stamp_s, filled.stamp_s + self._exposure_s + rolled_s
        return filled.stamp_s - self._exposure_s - rolled_s, filled.stamp_s

    def _timestamp_source(self, *, declares_start: bool, monotonic: bool) -> TimestampSource:
        if not monotonic:
            return "none"
        if self._settings.timestamp is not None:
            return self._settings.timestamp
        # uvcvideo declares the start of the exposure and stamps the first packet, which comes after
        # its end. Taken for the end a frame is never believed younger than it is.
        return "start" if declares_start and self._info.driver != "uvcvideo" else "end"

    def _row_time_s(self) -> float:
        s = self._settings
        if s.shutter == "global":
            return 0.0
        fallback = self._format.interval_s / self._format.height
        return fallback if s.row_time_s is None else s.row_time_s

    def _capabilities(self) -> CameraCapabilities:
        device, controls = self._opened()
        s = self._settings
        rolling = s.shutter == "rolling"
        if controls.has(EXPOSURE_ABSOLUTE):
            info = controls.info(EXPOSURE_ABSOLUTE)
            exposure_range = (info.minimum * EXPOSURE_UNIT_S, info.maximum * EXPOSURE_UNIT_S)
            step = info.step * EXPOSURE_UNIT_S
        else:
            exposure_range, step = (self._exposure_s, self._exposure_s), 0.0
        return CameraCapabilities(
            rows=self._format.height,
            cols=self._format.width,
            bits=self._pixels.bits,
            white_level_dn=self._pixels.white_level_dn,
            exposure_range_s=exposure_range,
            exposure_step_s=step,
            readout_s=2.0 * self._format.interval_s,
            formats=tuple(f.name for f in self._usable(device)),
            trigger_modes=("free-run",),
            queue_depth=s.queue_depth,
            exposure_latency_frames=s.exposure_latency_frames,
            shutter=s.shutter,
            row_time_s=self._row_time_s() if rolling else 0.0,
            timestamp_source=s.timestamp or "end",
            uncertainty_s=s.uncertainty_s,
        )

    def _usable(self, device: VideoDevice) -> list[PixelFormat]:
        there = device.formats()
        usable = [f for f in V4L2_FORMATS if f.letters in there]
        return [f for f in usable if f is not MJPEG or self._settings.allow_uncalibrated]

    def _set_format(self, name: str | None, roi: tuple[int, int, int, int] | None) -> None:
        device, _ = self._opened()
        usable = self._usable(device)
        chosen = next((f for f in usable if name in (None, f.name, f.letters)), None)
        if chosen is None:
            names = ", ".join(f.name for f in usable) or "none"
            why = (
                "compressed, its counts are not proportional to light"
                if (name in (MJPEG.name, MJPEG.letters))
                else f"not offered by {self._info.card}"
            )
            msg = f"pixel format {name or 'grey'} is {why}; choose one of: {names}."
            raise SettingRefusedError(msg)
        self._format = device.set_format(chosen.letters, self._settings.size, roi)
        self._pixels = chosen

    def _set_exposure(self, controls: Controls, exposure_s: float) -> None:
        if not controls.has(EXPOSURE_ABSOLUTE):
            if abs(exposure_s - self._exposure_s) > 1e-3 * exposure_s:
                msg = (
                    f"{self._info.card} has no exposure control and always exposes "
                    f"{self._exposure_s:.6g} s; {exposure_s} s was asked for."
                )
                raise SettingRefusedError(msg)
            return
        info = controls.info(EXPOSURE_ABSOLUTE)
        low_s, high_s = info.minimum * EXPOSURE_UNIT_S, info.maximum * EXPOSURE_UNIT_S
        if not low_s <= exposure_s <= high_s * (1 + 1e-9):
            msg = f"exposure {exposure_s} s is outside {low_s:g} .. {high_s:g} s; change the plan."
            raise SettingRefusedError(msg)
        controls.set(info.name, round(exposure_s / EXPOSURE_UNIT_S))
        self._exposure_s = self._read_exposure()

    def _read_exposure(self) -> float:
        """Return the exposure; of a camera that does not say, the whole frame interval."""
        _, controls = self._opened()
        if not controls.has(EXPOSURE_ABSOLUTE):
            return self._format.interval_s
        return controls.get(controls.info(EXPOSURE_ABSOLUTE).name) * EXPOSURE_UNIT_S

    def _take(self, stream: Stream, *, copy: bool = True) -> Filled | None:
        try:
            filled = stream.take(copy=copy)
        except OSError as error:
            raise self._explained(error, "read from") from error
        if filled is not None:
            self._last_sequence = filled.sequence
        return filled

    def _explained(self, error: OSError, doing: str) -> DriverError:
        name = self._settings.device
        if error.errno == errno.ENODEV:
            return DeviceLostError(f"camera {name} has gone; plug it in and open it again.")
        if error.errno == errno.EBUSY:
            return DeviceBusyError(f"camera {name} streams for another program; close that.")
        if doing == "read from":
            msg = f"the stream of camera {name} broke ({error.strerror}); open it again."
            return DeviceLostError(msg)
        return SettingRefusedError(f"camera {name}: could not {doing} it ({error.strerror}).")

    def _opened(self) -> tuple[VideoDevice, Controls]:
        if self._device is None or self._controls is None:
            msg = f"camera {self._settings.device} is not open; call open() first."
            raise NotOpenError(msg)
        return self._device, self._controls

    def _armed(self) -> Stream:
        self._opened()
        if self._stream is None:
            msg = f"camera {self._settings.device} is not armed; call arm('free-run') first."
            raise NotOpenError(msg)
        return self._stream
