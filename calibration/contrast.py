"""How much of a stripe's contrast arrives: blur of projector and camera, measured, not assumed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

MIN_PIXELS = 1000
STEEPEST, SMOOTHEST = 1.0, 2.0  # exponent of the blur: a disc of light with far tails; a Gaussian


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeTransfer:
    """Contrast of the fundamental of stripes against their period, one for a sharp pattern.

    ``m(T) = level exp(-(reach_px / T)^exponent)``; exponent 2 is a Gaussian blur of standard
    deviation ``reach / (sqrt(2) pi)``, 1 the long tails of a real lens; ``level`` below one is
    light spread so far that every period loses it alike.

    Attributes
    ----------
    periods_px, measured : (n,), the contrasts that were fitted
    residual : rms of ``ln m`` about the fit
    """

    level: float
    reach_px: float
    exponent: float
    periods_px: Array
    measured: Array
    residual: float

    def at(self, period_px: float) -> float:
        """Return the contrast of stripes of a period, projector px."""
        return self.level * math.exp(-((self.reach_px / period_px) ** self.exponent))


def measure_transfer(
    difference: Array, contrast: Array, position_px: Array, *, period_px: float, offset_px: float
) -> float:
    """Return the contrast of stripes of one period, from a pattern and its inverse.

    ``m = |sum r exp(-2 pi i u/T)| / n / (2/pi)`` with r = (plain - inverse)/(white - black), whose
    fundamental is 4/pi in amplitude if the stripes are sharp.

    Parameters
    ----------
    difference, contrast : (n,), plain less inverse and white less black, of sure pixels
    position_px : (n,), projector px
    offset_px : where a lit stripe begins, projector px

    Raises
    ------
    CalibrationError
        If pixels are too few.
    """
    if difference.size < MIN_PIXELS:
        msg = (
            f"{difference.size} decoded pixels, {MIN_PIXELS} are needed to measure the contrast of "
            "stripes; light more of the picture."
        )
        raise CalibrationError(msg)
    turn = 2.0 * np.pi * (position_px - offset_px) / period_px
    return float(np.mean(difference / contrast * np.sin(turn)) * math.pi / 2.0)


def fit_transfer(measured: Mapping[float, float]) -> StripeTransfer:
    """Fit the contrast against the period, by least squares of its logarithm.

    Raises
    ------
    CalibrationError
        If fewer than three periods have a positive contrast, or finer stripes have more of it.
    """
    periods = np.array(sorted(p for p, m in measured.items() if m > 0.0))
    values = np.array([measured[p] for p in periods])
    if periods.size < 3:
        msg = (
            f"stripes of {periods.size} periods show contrast; 3 or more are needed to tell blur "
            "from lost light."
        )
        raise CalibrationError(msg)

    def off(p: Array) -> Array:
        return np.asarray(p[0] - np.exp(p[2] * (p[1] - np.log(periods))) - np.log(values))

    guess = np.array([math.log(values[-1]), math.log(float(periods[0]) / 2.0), 1.5])
    bounds = ([-3.0, -8.0, STEEPEST], [0.3, math.log(20.0 * periods[0]), SMOOTHEST])
    found = least_squares(off, np.clip(guess, *bounds), bounds=bounds)
    level, reach, exponent = (float(v) for v in found.x)
    if values[0] > values[-1] * 1.05:
        msg = (
            f"stripes of {periods[0]:g} px have more contrast than stripes of {periods[-1]:g} px: "
            "the pictures do not belong to these periods."
        )
        raise CalibrationError(msg)
    return StripeTransfer(
        level=math.exp(level),
        reach_px=math.exp(reach),
        exponent=exponent,
        periods_px=periods,
        measured=values,
        residual=float(np.sqrt(np.mean(found.fun**2))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ContrastAtDepth:
    """c1, the amplitude of the stripes' fundamental under white light, against depth.

    ``ln c1 = a0 + a1 z + a2 z^2`` with z the depth from -1 to 1 over the measured range: defocus
    makes c1 a Gaussian in depth.
    """

    coefficients: tuple[float, float, float]
    covariance: Array
    depth_range: tuple[float, float]
    unit: str
    period_px: float
    depth: Array
    measured: Array

    def at(self, depth: Array) -> Array:
        """Return c1 at depths, (n,); refuse depths outside what was measured.

        Raises
        ------
        CalibrationError
            If a depth lies more than a tenth of the range outside.
        """
        low, high = self.depth_range
        room = 0.1 * (high - low)
        if depth.min() < low - room or depth.max() > high + room:
            msg = (
                f"c1 was measured from {low:g} to {high:g} {self.unit}, depths from "
                f"{depth.min():g} to {depth.max():g} are wanted; measure it over the whole depth."
            )
            raise CalibrationError(msg)
        z = (depth - 0.5 * (low + high)) / (0.5 * (high - low))
        return np.asarray(np.exp(np.polynomial.polynomial.polyval(z, self.coefficients)))


def fit_contrast(
    amplitude: NDArray[np.floating[Any]], white: Array, depth: Array, *, unit: str, period_px: float
) -> ContrastAtDepth:
    """Fit c1 against depth from stripes on a white target that lies along the depth.

    Parameters
    ----------
    amplitude : (rows, cols), |z| = c1 D of the shifted stripes, columns into the depth
    white : (rows, cols), white less black; dim pixels are left out
    depth : (cols,), depth of the columns

    Raises
    ------
    CalibrationError
        If fewer than eight columns show light and contrast.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = amplitude / white
        bright = np.isfinite(ratio) & (white > 0.2 * np.nanpercentile(white, 99.0))
    good = bright.sum(axis=0) >= max(8, 0.2 * amplitude.shape[0])
    if good.sum() < 8:
        msg = (
            f"{int(good.sum())} columns of the white target are lit, 8 or more are needed; let it "
            "fill the depth."
        )
        raise CalibrationError(msg)
    c1 = np.array([np.median(ratio[bright[:, k], k]) for k in np.flatnonzero(good)])
    at = depth[good]
    if (c1 <= 0.0).any():
        msg = "the white target shows no stripes in part of the depth; focus the projector there."
        raise CalibrationError(msg)
    low, high = float(at.min()), float(at.max())
    z = (at - 0.5 * (low + high)) / (0.5 * (high - low))
    rows = np.stack([np.ones_like(z), z, z**2], axis=1)
    solution, *_ = np.linalg.lstsq(rows, np.log(c1), rcond=None)
    rest = np.log(c1) - rows @ solution
    scale = float(rest @ rest) / max(z.size - 3, 1)
    a0, a1, a2 = (float(v) for v in solution)
    return ContrastAtDepth(
        coefficients=(a0, a1, a2),
        covariance=np.linalg.inv(rows.T @ rows) * scale,
        depth_range=(low, high),
        unit=unit,
        period_px=period_px,
        depth=at,
        measured=c1,
    )
