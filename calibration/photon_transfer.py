"""Photon transfer after EMVA 1288: gain, noise and linearity of a camera from pairs of frames.

Frames of uniform light and dark frames at the same exposures; the light may be as uneven as a lamp
is, for the noise is taken from differences of frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.model import refuse_unfit_frame

Array = NDArray[np.float64]

FITTED_SHARE = 0.7  # of saturation: EMVA 1288 fits below it
CLIPPED_SHARE = 1e-3  # of the pixels; a level with more of them tells nothing about noise
NOT_LINEAR = 0.05  # deviation from a line above which gain means nothing
MARKED_SHARE = 0.01  # of the exposure; a shutter offset above it is worth a mark


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """What the frames of one exposure say.

    Attributes
    ----------
    mean_dn : over pixels and frames
    variance_dn2 : temporal, of one pixel, mean over the pixels
    spatial_variance_dn2 : of the pixels' true means, temporal noise taken off; may be negative
    clipped_share : pixels at the white level, of all
    """

    exposure_s: float
    mean_dn: float
    variance_dn2: float
    spatial_variance_dn2: float
    clipped_share: float
    n_frames: int
    n_pixels: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotonTransfer:
    """Gain and noise of a camera, with the curve they come from.

    Attributes
    ----------
    gain_dn_per_e : K, slope of variance against mean through the origin
    dark_noise_e : standard deviation without light at exposure zero, quantisation taken off
    saturation_e : light at the largest variance; NaN if no exposure reached saturation
    shutter_offset_s : t0 of ``mean - dark = R (t + t0)``
    linearity : smallest and largest deviation from that line, share of it, over the fitted levels
    dsnu_e, prnu : spatial standard deviations of dark offset, electrons, and of response, share
    exposures_s, mean_dn, variance_dn2 : the curve, (n,), dark taken off
    fitted : (n,), which levels were fitted; clipped ones never are
    marked_exposures_s : where t0 exceeds 1 percent of the exposure
    """

    gain_dn_per_e: float
    gain_std: float
    dark_noise_e: float
    dark_noise_std: float
    dark_level_dn: float
    saturation_e: float
    shutter_offset_s: float
    shutter_offset_std: float
    response_dn_per_s: float
    linearity: tuple[float, float]
    dsnu_e: float
    prnu: float
    exposures_s: Array
    mean_dn: Array
    variance_dn2: Array
    deviation: Array
    fitted: NDArray[np.bool_]
    marked_exposures_s: tuple[float, ...]


def measure_level(
    frames: Iterable[NDArray[np.uint16]], exposure_s: float, *, bits: int, white_level_dn: float
) -> Level:
    """Reduce the frames (rows, cols) of one exposure, taken one after the other.

    The temporal variance is the mean over successive pairs of
    ``mean((a - b)^2)/2 - (mean a - mean b)^2/2`` (EMVA 1288, Eq. 21), which a lamp that drifts
    and a field that is uneven leave alone. Two frames' memory serves any number of them.

    Raises
    ------
    CalibrationError
        If there are fewer than two frames, or one is no frame of this camera.
    """
    total: Array | None = None
    last: NDArray[np.uint16] | None = None
    pairs, clipped, n = [], 0.0, 0
    for frame in frames:
        refuse_unfit_frame(frame, bits=bits, like=last)
        clipped += float(np.mean(frame >= white_level_dn))
        total = frame.astype(np.float64) if total is None else total + frame
        if last is not None:
            difference = last.astype(np.float32) - frame
            pairs.append(0.5 * float(np.var(difference, dtype=np.float64)))
        last, n = frame, n + 1
    if total is None or n < 2:
        msg = (
            f"{n} frame at {exposure_s:g} s: noise is the difference of two frames of the same "
            "light; take a pair at each exposure."
        )
        raise CalibrationError(msg)
    mean = total / n
    variance = float(np.mean(pairs))
    return Level(
        exposure_s=exposure_s,
        mean_dn=float(mean.mean()),
        variance_dn2=variance,
        spatial_variance_dn2=float(mean.var()) - variance / n,
        clipped_share=clipped / n,
        n_frames=n,
        n_pixels=mean.size,
    )


def fit_photon_transfer(lights: Sequence[Level], darks: Sequence[Level]) -> PhotonTransfer:
    """Fit ``Var - Var_dark = K (mean - mean_dark)`` through the origin, 0 to 70 % of saturation.

    ``sigma_d^2 = (Var_dark - 1/12)/K^2`` with Var_dark extrapolated to exposure zero. The shutter
    offset t0 is fitted by relative deviations, for it shows in the shortest exposures.

    Raises
    ------
    CalibrationError
        If exposures are too few or all equal, have no dark frames, if dark frames are brighter
        than light ones, or if the camera is not linear.
    """
    pairs = _paired(lights, darks)
    t = np.array([light.exposure_s for light, _ in pairs])
    mean = np.array([light.mean_dn - dark.mean_dn for light, dark in pairs])
    variance = np.array([light.variance_dn2 - dark.variance_dn2 for light, dark in pairs])
    whole = np.array([light.clipped_share <= CLIPPED_SHARE for light, _ in pairs])
    _refuse_dark(t, mean)
    saturated = bool((~whole).any())
    top = _saturation(mean, variance, whole)
    fitted = whole & (mean <= FITTED_SHARE * top)
    gain, gain_std = _gain(mean[fitted], variance[fitted])
    rate, offset_s, offset_std = _line(t[fitted], mean[fitted])
    deviation = mean / (rate * (t + offset_s)) - 1.0
    low, high = float(deviation[fitted].min()), float(deviation[fitted].max())
    _refuse_bent(low, high)
    dark_variance, dark_std = _dark_variance([dark for _, dark in pairs])
    noise_e = math.sqrt(max(dark_variance - 1.0 / 12.0, 0.0)) / gain
    middle = pairs[int(np.argmin(np.where(whole, np.abs(mean - 0.5 * top), np.inf)))]
    return PhotonTransfer(
        gain_dn_per_e=gain,
        gain_std=gain_std,
        dark_noise_e=noise_e,
        dark_noise_std=math.hypot(
            0.5 * dark_std / max(noise_e * gain**2, 1e-12), noise_e * gain_std / gain
        ),
        dark_level_dn=float(np.mean([dark.mean_dn for _, dark in pairs])),
        saturation_e=float(top / gain) if saturated else math.nan,
        shutter_offset_s=offset_s,
        shutter_offset_std=offset_std,
        response_dn_per_s=rate,
        linearity=(low, high),
        dsnu_e=_spatial(pairs[0][1].spatial_variance_dn2) / gain,
        prnu=_spatial(middle[0].spatial_variance_dn2 - middle[1].spatial_variance_dn2)
        / (middle[0].mean_dn - middle[1].mean_dn),
        exposures_s=t,
        mean_dn=mean,
        variance_dn2=variance,
        deviation=np.where(whole, deviation, np.nan),
        fitted=fitted,
        marked_exposures_s=tuple(float(e) for e in t if abs(offset_s) > MARKED_SHARE * e),
    )


def _paired(lights: Sequence[Level], darks: Sequence[Level]) -> list[tuple[Level, Level]]:
    """Return each light level with the dark level of its exposure, shortest first."""
    times = sorted({level.exposure_s for level in lights})
    if len(times) < 3:
        msg = (
            f"light at {len(times)} exposures ({', '.join(f'{t:g}' for t in times)} s): a photon "
            "transfer needs 3 or more that differ; take a ramp."
        )
        raise CalibrationError(msg)
    by_time = {level.exposure_s: level for level in darks}
    absent = [t for t in times if t not in by_time]
    if absent:
        msg = f"no dark frames at {absent[0]:g} s; take a pair at every exposure of the light."
        raise CalibrationError(msg)
    ordered = sorted(lights, key=lambda level: level.exposure_s)
    return [(light, by_time[light.exposure_s]) for light in ordered]


def _refuse_dark(t: Array, mean: Array) -> None:
    if (mean <= 0.0).any():
        worst = int(np.argmin(mean))
        msg = (
            f"at {t[worst]:g} s the dark frames are {-mean[worst]:.1f} DN brighter than the light "
            "ones; are they swapped, or was the lens not capped?"
        )
        raise CalibrationError(msg)


def _saturation(mean: Array, variance: Array, whole: NDArray[np.bool_]) -> float:
    """Return the mean at the largest variance, where EMVA 1288 puts saturation."""
    return float(mean[int(np.argmax(np.where(whole, variance, -np.inf)))])


def _gain(mean: Array, variance: Array) -> tuple[float, float]:
    """Return K of the fitted levels with its std."""
    if mean.size < 3:
        msg = (
            f"{mean.size} exposures without clipping below {100 * FITTED_SHARE:.0f} % of "
            "saturation, 3 are needed; take shorter ones."
        )
        raise CalibrationError(msg)
    gain, gain_std = _slope(mean, variance)
    if not gain > 0.0:
        msg = "variance does not grow with the light: these are no frames of one camera setting."
        raise CalibrationError(msg)
    return gain, gain_std


def _slope(mean: Array, variance: Array) -> tuple[float, float]:
    """Return the slope through the origin with its std, from the scatter of the levels."""
    power = float(mean @ mean)
    slope = float(mean @ variance) / power
    rest = variance - slope * mean
    return slope, math.sqrt(float(rest @ rest) / (mean.size - 1) / power)


def _line(t: Array, mean: Array) -> tuple[float, float, float]:
    """Return R, t0 and its std of ``mean = R (t + t0)``, relative deviations least."""
    rows = np.stack([t / mean, 1.0 / mean], axis=1)
    solution, *_ = np.linalg.lstsq(rows, np.ones(t.size), rcond=None)
    rest = rows @ solution - 1.0
    covariance = np.linalg.inv(rows.T @ rows) * float(rest @ rest) / max(t.size - 2, 1)
    rate, at_zero = (float(v) for v in solution)
    return rate, at_zero / rate, math.sqrt(covariance[1, 1]) / abs(rate)


def _refuse_bent(low: float, high: float) -> None:
    worst = max(low, high, key=abs)
    if abs(worst) > NOT_LINEAR:
        msg = (
            f"the mean departs from a line in exposure by {100 * worst:+.1f} % (limit "
            f"{100 * NOT_LINEAR:.0f} %): the camera is not linear; take raw frames, or fit its "
            "response first."
        )
        raise CalibrationError(msg)


def _dark_variance(darks: Sequence[Level]) -> tuple[float, float]:
    """Return the dark variance at exposure zero with its std: dark current adds noise in time."""
    t = np.array([level.exposure_s for level in darks])
    variance = np.array([level.variance_dn2 for level in darks])
    rows = np.stack([np.ones(t.size), t - 0.0], axis=1)
    solution, *_ = np.linalg.lstsq(rows, variance, rcond=None)
    rest = variance - rows @ solution
    covariance = np.linalg.inv(rows.T @ rows) * float(rest @ rest) / max(t.size - 2, 1)
    return float(solution[0]), math.sqrt(covariance[0, 0])


def _spatial(variance: float) -> float:
    return math.sqrt(max(variance, 0.0))
