"""Projector images of a plan's patterns."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from labrig.errors import PlanError
from labrig.models.plan import BlackPattern, OffPattern, Pattern, UniformPattern

Image = NDArray[np.uint8]


def draw(pattern: Pattern, rows: int, cols: int, shift: int) -> Image | None:
    """Return the image (rows, cols) of a pattern; None where the projector is off.

    Stripes at shift k of N are lit where ``(i - k period / N) mod period < period / 2``.

    Raises
    ------
    PlanError
        If not even two periods fit the projector.
    """
    if isinstance(pattern, OffPattern):
        return None
    if isinstance(pattern, BlackPattern):
        return np.zeros((rows, cols), dtype=np.uint8)
    if isinstance(pattern, UniformPattern):
        return np.full((rows, cols), pattern.level, dtype=np.uint8)
    n = cols if pattern.axis == "x" else rows
    if pattern.period_px > n // 2:
        msg = (
            f"stripes of period {pattern.period_px} px do not repeat on a projector of {n} px; "
            "choose a shorter period."
        )
        raise PlanError(msg)
    step = pattern.period_px // pattern.shifts
    lit = (np.arange(n) - shift * step) % pattern.period_px < pattern.period_px // 2
    line = np.where(lit, pattern.high, pattern.low).astype(np.uint8)
    image = line[None, :] if pattern.axis == "x" else line[:, None]
    return np.ascontiguousarray(np.broadcast_to(image, (rows, cols)))


def digest(image: Image) -> str:
    """Return the name of an image: SHA-256 of its shape and pixels, 16 digits of it."""
    shape = f"{image.shape[0]}x{image.shape[1]}:".encode()
    return hashlib.sha256(shape + image.tobytes()).hexdigest()[:16]
