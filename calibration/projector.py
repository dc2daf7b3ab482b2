"""Where the projector's light falls: stripes as they arrive in the tank."""

from __future__ import annotations

import math

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
    blur_px: float,
    pixel_px: float,
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
        amplitude = 2.0 / (math.pi * h) * smear * float(np.sinc(h * pixel_px / period_px))
        if smear < 1e-9:
            break
        light += amplitude * math.sin(math.pi * h * duty) * np.cos(h * phase)
    return light
