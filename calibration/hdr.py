"""A bracket of exposures merged into one linear radiance, with its variance.

Frames are taken one after the other and added to the sums of their exposure: memory is two
pictures for each exposure that differs, whatever the number of frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.flat import FlatField
from calibration.model import CameraModel, refuse_unfit_frame

N_ITERATIONS = 3
BLOCK = 512  # pixels whose intermediate sums stay in the fastest memory
Offset = float | NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Radiance:
    """Linear light of one picture.

    Attributes
    ----------
    value : (rows, cols) float32, linear counts per second above the dark level, signed;
        NaN where every exposure was saturated or the pixel is not usable
    variance : (rows, cols) float32, its square; NaN throughout if gain or read noise is unknown
    valid : (rows, cols), True where at least one exposure was not saturated
    """

    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    valid: NDArray[np.bool_]


def merge(
    frames: Iterable[NDArray[np.uint16]],
    exposures_s: Sequence[float],
    offsets_dn: Sequence[Offset],
    camera: CameraModel,
    flat: FlatField | None = None,
) -> Radiance:
    """Merge frames (rows, cols) of one unchanged scene by inverse-variance weights.

    ``E = sum_k v_k t_k^2/V_k (y_k - d_k)/t_k / sum_k v_k t_k^2/V_k`` with
    ``V_k = K E t_k + s_r^2``, started from ``sum v (y - d) / sum v t`` and iterated; v_k = 0 from
    95 percent of the white level on, and, in all but the shortest exposure, beside a pixel at the
    white level, which may have bloomed (Granados 2010). Without gain and read noise the start is
    the answer, and no variance is invented. Exposures are lengthened by the camera's shutter
    offset. A flat field divides E and adds its own variance, ``E^2 var f / f^2``.

    Parameters
    ----------
    frames : counts (rows, cols), read once, in order
    offsets_dn : dark level of each frame, DN: a number, or a map (rows, cols)

    Raises
    ------
    CalibrationError
        If shapes differ, counts exceed the camera's bits, an exposure is not positive, or no pixel
        is left.
    """
    _refuse_bad_exposures(exposures_s, offsets_dn, camera)
    times = sorted(set(exposures_s))
    table = camera.response.linear(camera.bits).astype(np.float32)
    first: NDArray[np.uint16] | None = None
    n = 0
    for frame in frames:
        if n == len(exposures_s):
            _refuse_count("more", n, len(exposures_s))
        _refuse_unfit(frame, first, camera)
        if first is None:
            first = frame
            sums = np.zeros((len(times), frame.size), dtype=np.float32)
            counted = np.zeros((len(times), frame.size), dtype=np.uint16)
        k = times.index(exposures_s[n])
        offset = _linear_offset(offsets_dn[n], camera, table, frame.shape)
        # the shortest exposure has nothing shorter to stand in for it
        blooms = k > 0 and int(frame.max()) >= camera.white_level_dn
        levels = (camera.saturation_dn, camera.white_level_dn if blooms else np.inf)
        _add(np.ascontiguousarray(frame), table, offset, levels, sums[k], counted[k])
        n += 1
    if first is None or n < len(exposures_s):
        _refuse_count("only", n, len(exposures_s))
        raise AssertionError
    seconds = np.asarray(times) + camera.shutter_offset_s
    return _finish(sums, counted, seconds, camera, first.shape, flat)


def _finish(
    sums: NDArray[np.float32],
    counted: NDArray[np.uint16],
    seconds: NDArray[np.float64],
    camera: CameraModel,
    shape: tuple[int, ...],
    flat: FlatField | None,
) -> Radiance:
    value, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    floor = camera.floor_variance_dn2
    noise = (camera.gain_dn_per_e or 0.0, floor or 0.0)
    n_iterations = N_ITERATIONS if floor is not None else 0
    _solve(sums, counted, seconds, noise, n_iterations, value.reshape(-1), variance.reshape(-1))
    if flat is not None:
        value, variance = _flattened(value, variance, flat)
    valid = np.isfinite(value)
    if not valid.any():
        msg = (
            f"every pixel of the bracket {[float(f'{t:.6g}') for t in seconds]} s is saturated "
            f"(>= {camera.saturation_dn:.0f} DN); add a shorter exposure."
        )
        raise CalibrationError(msg)
    return Radiance(value=value, variance=variance, valid=valid)


def _flattened(
    value: NDArray[np.float32], variance: NDArray[np.float32], flat: FlatField
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if flat.relative.shape != value.shape:
        msg = f"frames of {value.shape} px and a flat field of {flat.relative.shape}: take a new."
        raise CalibrationError(msg)
    f = np.where(flat.usable, flat.relative, np.float32(np.nan))
    own = np.where(np.isfinite(flat.variance), flat.variance, np.float32(0.0))
    even = (value / f).astype(np.float32)
    return even, ((variance + even**2 * own) / f**2).astype(np.float32)


def _linear_offset(
    offset: Offset, camera: CameraModel, table: NDArray[np.float32], shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Return the dark level in linear counts, (1,) or one a pixel."""
    dark = np.atleast_1d(np.asarray(offset, dtype=np.float32))
    if dark.size > 1 and dark.shape != shape:
        msg = f"frames of {shape} px and a dark map of {dark.shape}: take new dark frames."
        raise CalibrationError(msg)
    if camera.response.table.size:
        dark = np.interp(dark, np.arange(table.size), table).astype(np.float32)
    return dark.reshape(-1)


