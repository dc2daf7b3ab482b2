"""A machine-vision camera, USB3 Vision or GigE Vision, by Aravis through GObject introspection."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

from drivers.camera.genicam_library import Watch, aravis, find_camera, same_device
from drivers.camera.pixel_formats import GENICAM_FORMATS, PixelFormat, decode
from drivers.camera.protocol import (
    CameraCapabilities,
    CameraSettings,
    Flushed,
    Frame,
    TriggerMode,
)
from drivers.errors import (
    DeviceBusyError,
    DeviceLostError,
    DriverError,
    FrameCorruptError,
    NoFrameError,
    NotOpenError,
    SettingRefusedError,
    TriggerNotFiredError,
)
from drivers.receipts import TriggerReceipt
from drivers.waiting import SLICE_S, CancelToken


@dataclass(frozen=True, slots=True, kw_only=True)
class GenicamSettings:
    """Which camera, and what it does not say of itself.

    Attributes
    ----------
    device : its serial number, or its name as ``labrig devices`` lists it
    pixel_format : None for the deepest grey format it has
    size : width and height of the picture, px, from the sensor's first corner; None for all
    trigger_line : the input that an external edge comes in at
    exposure_latency_frames : frames in free run that may still have the old exposure
    readout_s : from the end of an exposure to the arrival of its frame, at most
    uncertainty_s : of the instants of a frame, which are those of its arrival
    """

    device: str
    pixel_format: str | None = None
    size: tuple[int, int] | None = None
    trigger_line: str = "Line1"
    exposure_latency_frames: int = 2
    readout_s: float = 0.2
    uncertainty_s: float = 0.005
    shutter: Literal["global", "rolling"] = "global"
    row_time_s: float = 0.0
    queue_depth: int = 4


class GenicamCamera:
    """A camera that Aravis can open; its features are asked for by meaning, never by node name."""

    def __init__(self, settings: GenicamSettings) -> None:
        self._settings = settings
        self._camera: Any = None
        self._stream: Any = None
        self._mode: TriggerMode | None = None
        self._format: PixelFormat = GENICAM_FORMATS[0]
        self._exposure_s = 0.0
        self._watch: Watch | None = None
        self._pulses = 0
        self._fired_s = 0.0
        self._last_id: int | None = None
        self._sequence = 0

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``; empty where the camera does not say."""
        found = {"model": "", "serial": self._settings.device, "firmware": ""}
        camera = self._camera
        if camera is None:
            return found
        told = {
            "model": lambda: f"{camera.get_vendor_name()} {camera.get_model_name()}",
            "serial": camera.get_device_serial_number,
            "firmware": lambda: camera.get_string("DeviceVersion"),
        }
        for name, ask in told.items():
            with suppress(SettingRefusedError), self._explained(f"read the {name} of"):
                found[name] = ask() or found[name]
        return found

    def open(self) -> CameraCapabilities:
        """Connect, disarmed, automatic functions off; say what the camera can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError, SettingRefusedError
            With the remedy.
        """
        if self._camera is not None:
            msg = f"camera {self._settings.device} is open already; close it first."
            raise DeviceBusyError(msg)
        lib = aravis()
        name = find_camera(self._settings.device)
        try:
            self._camera = lib.Camera.new(name)
        except lib.error as error:
            msg = (
                f"camera {name} is there and cannot be opened ({error.message}); close the program "
                "that controls it, or install the udev rule: labrig doctor --fix-udev"
            )
            raise DeviceBusyError(msg) from error
        self._watch = Watch(self._camera)
        try:
            with self._explained("set up"):
                return self._set_up(lib)
        except DriverError:
            self.close()
            raise

    def close(self) -> None:
        """Disarm and disconnect; harmless if done twice, never raises."""
        self.disarm()
        watch, self._watch, self._camera = self._watch, None, None
        if watch is not None:
            watch.stop()

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device."""
        camera = self._opened()
        with self._explained("read"):
            x, y, width, height = camera.get_region()
            return {
                "device": self._settings.device,
                "pixel_format": camera.get_pixel_format_as_string(),
                "exposure_s": camera.get_exposure_time() * 1e-6,
                "gain_db": camera.get_gain() if camera.is_gain_available() else 0.0,
                "roi": [x, y, width, height],
                "mode": self._mode,
            }

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set everything, automatic functions off; return what the device really has.

        Raises
        ------
        SettingRefusedError
            If a value is out of range; format and region cannot change while armed.
        """
        camera = self._opened()
        with self._explained("set"):
            low_us, high_us = camera.get_exposure_time_bounds()
            _refuse_outside("exposure_s", settings.exposure_s, low_us * 1e-6, high_us * 1e-6)
            if camera.is_gain_available():
                _refuse_outside("gain_db", settings.gain_db, *camera.get_gain_bounds())
                camera.set_gain(settings.gain_db)
            elif settings.gain_db:
                _refuse_outside("gain_db", settings.gain_db, 0.0, 0.0)
            self._apply_picture(camera, settings)
            camera.set_exposure_time(settings.exposure_s * 1e6)
            self._exposure_s = camera.get_exposure_time() * 1e-6
            gain_db = camera.get_gain() if camera.is_gain_available() else 0.0
        return replace(
            settings,
            exposure_s=self._exposure_s,
            gain_db=gain_db,
            pixel_format=self._format.name,
        )

    def arm(self, mode: TriggerMode) -> None:
        """Begin to take frames: by itself, at `trigger`, or at an external edge."""
        camera, lib = self._opened(), aravis()
        self.disarm()
        with self._explained("arm"):
            if mode == "free-run":
                camera.clear_triggers()
            else:
                source = "Software" if mode == "software" else self._settings.trigger_line
                camera.set_trigger(source)
            camera.set_acquisition_mode(lib.AcquisitionMode.CONTINUOUS)
            stream = camera.create_stream(None, None)
            for _ in range(self._settings.queue_depth):
                stream.push_buffer(lib.Buffer.new_allocate(camera.get_payload()))
            camera.start_acquisition()
        self._stream, self._mode, self._last_id = stream, mode, None

    def disarm(self) -> None:
        """Take no more frames; queued frames are lost. Never raises."""
        if self._stream is not None:
            with suppress(DriverError), self._explained("stop"):
                self._camera.stop_acquisition()
        self._stream, self._mode = None, None

    def flush(self) -> Flushed:
        """Throw away every frame that waits, without waiting for another."""
        stream = self._armed()
        discarded = 0
        for _ in range(2 * self._settings.queue_depth):
            buffer = stream.try_pop_buffer()
            if buffer is None:
                break
            self._number(buffer)
            stream.push_buffer(buffer)
            discarded += 1
        return Flushed(discarded=discarded, last_sequence=self._sequence)

    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:  # noqa: ARG002
        """Start one exposure in mode "software"; return at once.

        Raises
        ------
        TriggerNotFiredError, DeviceLostError, CancelledError
        """
        cancel.check()
        self._armed()
        if self._mode != "software":
            msg = f"the camera is armed for {self._mode}, not for software; arm it."
            raise TriggerNotFiredError(msg)
        self._refuse_lost()
        begin_s = time.monotonic()
        with self._explained("trigger"):
            self._camera.software_trigger()
        self._pulses += 1
        self._fired_s = begin_s
        return TriggerReceipt(earliest_s=begin_s, latest_s=time.monotonic(), count=self._pulses)

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the oldest frame that waits, or wait for the next.

        Raises
        ------
        NoFrameError, FrameCorruptError, DeviceLostError, CancelledError
        """
        stream = self._armed()
        while True:
            cancel.check()
            self._refuse_lost()
            left_s = min(max(deadline_s - time.monotonic(), 0.0), SLICE_S)
            buffer = stream.timeout_pop_buffer(int(left_s * 1e6))
            if buffer is not None:
                try:
                    return self._frame(buffer)
                finally:
                    stream.push_buffer(buffer)
            if time.monotonic() >= deadline_s:
                msg = (
                    f"no frame from camera {self._settings.device} before the deadline, armed for "
                    f"{self._mode}; was it triggered?"
                )
                raise NoFrameError(msg)

    def make_safe(self) -> None:
        """Disarm whatever the state."""
        self.disarm()

    def _set_up(self, lib: Any) -> CameraCapabilities:
        camera, s = self._camera, self._settings
        if camera.is_exposure_auto_available():
            camera.set_exposure_time_auto(lib.Auto.OFF)
        if camera.is_gain_auto_available():
            camera.set_gain_auto(lib.Auto.OFF)
        formats = self._formats()
        self._choose_format(s.pixel_format or formats[0].name)
        rows, cols = self._whole_sensor()
        low_us, high_us = camera.get_exposure_time_bounds()
        gains = camera.get_gain_bounds() if camera.is_gain_available() else (0.0, 0.0)
        self._exposure_s = camera.get_exposure_time() * 1e-6
        return CameraCapabilities(
            rows=rows,
            cols=cols,
            bits=self._format.bits,
            white_level_dn=self._format.white_level_dn,
            exposure_range_s=(low_us * 1e-6, high_us * 1e-6),
            readout_s=s.readout_s,
            gain_range_db=(gains[0], gains[1]),
            formats=tuple(f.name for f in formats),
            trigger_modes=("software", "external", "free-run"),
            queue_depth=s.queue_depth,
            exposure_latency_frames=s.exposure_latency_frames,
            shutter=s.shutter,
            row_time_s=s.row_time_s,
            timestamp_source="arrival",
            uncertainty_s=s.uncertainty_s,
        )

    def _whole_sensor(self) -> tuple[int, int]:
        camera = self._camera
        _, _, width, height = self._default_region()
        camera.set_region(0, 0, width, height)
        if tuple(camera.get_region())[2:] != (width, height):
            msg = f"size {width}x{height} was asked, the camera took {camera.get_region()[2:]}."
            raise SettingRefusedError(msg)
        return height, width

    def _default_region(self) -> tuple[int, int, int, int]:
        if self._settings.size is not None:
            return (0, 0, *self._settings.size)
        (_, width), (_, height) = (
            self._camera.get_width_bounds(),
            self._camera.get_height_bounds(),
        )
        return 0, 0, width, height

    def _apply_picture(self, camera: Any, settings: CameraSettings) -> None:
        wanted = settings.roi or self._default_region()
        present = tuple(camera.get_region())
        name = settings.pixel_format or self._settings.pixel_format or self._format.name
        if present == wanted and name == self._format.name:
            return
        if self._stream is not None:
            msg = "format and region cannot change while the camera is armed; disarm it first."
            raise SettingRefusedError(msg)
        self._choose_format(name)
        camera.set_region(*wanted)
        if tuple(camera.get_region()) != wanted:
            msg = f"region {wanted} was asked, the camera took {tuple(camera.get_region())}."
            raise SettingRefusedError(msg)

    def _formats(self) -> list[PixelFormat]:
        there = set(self._camera.dup_available_pixel_formats_as_strings())
        found = [f for f in GENICAM_FORMATS if f.name in there]
        if not found:
            msg = f"the camera has no unpacked grey format; it has: {', '.join(sorted(there))}."
            raise SettingRefusedError(msg)
        return found

    def _choose_format(self, name: str) -> None:
        formats = {f.name: f for f in self._formats()}
        if name not in formats:
            msg = f"pixel format {name} is not offered; choose one of: {', '.join(formats)}."
            raise SettingRefusedError(msg)
        self._camera.set_pixel_format_from_string(name)
        self._format = formats[name]

    def _frame(self, buffer: Any) -> Frame:
        """Make a frame of a buffer.

        Raises
        ------
        FrameCorruptError
            If its status is not success: packets were lost, or memory ran short.
        """
        sequence = self._number(buffer)
        status = buffer.get_status()
        if status.value_nick != "success":
            msg = (
                f"frame {sequence} of camera {self._settings.device} came with status "
                f"{status.value_nick}; check bandwidth, packet size and usbfs memory."
            )
            raise FrameCorruptError(msg)
        rows, cols = buffer.get_image_height(), buffer.get_image_width()
        stride = cols * self._format.bytes_per_px
        pixels = decode(buffer.get_data(), self._format, rows, cols, stride)
        now_s = time.monotonic()
        # Aravis stamps the arrival on the wall clock.
        arrival_s = min(now_s, buffer.get_system_timestamp() * 1e-9 - (time.time() - now_s))
        rolled_s = self._settings.row_time_s * (rows - 1)
        start_s = arrival_s - self._exposure_s - rolled_s
        if self._mode == "software":
            start_s = max(start_s, self._fired_s)  # it cannot have begun before it was asked to
        return Frame(
            pixels=pixels,
            sequence=sequence,
            t_start_s=start_s,
            t_end_s=max(arrival_s, start_s),
            t_arrival_s=now_s,
            uncertainty_s=self._settings.uncertainty_s,
            extras={"frame_id": buffer.get_frame_id(), "device_ns": buffer.get_timestamp()},
        )

    def _number(self, buffer: Any) -> int:
        """Return a number that rises with every frame of the camera, lost ones too.

        GigE Vision counts from 1 to 65535 and begins anew, leaving out zero.
        """
        found, last = buffer.get_frame_id(), self._last_id
        turn = 65535 if self._camera.is_gv_device() and found < 65536 else 2**64
        self._sequence += 1 if last is None else max((found - last) % turn, 1)
        self._last_id = found
        return self._sequence

    @contextmanager
    def _explained(self, doing: str) -> Iterator[None]:
        lib = aravis()
        try:
            yield
        except lib.error as error:
            if self._watch is not None and (self._watch.lost or not same_device(lib, error)):
                self._watch.lost = True
                msg = (
                    f"camera {self._settings.device} has gone ({error.message}); plug it in and "
                    "open it again."
                )
                raise DeviceLostError(msg) from error
            msg = f"could not {doing} camera {self._settings.device}: {error.message}."
            raise SettingRefusedError(msg) from error

    def _refuse_lost(self) -> None:
        if self._watch is not None and self._watch.lost:
            msg = f"camera {self._settings.device} has gone; plug it in and open it again."
            raise DeviceLostError(msg)

    def _opened(self) -> Any:
        if self._camera is None:
            msg = f"camera {self._settings.device} is not open; call open() first."
            raise NotOpenError(msg)
        return self._camera

    def _armed(self) -> Any:
        self._opened()
        if self._stream is None:
            msg = f"camera {self._settings.device} is not armed; call arm() first."
            raise NotOpenError(msg)
        return self._stream


def _refuse_outside(name: str, value: float, low: float, high: float) -> None:
    if not low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
        msg = f"{name} = {value} is outside {low:g} .. {high:g}; change the plan."
        raise SettingRefusedError(msg)
