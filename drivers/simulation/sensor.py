"""A simulated sensor: shot noise, read noise, black level, gain, clipping."""

from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from typing import Literal

import numpy as np
from numpy.typing import NDArray

TABLE = 1 << 22  # kept normal numbers: more than a picture has, so that none repeats in it
N_BANDS = 4  # fixed, so that a seed gives the same noise on any machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The sensor's figures; ``counts = black + gain (Poisson(e) + N(0, read_noise))``, clipped.

    Attributes
    ----------
    hot_pixels : as many pixels, at places drawn from the seed, add ``hot_e_per_s``
    exposure_latency_frames : whole frames that keep the old exposure after a new one was set
    timestamp_source, uncertainty_s : what the stamps mean, and how far off they may be
    reports_exposure : whether a frame says how long it was exposed
    trigger_latency_s : from the edge to the begin of the exposure
    noise : "quick" draws shot noise as a normal one out of a kept table, at a camera's rate;
        wrong in shape below some ten electrons, right in mean and variance
    """

    rows: int
    cols: int
    bits: int
    black_level_dn: float
    white_level_dn: float
    gain_dn_per_e: float
    read_noise_e: float
    readout_s: float
    exposure_range_s: tuple[float, float] = (1e-5, 60.0)
    hot_pixels: int = 0
    hot_e_per_s: float = 0.0
    exposure_latency_frames: int = 0
    queue_depth: int = 4
    row_time_s: float = 0.0
    timestamp_source: Literal["start", "end", "arrival", "none"] = "start"
    uncertainty_s: float = 0.0
    reports_exposure: bool = True
    trigger_latency_s: float = 0.0
    noise: Literal["exact", "quick"] = "exact"


class Noise:
    """Turns electrons into counts; the noise of a frame follows from its name alone.

    A frame taken again, or after a crash, then equals the one that was lost, and runs can be
    compared bit by bit.
    """

    def __init__(self, sensor: Sensor, seed: int) -> None:
        self._sensor = sensor
        self._seed = seed
        self._pool = ThreadPoolExecutor(N_BANDS)
        places = np.random.default_rng(seed).choice(
            sensor.rows * sensor.cols, sensor.hot_pixels, replace=False
        )
        self._hot = np.unravel_index(places, (sensor.rows, sensor.cols))
        self._table = (
            np.random.default_rng([seed, 3]).standard_normal(
                TABLE + sensor.rows * sensor.cols, dtype=np.float32
            )
            if sensor.noise == "quick"
            else None
        )

    def close(self) -> None:
        """Let the threads go."""
        self._pool.shutdown()

    def digitise(
        self, electrons: NDArray[np.float64], exposure_s: float, name: str
    ) -> NDArray[np.uint16]:
        """Return counts, read-only; bands of rows are drawn side by side, each from its stream."""
        if self._sensor.hot_pixels:
            electrons = electrons.copy()
            electrons[self._hot] += self._sensor.hot_e_per_s * exposure_s
        pixels = np.empty(electrons.shape, dtype=np.uint16)
        bands = np.array_split(np.arange(electrons.shape[0]), N_BANDS)
        streams = np.random.default_rng([self._seed, zlib.crc32(name.encode())]).spawn(N_BANDS)
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
        if self._table is not None:
            light = electrons[band].astype(np.float32)
            begin = int(rng.integers(TABLE))
            normal = self._table[begin : begin + light.size].reshape(light.shape)
            light += np.sqrt(light + np.float32(s.read_noise_e**2)) * normal
            quick = np.rint(np.float32(s.black_level_dn) + np.float32(s.gain_dn_per_e) * light)
            pixels[band] = np.clip(quick, 0, s.white_level_dn)
            return
        collected = rng.poisson(electrons[band]) + s.read_noise_e * rng.standard_normal(
            electrons[band].shape
        )
        counts = np.rint(s.black_level_dn + s.gain_dn_per_e * collected)
        pixels[band] = np.clip(counts, 0, s.white_level_dn)
