"""A camera in the simulated world: shot noise, read noise, black level, gain, clipping."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera.protocol import CameraCapabilities, Frame
from drivers.errors import NoFrameError, NotOpenError, SettingRefusedError
from drivers.simulation.world import World

N_BANDS = 4  # fixed, so that a seed gives the same noise on any machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The sensor's figures; ``counts = black + gain (Poisson(e) + N(0, read_noise))``, clipped."""

    rows: int
    cols: int
    bits: int
    black_level_dn: float
    white_level_dn: float
    gain_dn_per_e: float
    read_noise_e: float
    readout_s: float
    exposure_range_s: tuple[float, float] = (1e-5, 60.0)


class SimulatedCamera:
    """A global-shutter camera that sees what the world shows while it exposes."""

    def __init__(self, sensor: Sensor, world: World, *, seed: int) -> None:
        self._sensor = sensor
        self._world = world
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self._open = False
        self._exposure_s = sensor.exposure_range_s[0]
        self._sequence = 0
        self._queue: list[Frame] = []
        self._pool = ThreadPoolExecutor(N_BANDS)

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig simulated camera", "serial": f"sim-{self._seed}", "firmware": "1"}

    def open(self) -> CameraCapabilities:
        """Connect; say what the camera can do."""
        self._open = True
        s = self._sensor
        return CameraCapabilities(
            rows=s.rows,
            cols=s.cols,
            bits=s.bits,
            white_level_dn=int(s.white_level_dn),
            exposure_range_s=s.exposure_range_s,
            readout_s=s.readout_s,
        )

    def close(self) -> None:
        """Disconnect; harmless if done twice."""
        self._open = False
        self._queue.clear()

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""
        return {**asdict(self._sensor), "exposure_s": self._exposure_s, "seed": self._seed}

    def apply(self, *, exposure_s: float) -> float:
        """Set the exposure; return what the camera really has.

        Raises
        ------
        SettingRefusedError
            If the exposure is outside the sensor's range.
        """
        self._require_open()
        low, high = self._sensor.exposure_range_s
        if not low <= exposure_s <= high:
            msg = f"exposure {exposure_s} s is outside {low} .. {high} s; change the plan."
            raise SettingRefusedError(msg)
        self._exposure_s = exposure_s
        return exposure_s

    def flush(self) -> int:
        """Discard frames not yet collected; return how many."""
        discarded = len(self._queue)
        self._queue.clear()
        return discarded

    def trigger(self) -> float:
        """Expose once, starting now; return the instant of firing, s."""
        self._require_open()
        clock = self._world.clock
        begin = clock.now_s()
        clock.sleep(self._exposure_s)
        end = clock.now_s()
        electrons = self._world.expose(begin, end)
        clock.sleep(self._sensor.readout_s)
        self._sequence += 1
        self._queue.append(
            Frame(
                pixels=self._digitise(electrons),
                sequence=self._sequence,
                t_start_s=begin,
                t_end_s=end,
                uncertainty_s=0.0,
                exposure_s=self._exposure_s,
            )
        )
        return begin

    def collect(self, *, deadline_s: float) -> Frame:
        """Return the next frame.

        Raises
        ------
        NoFrameError
            If nothing was triggered.
        """
        self._require_open()
        if not self._queue:
            self._world.clock.sleep(deadline_s - self._world.clock.now_s())
            msg = "no frame came before the deadline; was the camera triggered?"
            raise NoFrameError(msg)
        return self._queue.pop(0)

    def _digitise(self, electrons: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return counts; bands of rows are drawn side by side, each from a stream of its own."""
        pixels = np.empty(electrons.shape, dtype=np.uint16)
        bands = np.array_split(np.arange(electrons.shape[0]), N_BANDS)
        streams = self._rng.spawn(N_BANDS)
        list(self._pool.map(self._expose_band, bands, streams, repeat(electrons), repeat(pixels)))
        pixels.setflags(write=False)
        return pixels

    def _expose_band(
        self,
        rows: NDArray[np.int64],
        rng: np.random.Generator,
        electrons: NDArray[np.float64],
        pixels: NDArray[np.uint16],
    ) -> None:
        s = self._sensor
        band = slice(rows[0], rows[-1] + 1)
        collected = rng.poisson(electrons[band]) + s.read_noise_e * rng.standard_normal(
            electrons[band].shape
        )
        counts = np.rint(s.black_level_dn + s.gain_dn_per_e * collected)
        pixels[band] = np.clip(counts, 0, s.white_level_dn)

    def _require_open(self) -> None:
        if not self._open:
            msg = "the simulated camera is not open; call open() first."
            raise NotOpenError(msg)
