"""Square stripes as a sum of waves: which of them a picture calls for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrig.errors import RunError

Array = NDArray[np.float64]

FIRST = (1, 3)  # harmonics that every answer to stripes holds
LAST = 15  # beyond it no projector shows anything


def wave_amplitude(harmonic: int, period_px: float, blur_px: float) -> float:
    """Return |c_h| of stripes half lit: 1 / (pi h), and what a Gaussian blur leaves of it."""
    turn = 2.0 * math.pi * harmonic / period_px
    return math.exp(-0.5 * (turn * blur_px) ** 2) / (math.pi * harmonic)


def rms_beyond(harmonic: int, period_px: float, blur_px: float) -> float:
    """Return the rms of the odd harmonics after one, of stripes between 0 and 1."""
    beyond = range(harmonic + 2, LAST + 1, 2)
    return math.sqrt(sum(2.0 * wave_amplitude(h, period_px, blur_px) ** 2 for h in beyond))


def coefficients(
    levels: Array, period_px: int, harmonics: Sequence[int], blur_px: float
) -> list[complex]:
    """Return the Fourier coefficients of periodic levels: the mean, then each harmonic.

    Parameters
    ----------
    levels : light of each projector pixel, repeating with the period

    Raises
    ------
    RunError
        If the levels are no stripes, of which odd harmonics tell everything.
    """
    whole = levels[: levels.size // period_px * period_px].reshape(-1, period_px)
    u = np.arange(period_px) + 0.5
    found = [complex(whole[0].mean())]
    for harmonic in range(1, LAST + 1):
        turn = 2.0 * np.pi * harmonic / period_px
        blur = math.exp(-0.5 * (turn * blur_px) ** 2)
        pixel = float(np.sinc(harmonic / period_px))
        found.append(complex(np.mean(whole[0] * np.exp(-1j * turn * u)) * blur * pixel))
    even = math.sqrt(sum(2.0 * abs(c) ** 2 for c in found[2::2]))
    if even > 1e-9 * abs(found[0]):
        msg = "the projector image is no pattern of lit and dark stripes of equal width."
        raise RunError(msg)
    return [found[0], *(found[h] for h in harmonics)]
