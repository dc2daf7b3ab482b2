"""Dark frames into a map: the offset of every pixel, its dark current, and which pixels are hot."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.model import refuse_unfit_frame

Array = NDArray[np.float32]

HOT_DEVIATIONS = 6.0  # robust standard deviations of the map beyond which a pixel is hot
BRIGHT_SHARE = 0.25  # of the range; a dark frame above it saw light
SAME_EXPOSURE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class DarkMap:
    """What every pixel counts without light: ``offset + current t``.

    Attributes
    ----------
    offset_dn : (rows, cols), at exposure zero, or at the one exposure taken
    current_dn_per_s : (rows, cols); None if only one exposure was taken
    temporal_variance_dn2 : of one pixel in one frame, mean over the pixels
    mean_exposure_s, spread_s2 : mean of the frames' exposures and the sum of squares about it
    hot : (rows, cols), pixels that stand out; a mask to interpolate over, nothing is filled
    """

    offset_dn: Array
    current_dn_per_s: Array | None
    temporal_variance_dn2: float
    exposures_s: tuple[float, ...]
    mean_exposure_s: float
    spread_s2: float
    n_frames: int
    hot: NDArray[np.bool_]

    def at(self, exposure_s: float) -> Array:
        """Return the dark level of every pixel at an exposure, (rows, cols) DN.

        Raises
        ------
        CalibrationError
            If the dark current is unknown and the exposure is another.
        """
        if self.current_dn_per_s is not None:
            return np.asarray(self.offset_dn + np.float32(exposure_s) * self.current_dn_per_s)
        taken = self.exposures_s[0]
        if abs(exposure_s - taken) > SAME_EXPOSURE * taken:
            msg = (
                f"dark frames were taken at {taken:g} s only, {exposure_s:g} s is wanted: the dark "
                "current is unknown; take dark frames at two exposures or more."
            )
            raise CalibrationError(msg)
        return self.offset_dn

    def variance_at(self, exposure_s: float) -> float:
        """Return the variance of the map itself at an exposure, DN^2."""
        lever = (exposure_s - self.mean_exposure_s) ** 2
        extra = lever / self.spread_s2 if self.current_dn_per_s is not None else 0.0
        return self.temporal_variance_dn2 * (1.0 / self.n_frames + extra)


def fit_dark(
    frames: Iterable[tuple[float, NDArray[np.uint16]]],
    *,
    bits: int,
    white_level_dn: float,
) -> DarkMap:
    """Fit offset and dark current of every pixel by a line over exposures, frame after frame.

    Sums of counts, their squares and their products with exposure are all that is kept: four
    pictures of memory, whatever the number of frames.

    Parameters
    ----------
    frames : exposure in s and counts (rows, cols)

    Raises
    ------
    CalibrationError
        If there are fewer than two frames, or one is bright.
    """
    sums = _Sums()
    for exposure_s, frame in frames:
        refuse_unfit_frame(frame, bits=bits, like=sums.like)
        level = float(frame.mean())
        if level > BRIGHT_SHARE * white_level_dn:
            msg = (
                f"a dark frame of {exposure_s:g} s has a mean of {level:.0f} DN of "
                f"{white_level_dn:g}: was the lens capped?"
            )
            raise CalibrationError(msg)
        sums.add(exposure_s, frame)
    if sums.n < 2 or sums.like is None:
        msg = f"{sums.n} dark frame: its noise cannot be told from its pattern; take 2 or more."
        raise CalibrationError(msg)
    return sums.line()


class _Sums:
    """What a line of every pixel needs of the frames."""

    def __init__(self) -> None:
        self.n = 0
        self.like: NDArray[np.uint16] | None = None
        self._times: list[float] = []

    def add(self, exposure_s: float, frame: NDArray[np.uint16]) -> None:
        if self.like is None:
            self.like = frame
            self._sum, self._squares, self._with_time = (np.zeros(frame.shape) for _ in range(3))
        counts = frame.astype(np.float64)
        self._sum += counts
        self._squares += counts**2
        self._with_time += exposure_s * counts
        self._times.append(exposure_s)
        self.n += 1

    def line(self) -> DarkMap:
        t = np.asarray(self._times)
        n, middle = self.n, float(t.mean())
        spread = float(((t - middle) ** 2).sum())
        several = spread > (SAME_EXPOSURE * middle) ** 2
        mean = self._sum / n
        slope = (self._with_time - middle * self._sum) / spread if several else np.zeros_like(mean)
        rest = self._squares - n * mean**2 - slope**2 * (spread if several else 0.0)
        freedom = n - (2 if several else 1)
        temporal = float(rest.mean()) / freedom if freedom else math.nan
        offset = mean - slope * middle
        return DarkMap(
            offset_dn=offset.astype(np.float32),
            current_dn_per_s=slope.astype(np.float32) if several else None,
            temporal_variance_dn2=temporal,
            exposures_s=tuple(sorted(set(self._times))),
            mean_exposure_s=middle,
            spread_s2=spread,
            n_frames=n,
            hot=outliers(mean) | outliers(slope) if several else outliers(mean),
        )


def outliers(picture: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return pixels (rows, cols) more than six robust deviations off the median."""
    middle = float(np.median(picture))
    scale = 1.4826 * float(np.median(np.abs(picture - middle)))
    if scale == 0.0:
        return np.asarray(picture != middle)
    return np.asarray(np.abs(picture - middle) > HOT_DEVIATIONS * scale)
