"""Fresnel's equations: what a surface between two media turns back."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def reflectances(
    n_from: float, n_to: float, angle_from: float, angle_to: float
) -> tuple[float, float]:
    """Return Fresnel's power reflectances of either polarisation, s and p; angles in rad."""
    a, b = math.cos(angle_from), math.cos(angle_to)
    s = (n_from * a - n_to * b) / (n_from * a + n_to * b)
    p = (n_from * b - n_to * a) / (n_from * b + n_to * a)
    return s * s, p * p


def internal_reflectance(index: float, cosine: Array) -> Array:
    """Return the unpolarised reflectance of the liquid's surface to air from inside.

    Parameters
    ----------
    cosine : of the angle to the normal; beyond the critical angle all light turns back
    """
    a = np.abs(cosine)
    sine = index * np.sqrt(np.maximum(1.0 - a**2, 0.0))
    b = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
    s = ((index * a - b) / (index * a + b)) ** 2
    p = ((index * b - a) / (index * b + a)) ** 2
    return np.asarray(np.where(sine >= 1.0, 1.0, 0.5 * (s + p)))