def _refuse_unfit(
    frame: NDArray[np.uint16], first: NDArray[np.uint16] | None, camera: CameraModel
) -> None:
    if first is not None and frame.shape != first.shape:
        msg = f"frames of {first.shape} and {frame.shape} px cannot be merged."
        raise CalibrationError(msg)
    refuse_unfit_frame(frame, bits=camera.bits)


def _refuse_count(word: str, n_frames: int, n_exposures: int) -> None:
    msg = (
        f"{word} {n_frames} frames for {n_exposures} exposures do not make a bracket; one frame "
        "of each is needed."
    )
    raise CalibrationError(msg)


def _refuse_bad_exposures(
    exposures_s: Sequence[float], offsets_dn: Sequence[Offset], camera: CameraModel
) -> None:
    if not exposures_s or len(exposures_s) != len(offsets_dn):
        msg = (
            f"{len(exposures_s)} exposures and {len(offsets_dn)} offsets do not make a bracket; "
            "one of each is needed for every frame."
        )
        raise CalibrationError(msg)
    for exposure_s in exposures_s:
        if not (exposure_s > 0.0 and exposure_s + camera.shutter_offset_s > 0.0):
            msg = f"exposure {exposure_s} s is not positive."
            raise CalibrationError(msg)


@njit(cache=True, nogil=True)
def _add(
    counts: NDArray[np.uint16],
    table: NDArray[np.float32],
    offset: NDArray[np.float32],
    levels: tuple[float, float],
    total: NDArray[np.float32],
    counted: NDArray[np.uint16],
) -> None:
    """Add linear counts above the offset to total (n_pixels,) where they can be trusted.

    ``levels`` are saturation, and the white level beside which a pixel may have bloomed.
    """
    rows, cols = counts.shape
    saturation, white = levels
    step = 1 if offset.size > 1 else 0
    for y in range(rows):
        above, below = max(y - 1, 0), min(y + 2, rows)
        near = False  # a white pixel in this row or a neighbouring one
        if white < np.inf:
            for v in range(above, below):
                for u in range(cols):
                    near |= counts[v, u] >= white
        for x in range(cols):
            count = counts[y, x]
            seen = count < saturation
            if near and seen:
                for v in range(above, below):
                    for u in range(max(x - 1, 0), min(x + 2, cols)):
                        seen &= counts[v, u] < white
            pixel = y * cols + x
            if seen:
                total[pixel] += table[count] - offset[pixel * step]
                counted[pixel] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(
    sums: NDArray[np.float32],
    counted: NDArray[np.uint16],
    seconds: NDArray[np.float64],
    noise: tuple[float, float],
    n_iterations: int,
    value: NDArray[np.float32],
    variance: NDArray[np.float32],
) -> None:
    """Merge the sums (n_exposures, n_pixels) of each exposure into value and variance.

    In blocks of pixels with the exposures outside, so that the inner loops are vectors.
    """
    gain, floor = noise
    n_exposures, n_pixels = sums.shape
    estimate, information, weighted = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for begin in range(0, n_pixels, BLOCK):
        size = min(BLOCK, n_pixels - begin)
        estimate[:size] = 0.0
        for turn in range(n_iterations + 1):
            information[:size] = 0.0
            weighted[:size] = 0.0
            for k in range(n_exposures):
                t = seconds[k]
                # the first turn is sum (y - d) / sum t: the weights of pure shot noise
                slope, least = (gain, floor / t) if turn else (0.0, 1.0)
                total, n = sums[k, begin : begin + size], counted[k, begin : begin + size]
                for i in range(size):
                    weight = 1.0 / (slope * max(estimate[i], 0.0) + least)
                    information[i] += n[i] * weight * t
                    weighted[i] += weight * total[i]
            for i in range(size):
                estimate[i] = weighted[i] / information[i] if information[i] > 0.0 else np.nan
        for i in range(size):
            value[begin + i] = estimate[i]
            known = n_iterations > 0 and information[i] > 0.0
            variance[begin + i] = 1.0 / information[i] if known else np.nan
