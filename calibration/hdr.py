"""A bracket of exposures merged into one linear radiance, with its variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.model import CameraModel

N_ITERATIONS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Radiance:
    """Linear light of one picture.

    Attributes
    ----------
    value : (rows, cols) float32, counts per second above the black level, signed;
        NaN where every exposure was saturated
    variance : (rows, cols) float32, its square; NaN throughout if gain or read noise is unknown
    valid : (rows, cols), True where at least one exposure was not saturated
    """

    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    valid: NDArray[np.bool_]


def merge(
    frames: Sequence[NDArray[np.uint16]],
    exposures_s: Sequence[float],
    offsets_dn: Sequence[float],
    camera: CameraModel,
) -> Radiance:
    """Merge frames (rows, cols) of one unchanged scene by inverse-variance weights.

    ``E = sum_k v_k t_k^2/V_k (y_k - d_k)/t_k / sum_k v_k t_k^2/V_k`` with
    ``V_k = K E t_k + s_r^2``, started from ``sum v (y - d) / sum v t`` and iterated; v_k = 0 from
    95 percent of the white level on (Granados 2010). Without gain and read noise the start is the
    answer, and no variance is invented.

    Raises
    ------
    CalibrationError
        If shapes differ, counts exceed the camera's bits, an exposure is not positive, or no pixel
        is left.
    """
    _refuse_bad_bracket(frames, exposures_s, offsets_dn, camera)
    shape = frames[0].shape
    value = np.empty(shape, dtype=np.float32)
    variance = np.empty(shape, dtype=np.float32)
    floor = camera.floor_variance_dn2
    _merge(
        np.stack([frame.ravel() for frame in frames]),
        np.asarray(exposures_s, dtype=np.float64),
        np.asarray(offsets_dn, dtype=np.float64),
        camera.saturation_dn,
        (camera.gain_dn_per_e or 0.0, floor or 0.0),
        N_ITERATIONS if floor is not None else 0,
        value.reshape(-1),
        variance.reshape(-1),
    )
    valid = np.isfinite(value)
    if not valid.any():
        msg = (
            f"every pixel of the bracket {list(exposures_s)} s is saturated "
            f"(>= {camera.saturation_dn:.0f} DN); add a shorter exposure."
        )
        raise CalibrationError(msg)
    return Radiance(value=value, variance=variance, valid=valid)


def _refuse_bad_bracket(
    frames: Sequence[NDArray[np.uint16]],
    exposures_s: Sequence[float],
    offsets_dn: Sequence[float],
    camera: CameraModel,
) -> None:
    if not frames or not len(frames) == len(exposures_s) == len(offsets_dn):
        msg = (
            f"{len(frames)} frames, {len(exposures_s)} exposures and {len(offsets_dn)} offsets "
            "do not make a bracket; one of each is needed for every frame."
        )
        raise CalibrationError(msg)
    for frame, exposure_s in zip(frames, exposures_s, strict=True):
        if frame.shape != frames[0].shape:
            msg = f"frames of {frames[0].shape} and {frame.shape} px cannot be merged."
            raise CalibrationError(msg)
        if not exposure_s > 0.0:
            msg = f"exposure {exposure_s} s is not positive."
            raise CalibrationError(msg)
        if int(frame.max()) >= 2**camera.bits:
            msg = (
                f"a frame holds {int(frame.max())} DN, more than {camera.bits} bits can; "
                "declare the right bits, or shift left-aligned data to the right."
            )
            raise CalibrationError(msg)


@njit(cache=True, nogil=True)
def _merge(
    counts: NDArray[np.uint16],
    exposures_s: NDArray[np.float64],
    offsets_dn: NDArray[np.float64],
    saturation_dn: float,
    noise: tuple[float, float],
    n_iterations: int,
    value: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    """Merge counts (n_exposures, n_pixels) into value and variance (n_pixels,)."""
    gain, floor = noise
    for pixel in range(counts.shape[1]):
        signal, time = 0.0, 0.0
        for k in range(counts.shape[0]):
            if counts[k, pixel] < saturation_dn:
                signal += counts[k, pixel] - offsets_dn[k]
                time += exposures_s[k]
        if time == 0.0:
            value[pixel] = np.nan
            variance[pixel] = np.nan
            continue
        estimate = signal / time
        information = np.nan
        for _ in range(n_iterations):
            information, weighted = 0.0, 0.0
            for k in range(counts.shape[0]):
                if counts[k, pixel] < saturation_dn:
                    t = exposures_s[k]
                    weight = t / (gain * max(estimate, 0.0) * t + floor)
                    information += weight * t
                    weighted += weight * (counts[k, pixel] - offsets_dn[k])
            estimate = weighted / information
        value[pixel] = estimate
        variance[pixel] = 1.0 / information
