"""Reflection of unpolarised light at the free surface of a liquid (Fresnel's equations)."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def reflectance(cosine: float, index: float) -> float:
    """Return the share of light that the surface sends back into the liquid.

    Parameters
    ----------
    cosine : of the angle between the light and the surface's normal, inside the liquid, > 0
    index : of the liquid relative to what is above it, >= 1

    Notes
    -----
    The mean over both polarisations; one beyond the critical angle. Light in a slab is polarised
    by scattering, which nothing here follows.
    """
    if index == 1.0:
        return 0.0
    outside = 1.0 - index * index * (1.0 - cosine * cosine)
    if outside <= 0.0:
        return 1.0
    beyond = math.sqrt(outside)
    across = (index * cosine - beyond) / (index * cosine + beyond)
    along = (cosine - index * beyond) / (cosine + index * beyond)
    return 0.5 * (across * across + along * along)
