"""Pictures thinned to some thousand pixels, as linear light with its noise: enough to compare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.model import SATURATED_SHARE
from labrig.rig import OpenRig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LIT, BRIGHT_STEP = 0.05, 97  # share of the brightest; every so many pixels tell what that is
SAMPLE = 8_000  # pixels at random places: a regular grid of them could fit the stripes' period


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thinned:
    """Some pixels of a picture, always the same ones.

    Attributes
    ----------
    counts : (n,) as the camera gave them
    light : (n,) linear counts without the black level, DN
    variance : (n,) of the light by the camera's gain and read noise, DN^2
    clipped : (n,) too near the white level to say how bright it was
    exposure_s : as the shot asked for it
    lamp : brightness of the lamp as a share of its first, by the references
    """

    counts: NDArray[np.uint16]
    light: Array
    variance: Array
    clipped: Mask
    exposure_s: float
    lamp: float

    def at(self, exposure_s: float, lamp: float) -> tuple[Array, Array]:
        """Return light and variance as they would be at another exposure and lamp."""
        k = exposure_s * lamp / (self.exposure_s * self.lamp)
        return k * self.light, k**2 * self.variance


def typical(squares: Array) -> Array:
    """Return the mean over the last axis without its largest hundredth.

    Glints, hot pixels and what spills over from clipped ones are not what a picture shows.
    """
    kept = squares.shape[-1] - squares.shape[-1] // 100
    return np.asarray(np.partition(squares, kept - 1, axis=-1)[..., :kept].mean(axis=-1))


class Thinner:
    """Thins the pictures of one rig."""

    def __init__(self, rig: OpenRig) -> None:
        camera = rig.config.camera.record()
        linear = camera.response.linear(camera.bits)
        self._light = linear - camera.black_level_dn
        self._variance = rig.variance_dn2(linear) + (np.gradient(linear) ** 2 - 1.0) / 12.0
        self._clips_at = SATURATED_SHARE * rig.camera_can.white_level_dn
        self.white = float(self._light[rig.camera_can.white_level_dn])
        self._at: tuple[int, NDArray[np.int64]] | None = None

    def thin(self, pixels: NDArray[np.uint16], exposure_s: float, lamp: float) -> Thinned:
        """Return some pixels of a picture, (rows, cols)."""
        counts = pixels.ravel()[self._places(pixels.size)]
        return Thinned(
            counts=counts,
            light=self._light[counts],
            variance=self._variance[counts],
            clipped=counts >= self._clips_at,
            exposure_s=exposure_s,
            lamp=lamp,
        )

    def aim(self, white: NDArray[np.uint16]) -> None:
        """Choose most pixels where a white picture, (rows, cols), is lit; older ones are void."""
        counts = white.ravel()
        low, high = np.quantile(counts[::BRIGHT_STEP], (0.01, 0.999))
        bright = np.flatnonzero(counts > low + LIT * (high - low))
        rng = np.random.default_rng(counts.size)
        n = min(bright.size, SAMPLE * 3 // 4)
        lit = bright[rng.choice(bright.size, n, replace=False)]
        self._at = (counts.size, np.union1d(lit, self._anywhere(counts.size, SAMPLE // 4)))

    def _places(self, size: int) -> NDArray[np.int64]:
        if self._at is None or self._at[0] != size:
            self._at = (size, self._anywhere(size, SAMPLE))
        return self._at[1]

    def _anywhere(self, size: int, n: int) -> NDArray[np.int64]:
        rng = np.random.default_rng(size)
        return np.sort(rng.choice(size, min(size, n), replace=False, shuffle=False))
