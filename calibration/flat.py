"""Frames of uniform light into the relative response of every pixel."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.dark import DarkMap
from calibration.errors import CalibrationError
from calibration.model import CameraModel, refuse_unfit_frame

Array = NDArray[np.float32]

DIM_SHARE = 0.05  # of the range: a flat below it is mostly noise
LOST_SHARE = 0.01  # of the pixels; more of them saturated and the exposure is wrong
DEAD_BELOW, BURNT_ABOVE = 0.5, 2.0  # of the median response


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatField:
    """How strongly every pixel answers, relative to the median pixel.

    Attributes
    ----------
    relative : (rows, cols), one in the median; NaN where every frame was saturated
    variance : (rows, cols), of it; NaN if gain or read noise is unknown
    usable : (rows, cols), False for dead, hot and saturated pixels; nothing is filled
    nonuniformity : robust standard deviation of ``relative``, its noise taken off
    """

    relative: Array
    variance: Array
    usable: NDArray[np.bool_]
    nonuniformity: float
    n_frames: int


def fit_flat(
    frames: Iterable[tuple[float, NDArray[np.uint16]]], dark: DarkMap, camera: CameraModel
) -> FlatField:
    """Reduce frames of uniform light, one after the other, to ``f = sum (y - d) / sum (t + t0)``.

    Saturated pixels of a frame are left out of both sums; f is divided by its median.

    Parameters
    ----------
    frames : exposure in s and counts (rows, cols)

    Raises
    ------
    CalibrationError
        If there is no frame, or the light is too dim, too bright, or below the dark frames.
    """
    shape = dark.offset_dn.shape
    signal, noise, time_s = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    floor, gain, n = camera.floor_variance_dn2, camera.gain_dn_per_e, 0
    for exposure_s, frame in frames:
        refuse_unfit_frame(frame, bits=camera.bits)
        if frame.shape != shape:
            msg = f"flat frames of {frame.shape} px and dark frames of {shape}: one size is needed."
            raise CalibrationError(msg)
        seen = frame < camera.saturation_dn
        net = frame - dark.at(exposure_s)
        _refuse_level(float(net.mean()), 1.0 - float(seen.mean()), exposure_s, camera)
        signal += np.where(seen, net, 0.0)
        noise += seen * dark.variance_at(exposure_s)
        if floor is not None and gain is not None:
            noise += np.where(seen, gain * np.maximum(net, 0.0) + floor, 0.0)
        time_s += seen * (exposure_s + camera.shutter_offset_s)
        n += 1
    if n == 0:
        msg = "there is no frame of role flat: take some of uniform light, half of the range."
        raise CalibrationError(msg)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = signal / time_s
        variance = noise / time_s**2 if floor is not None else np.full(shape, np.nan)
    middle = float(np.nanmedian(rate))
    relative = rate / middle
    relative_variance = variance / middle**2
    with np.errstate(invalid="ignore"):
        usable = (relative > DEAD_BELOW) & (relative < BURNT_ABOVE) & ~dark.hot
    spread = 1.4826 * float(np.nanmedian(np.abs(relative - 1.0)))
    own = float(np.nanmedian(relative_variance)) if floor is not None else 0.0
    return FlatField(
        relative=relative.astype(np.float32),
        variance=relative_variance.astype(np.float32),
        usable=usable,
        nonuniformity=max(spread**2 - own, 0.0) ** 0.5,
        n_frames=n,
    )


def _refuse_level(net: float, lost: float, exposure_s: float, camera: CameraModel) -> None:
    span = camera.white_level_dn - camera.black_level_dn
    if net <= 0.0:
        msg = (
            f"the flat frame of {exposure_s:g} s is {-net:.1f} DN darker than the dark frames; are "
            "they swapped?"
        )
        raise CalibrationError(msg)
    if lost > LOST_SHARE:
        msg = (
            f"{100 * lost:.1f} % of the flat frame of {exposure_s:g} s is saturated; expose "
            "to half of the range."
        )
        raise CalibrationError(msg)
    if net < DIM_SHARE * span:
        msg = (
            f"the flat frame of {exposure_s:g} s reaches {net:.0f} DN of {span:.0f}; expose to "
            "half of the range."
        )
        raise CalibrationError(msg)
