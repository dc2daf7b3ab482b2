"""A camera in the simulated world: modes, queue, exposure latency, time stamps, faults."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

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
    FrameCorruptError,
    NoFrameError,
    NotOpenError,
    SettingRefusedError,
    TriggerNotFiredError,
)
from drivers.receipts import TriggerReceipt
from drivers.simulation.sensor import Noise, Sensor
from drivers.simulation.world import World
from drivers.waiting import CancelToken

__all__ = ["Sensor", "SimulatedCamera"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Exposed:
    """An exposure of the sensor, of which no picture was made yet."""

    sequence: int
    shot: str
    begin_s: float
    exposure_s: float
    reported_s: float
    arrival_s: float
    repeats_bytes: bool
    flagged: bool


def _arrival(exposed: _Exposed) -> float:
    return exposed.arrival_s


class SimulatedCamera:
    """A camera that sees what the world shows while it exposes."""

    def __init__(self, sensor: Sensor, world: World, *, seed: int) -> None:
        self._sensor = sensor
        self._world = world
        self._seed = seed
        self._noise: Noise | None = None
        self._mode: TriggerMode | None = None
        self._settings = CameraSettings(exposure_s=sensor.exposure_range_s[0])
        self._exposure_s = self._settings.exposure_s
        self._old_frames = 0
        self._sequence = 0
        self._pulses = 0
        self._next_begin_s = 0.0
        self._coming: list[_Exposed] = []
        self._queue: deque[_Exposed] = deque()
        self._last: Frame | None = None
        self._stamps = np.random.default_rng([seed, 1])
        world.listen(self._edge)

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig simulated camera", "serial": f"sim-{self._seed}", "firmware": "2"}

    def open(self) -> CameraCapabilities:
        """Connect, disarmed; say what the camera can do."""
        if self._noise is not None:
            msg = "the simulated camera is already open; close it first."
            raise DeviceBusyError(msg)
        s = self._sensor
        self._noise = Noise(s, self._seed)
        return CameraCapabilities(
            rows=s.rows,
            cols=s.cols,
            bits=s.bits,
            white_level_dn=int(s.white_level_dn),
            exposure_range_s=s.exposure_range_s,
            readout_s=s.readout_s,
            trigger_modes=("software", "external", "free-run"),
            queue_depth=s.queue_depth,
            exposure_latency_frames=s.exposure_latency_frames,
            shutter="rolling" if s.row_time_s else "global",
            row_time_s=s.row_time_s,
            timestamp_source=s.timestamp_source,
            uncertainty_s=s.uncertainty_s,
        )

    def close(self) -> None:
        """Disarm and disconnect; harmless if done twice."""
        self.disarm()
        if self._noise is not None:
            self._noise.close()
        self._noise = None

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""
        return {**asdict(self._sensor), **asdict(self._settings), "seed": self._seed}

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set the exposure; all else is fixed and refused if another is asked for."""
        self._require_open()
        low, high = self._sensor.exposure_range_s
        if not low <= settings.exposure_s <= high:
            msg = f"exposure {settings.exposure_s} s is outside {low} .. {high} s; change the plan."
            raise SettingRefusedError(msg)
        if settings.gain_db or settings.roi or settings.pixel_format not in (None, "mono16"):
            msg = (
                f"{settings}: the simulated camera has 0 dB, its whole sensor and mono16 only; "
                "leave the others out."
            )
            raise SettingRefusedError(msg)
        self._advance()
        if settings.exposure_s != self._settings.exposure_s:
            self._old_frames = self._sensor.exposure_latency_frames if self._mode else 0
        self._settings = replace(settings, pixel_format="mono16")
        return self._settings

    def arm(self, mode: TriggerMode) -> None:
        """Begin to take frames: by itself, at `trigger`, or at an external edge."""
        self._require_open()
        self.disarm()
        self._mode = mode
        self._next_begin_s = self._world.clock.now_s()

    def disarm(self) -> None:
        """Take no more frames; those that wait are lost."""
        self._mode = None
        self._old_frames = 0
        self._coming.clear()
        self._queue.clear()

    def make_safe(self) -> None:
        """Disarm whatever the state."""
        self.disarm()

    def flush(self) -> Flushed:
        """Throw away every frame that waits, without waiting for another."""
        self._require_open()
        self._advance()
        discarded = len(self._queue)
        newest = self._queue[-1].sequence if self._queue else 0
        last = 0 if self._last is None else self._last.sequence
        self._queue.clear()
        return Flushed(discarded=discarded, last_sequence=max(newest, last))

    def trigger(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:  # noqa: ARG002
        """Start one exposure; a camera that still exposes ignores it, as real ones do."""
        cancel.check()
        self._require_open()
        if self._mode != "software":
            msg = f"the simulated camera is armed for {self._mode}, not for software; arm it."
            raise SettingRefusedError(msg)
        if self._world.faults.strikes("stuck-trigger"):
            msg = "the simulated camera refused its software trigger; try again."
            raise TriggerNotFiredError(msg)
        now = self._world.clock.now_s()
        if not self._world.faults.strikes("silent-trigger"):
            self._begin(now + self._sensor.trigger_latency_s)
        self._pulses += 1
        return TriggerReceipt(earliest_s=now, latest_s=now, count=self._pulses)

    def collect(self, *, deadline_s: float, cancel: CancelToken) -> Frame:
        """Return the oldest frame that waits, or wait for the next."""
        self._require_open()
        faults, clock = self._world.faults, self._world.clock
        if self._last is not None and faults.strikes("duplicate"):
            return self._last
        while not self._queue:
            now = clock.now_s()
            if now >= deadline_s:
                msg = (
                    f"no frame from the simulated camera until {deadline_s:.3f} s, armed for "
                    f"{self._mode}; was it triggered?"
                )
                raise NoFrameError(msg)
            coming = [e.arrival_s for e in self._coming]
            if self._mode == "free-run":
                coming.append(self._next_begin_s)
            clock.wait_until(min([deadline_s, *coming]), cancel)
            self._advance()
        exposed = self._queue.popleft()
        if faults.strikes("corrupt"):
            msg = f"frame {exposed.sequence} of the simulated camera arrived in part; take another."
            raise FrameCorruptError(msg)
        self._last = self._develop(exposed)
        return self._last

    def _edge(self, at_s: float) -> None:
        if self._mode == "external":
            self._begin(at_s + self._sensor.trigger_latency_s)

    def _advance(self) -> None:
        """Let happen what has happened by now: exposures that began, frames that arrived."""
        now = self._world.clock.now_s()
        while self._mode == "free-run" and self._next_begin_s <= now:
            self._begin(self._next_begin_s)
        arrived = sorted((e for e in self._coming if e.arrival_s <= now), key=_arrival)
        self._coming = [e for e in self._coming if e.arrival_s > now]
        for exposed in arrived:
            if len(self._queue) < self._sensor.queue_depth:
                self._queue.append(exposed)

    def _begin(self, begin_s: float) -> None:
        """Begin an exposure, unless one is still going on."""
        if begin_s < self._next_begin_s:
            return
        if self._old_frames:
            self._old_frames -= 1
        else:
            self._exposure_s = self._settings.exposure_s
        s, faults = self._sensor, self._world.faults
        exposure_s = reported_s = self._exposure_s
        if fault := faults.strikes("wrong-exposure"):
            exposure_s = reported_s = self._exposure_s * fault.factor
        elif fault := faults.strikes("hidden-exposure"):
            exposure_s *= fault.factor
        skipped = 3 if faults.strikes("gap") else 0
        late = faults.strikes("delay")
        self._sequence += 1 + skipped
        self._next_begin_s = begin_s + max(exposure_s, s.readout_s)
        if faults.strikes("drop"):
            return
        rolled_s = s.row_time_s * (s.rows - 1)
        self._coming.append(
            _Exposed(
                sequence=self._sequence,
                shot=faults.shot,
                begin_s=begin_s,
                exposure_s=exposure_s,
                reported_s=reported_s,
                arrival_s=begin_s
                + rolled_s
                + exposure_s
                + s.readout_s
                + (late.seconds if late else 0),
                repeats_bytes=faults.strikes("repeat-bytes") is not None,
                flagged=faults.strikes("flagged") is not None,
            )
        )

    def _develop(self, exposed: _Exposed) -> Frame:
        """Make the picture of an exposure that has arrived."""
        s, noise = self._sensor, self._require_open()
        name = exposed.shot or f"frame {exposed.sequence}"
        if exposed.repeats_bytes and self._last is not None:
            pixels = self._last.pixels
        else:
            electrons = self._world.expose(exposed.begin_s, exposed.exposure_s, s.row_time_s)
            pixels = noise.digitise(electrons, exposed.exposure_s, name)
        start = end = None
        if s.timestamp_source != "none":
            off = s.uncertainty_s * self._stamps.uniform(-1.0, 1.0)
            start = exposed.begin_s + off
            end = start + exposed.exposure_s + s.row_time_s * (s.rows - 1)
        return Frame(
            pixels=pixels,
            sequence=exposed.sequence,
            t_start_s=start,
            t_end_s=end,
            t_arrival_s=exposed.arrival_s,
            uncertainty_s=s.uncertainty_s,
            exposure_s=exposed.reported_s if s.reports_exposure else None,
            gain_db=0.0 if s.reports_exposure else None,
            flags=frozenset({"error"}) if exposed.flagged else frozenset(),
        )

    def _require_open(self) -> Noise:
        if self._noise is None:
            msg = "the simulated camera is not open; call open() first."
            raise NotOpenError(msg)
        if self._world.faults.strikes("camera-lost"):
            self.close()
            msg = "the simulated camera was unplugged; plug it in again."
            raise DeviceLostError(msg)
        return self._noise
