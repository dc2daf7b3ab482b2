"""A simulated sensor: shot noise, read noise, black level, gain, response, clipping, blooming."""

from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TABLE = 1 << 22  # kept normal numbers: more than a picture has, so that none repeats in it
BLOCK_ROWS = 16
N_BANDS = 4  # fixed, so that a seed gives the same noise on any machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The sensor's figures; ``counts = black + gain (Poisson(e) + N(0, read_noise))``, clipped.

    What is bent by the response are these counts, the black level with them.

    Attributes
    ----------
    shot_noise : whether electrons come by chance
    saturates, quantised : whether counts end at the white level, and are whole; those of a frame
        always are
    blooming : share of the charge above full well that spills into the next pixels of a column
    response : how counts are given out, as shares of 2^bits - 1
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
    shot_noise: bool = True
    saturates: bool = True
    quantised: bool = True
    blooming: float = 0.0
    response: Literal["linear", "srgb"] = "linear"
    noise: Literal["exact", "quick"] = "exact"

    @property
    def full_well_e(self) -> float:
        """Electrons that bring a pixel to the white level."""
        return (self.white_level_dn - self.black_level_dn) / self.gain_dn_per_e


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
        """Return whole counts, read-only."""
        s = self._sensor
        read = self.counts(electrons, exposure_s, name)
        if not (s.quantised and s.saturates):
            read = np.clip(np.rint(read), 0, s.white_level_dn)
        pixels = read.astype(np.uint16)
        pixels.setflags(write=False)
        return pixels

    def counts(self, electrons: Array, exposure_s: float, name: str) -> Array:
        """Return what is read out; bands of rows are drawn side by side, each from its stream."""
        s = self._sensor
        if s.hot_pixels:
            electrons = electrons.copy()
            electrons[self._hot] += s.hot_e_per_s * exposure_s
        if s.blooming:
            electrons = bloom(electrons, s.full_well_e, s.blooming)
        read = np.empty(electrons.shape, np.float64 if self._table is None else np.float32)
        expose = self._expose_band if self._table is None else self._expose_quickly
        bands = np.array_split(np.arange(electrons.shape[0]), N_BANDS)
        streams = np.random.default_rng([self._seed, zlib.crc32(name.encode())]).spawn(N_BANDS)
        list(self._pool.map(expose, bands, streams, repeat(electrons), repeat(read)))
        return read

    def _expose_band(
        self,
        rows: NDArray[np.int64],
        rng: np.random.Generator,
        electrons: Array,
        read: Array,
    ) -> None:
        s = self._sensor
        band = slice(rows[0], rows[-1] + 1)
        collected = rng.poisson(electrons[band]) if s.shot_noise else electrons[band]
        counts = read[band]
        if s.read_noise_e:
            rng.standard_normal(out=counts)
            counts *= s.read_noise_e
            counts += collected
        else:
            counts[:] = collected
        counts *= s.gain_dn_per_e
        counts += s.black_level_dn
        if s.response == "srgb":
            top = 2.0**s.bits - 1.0
            counts[:] = top * srgb(np.clip(counts / top, 0.0, 1.0))
        if s.saturates:
            np.clip(counts, 0.0, s.white_level_dn, out=counts)
        if s.quantised:
            np.rint(counts, out=counts)

    def _expose_quickly(
        self,
        rows: NDArray[np.int64],
        rng: np.random.Generator,
        electrons: Array,
        read: NDArray[np.float32],
    ) -> None:
        s, table = self._sensor, self._table
        if table is None:
            msg = "only a sensor of quick noise keeps a table"
            raise AssertionError(msg)
        at = int(rng.integers(TABLE))
        for first in range(rows[0], rows[-1] + 1, BLOCK_ROWS):  # all of it stays in the cache
            counts = read[first : min(first + BLOCK_ROWS, rows[-1] + 1)]
            counts[:] = electrons[first : first + len(counts)]
            spread = np.sqrt(counts + np.float32(s.read_noise_e**2))
            spread *= table[at : at + counts.size].reshape(counts.shape)
            at += counts.size
            counts += spread
            counts *= np.float32(s.gain_dn_per_e)
            counts += np.float32(s.black_level_dn)
            if s.saturates:
                np.clip(counts, 0.0, s.white_level_dn, out=counts)
            if s.quantised:
                np.rint(counts, out=counts)


def srgb(share: Array) -> Array:
    """Return the signal of an sRGB picture for a share of white light (IEC 61966-2-1)."""
    bent = 1.055 * np.maximum(share, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(share <= 0.0031308, 12.92 * share, bent)


def bloom(electrons: Array, full_well_e: float, share: float) -> Array:
    """Let charge above full well spill, half of it up and half down its column.

    It fills one pixel after the other; at the ends of a column it is lost, as is what of the
    excess does not spill.
    """
    excess = np.maximum(electrons - full_well_e, 0.0)
    held = electrons - excess
    for rows in (range(held.shape[0]), range(held.shape[0] - 1, -1, -1)):
        spilling = np.zeros(held.shape[1])
        for row in rows:
            spilling += 0.5 * share * excess[row]
            taken = np.minimum(spilling, full_well_e - held[row])
            held[row] += taken
            spilling -= taken
    return held
