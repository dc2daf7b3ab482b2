"""What is read off a live picture: histogram, clipping, focus, and the exposure that would fit it.

All of it from the raw counts, never from what the eye is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.uint16]
Roi = tuple[int, int, int, int]

DARK_SHARE = 0.01  # of full scale, above black: below it a pixel counts as dark
TARGET = 0.80  # of full scale, where automatic exposure puts the brightest
GOOD = (0.72, 0.88)  # and where it lets it be
GLINTS = 0.001  # share of the pixels that may be brighter
BINS = 256
THIN = 2  # every second row and column make the histogram; shares are of all pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Meter:
    """Readings of one picture.

    Attributes
    ----------
    histogram : (BINS,), pixels between zero and the white level
    saturated, dark : shares of the pixels at the white level, and below a hundredth of the scale
    bright : counts that one pixel in a thousand exceeds, as a share of the white level
    median : likewise of half the pixels
    focus : mean square of the Laplacian over the mean square of the light
    """

    histogram: NDArray[np.int64]
    saturated: float
    dark: float
    bright: float
    median: float
    least_dn: int
    most_dn: int
    focus: float


def read(pixels: Counts, *, black: float, white: int, roi: Roi | None = None) -> Meter:
    """Return the readings of a picture (rows, cols), or of its part x, y, width, height."""
    if roi is not None:
        x, y, width, height = roi
        pixels = pixels[y : y + height, x : x + width]
    thin = pixels[::THIN, ::THIN]
    counts = np.bincount(thin.ravel(), minlength=white + 1)
    below = np.concatenate([[0], np.cumsum(counts)])
    edges = np.linspace(0, white + 1, BINS + 1).astype(np.int64)
    histogram = np.diff(below[edges])
    histogram[-1] += below[-1] - below[white + 1]
    dark = math.ceil(black + DARK_SHARE * (white - black))
    least, most, _, _ = cv2.minMaxLoc(pixels)
    return Meter(
        histogram=histogram,
        saturated=float(np.count_nonzero(pixels >= white) / pixels.size),
        dark=float(np.count_nonzero(pixels < dark) / pixels.size),
        bright=int(np.searchsorted(below[1:], (1.0 - GLINTS) * thin.size)) / white,
        median=int(np.searchsorted(below[1:], 0.5 * thin.size)) / white,
        least_dn=int(least),
        most_dn=int(most),
        focus=focus(pixels, black),
    )


def focus(pixels: Counts, black: float) -> float:
    """Return how sharp a picture is: the energy of its edges over that of its light.

    Pixels are averaged two by two first, or the camera's noise would pass for sharpness.
    """
    small = cv2.resize(pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    light = small.astype(np.float32) - np.float32(black)
    power = float(np.mean(light * light))
    if power <= 0.0:
        return 0.0
    edges = cv2.Laplacian(cv2.GaussianBlur(light, (0, 0), 1.0), cv2.CV_32F)
    return float(np.mean(edges * edges)) / power


def profile_along(
    pixels: Counts, rows: tuple[int, int], region: Roi, *, lit_side: str
) -> NDArray[np.float64]:
    """Return mean counts of the rows from .. to of a picture, from the lit face inwards, (n,)."""
    x, y, width, height = region
    if lit_side in ("left", "right"):
        line = pixels[rows[0] : rows[1], x : x + width].mean(axis=0)
    else:
        line = pixels[y : y + height, rows[0] : rows[1]].mean(axis=1)
    return np.asarray(line[::-1] if lit_side in ("right", "bottom") else line)


def fitting_exposure(
    meter: Meter, exposure_s: float, *, black: float, white: int, limits_s: tuple[float, float]
) -> float:
    """Return the exposure that puts the brightest pixels at the target; the same if they are."""
    low, high = limits_s
    if GOOD[0] <= meter.bright <= GOOD[1]:
        return exposure_s
    floor = black / white
    clips = meter.bright >= 0.99
    factor = 0.25 if clips else (TARGET - floor) / max(meter.bright - floor, 0.02)
    return min(max(exposure_s * factor, low), high)


def bracket_from(exposure_s: float, limits_s: tuple[float, float]) -> tuple[float, ...]:
    """Return three exposures, each four times the one before, of which the first clips nothing."""
    wished = [float(f"{exposure_s * 4.0**k:.3g}") for k in range(3)]
    return tuple(e for e in wished if limits_s[0] <= e <= limits_s[1])


def bracket_fits(
    meter: Meter,
    exposure_s: float,
    bracket_s: tuple[float, ...],
    *,
    black: float,
    white: int,
) -> tuple[bool, str]:
    """Return whether a bracket suits the light, judged from one picture, and why not.

    Nothing but glints may clip at the shortest, and half the pixels must rise five hundredths
    of full scale above black at the longest.
    """
    if not bracket_s:
        return False, "the plan has no bracket yet"
    floor = black / white
    if meter.saturated > GLINTS and exposure_s <= min(bracket_s):
        return False, f"{100 * meter.saturated:.2g} % clip at the shortest exposure"
    at_shortest = floor + (meter.bright - floor) * min(bracket_s) / exposure_s
    if at_shortest >= 1.0:
        return False, "the shortest exposure would clip"
    at_longest = (meter.median - floor) * max(bracket_s) / exposure_s
    if at_longest < 0.0005:
        return False, "the longest exposure would leave half the picture black"
    return True, ""
