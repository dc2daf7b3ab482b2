"""The projector's light: stripes as they arrive, grey levels as they shine, black as it leaks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

MAX_HARMONICS = 199


def stripe_light(
    position_px: Array,
    *,
    period_px: float,
    duty: float,
    n_shifts: int,
    blur_px: float = 0.0,
    pixel_px: float = 0.0,
    transfer: Callable[[float], float] | None = None,
) -> Array:
    """Return the light of shifted square stripes, 0 dark to 1 lit, (n_shifts, ...).

    Shift k of N is lit where ``(u - k T/N) mod T < duty T``. The blur is Gaussian; a camera pixel
    averages over ``pixel_px``. Summed as a Fourier series, in which both are factors:
    ``p = duty + sum_h 2/(pi h) sin(pi h duty) B_h cos(2 pi h (u - u_k)/T)``, u_k the middle of
    the lit part.

    Parameters
    ----------
    position_px : any shape, u, projector px from the edge of its first pixel
    blur_px : standard deviation, projector px
    pixel_px : width of a camera pixel, projector px
    transfer : measured contrast of stripes against their period, which stands for blur and pixel
        of every harmonic (`calibration.contrast`)

    Raises
    ------
    CalibrationError
        If period or blur are not physical.
    """
    if not (period_px > 0.0 and 0.0 < duty < 1.0 and blur_px >= 0.0 and pixel_px >= 0.0):
        msg = f"stripes of period {period_px} px, duty {duty}, blur {blur_px} px are not physical."
        raise CalibrationError(msg)
    turn = 2.0 * np.pi * position_px / period_px
    middles = np.pi * duty + 2.0 * np.pi * np.arange(n_shifts) / n_shifts
    phase = turn[None] - middles.reshape(-1, *([1] * position_px.ndim))
    light = np.full(phase.shape, duty)
    for h in range(1, MAX_HARMONICS + 1):
        smear = math.exp(-0.5 * (2.0 * math.pi * h * blur_px / period_px) ** 2)
        smear *= 1.0 if transfer is None else transfer(period_px / h)
        amplitude = 2.0 / (math.pi * h) * smear * float(np.sinc(h * pixel_px / period_px))
        if smear < 1e-9:
            break
        light += amplitude * math.sin(math.pi * h * duty) * np.cos(h * phase)
    return light


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorGamma:
    """Light of the projector against grey level, and back.

    Attributes
    ----------
    levels, light : (n,), shares of white; light never falls
    exponent : of ``light = level^exponent``, the nearest power; a note, not what is used
    residual : rms of the measured light about the rising curve, share of white
    """

    levels: Array
    light: Array
    exponent: float
    residual: float

    def light_at(self, level: Array) -> Array:
        """Return the light of grey levels, both shares of white."""
        return np.interp(level, self.levels, self.light)

    def level_for(self, light: Array) -> Array:
        """Return the grey levels that give a light, both shares of white."""
        rising = np.r_[True, np.diff(self.light) > 0.0]
        return np.interp(light, self.light[rising], self.levels[rising])


def fit_gamma(levels: Sequence[float], light: Sequence[float]) -> ProjectorGamma:
    """Fit a rising curve to the light of a ramp of grey levels, black taken off.

    The nearest rising sequence in the sense of least squares: neighbours that fall are pooled.

    Parameters
    ----------
    levels : shares of white, from 0 to 1, each once
    light : mean of the pictures, any unit

    Raises
    ------
    CalibrationError
        If there are fewer than four levels, black or white is missing, or white is no brighter.
    """
    order = np.argsort(np.asarray(levels, dtype=np.float64))
    x = np.asarray(levels, dtype=np.float64)[order]
    y = np.asarray(light, dtype=np.float64)[order]
    if x.size < 4 or x[0] != 0.0 or x[-1] != 1.0 or (np.diff(x) <= 0.0).any():
        msg = (
            f"a ramp of {x.size} grey levels from {x.min():g} to {x.max():g}: 4 or more that "
            "differ, black (0) and white (1) among them, are needed."
        )
        raise CalibrationError(msg)
    if not y[-1] > y[0]:
        msg = "white of the ramp is no brighter than its black; are the levels in order?"
        raise CalibrationError(msg)
    share = (y - y[0]) / (y[-1] - y[0])
    curve = np.clip(_rising(share), 0.0, None)
    curve = curve / curve[-1]
    inside = (x > 0.0) & (x < 1.0) & (curve > 1e-4)
    exponent = float("nan")
    if inside.any():
        log_x, log_y = np.log(x[inside]), np.log(curve[inside])
        exponent = float((log_x @ log_y) / (log_x @ log_x))
    return ProjectorGamma(
        levels=x,
        light=curve,
        exponent=exponent,
        residual=float(np.sqrt(np.mean((share - curve) ** 2))),
    )


def black_leak(white: Array, black: Array) -> Array:
    """Return b, the light of black as a share of white, (rows, cols); ambient taken off both.

    NaN where white is below a twentieth of its brightest.

    Raises
    ------
    CalibrationError
        If black is not darker than white.
    """
    if not np.nanmedian(white) > np.nanmedian(black):
        msg = "the black picture is as bright as the white one; are they swapped?"
        raise CalibrationError(msg)
    with np.errstate(invalid="ignore", divide="ignore"):
        bright = white > 0.05 * np.nanpercentile(white, 99.0)
        return np.where(bright, black / white, np.nan)


def _rising(values: Array) -> Array:
    """Return the rising sequence nearest to values, by pooling neighbours that fall."""
    means: list[float] = []
    sizes: list[int] = []
    for value in values:
        means.append(float(value))
        sizes.append(1)
        while len(means) > 1 and means[-2] > means[-1]:
            size = sizes[-2] + sizes[-1]
            means[-2:] = [(means[-2] * sizes[-2] + means[-1] * sizes[-1]) / size]
            sizes[-2:] = [size]
    return np.repeat(means, sizes)
