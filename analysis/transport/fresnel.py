"""Reflection of unpolarised light at the free surface of a liquid (Fresnel's equations)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

WITHIN = 12  # samples of a cell along either angle


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


@njit(cache=True, nogil=True)
def mean_reflectance(
    phi_rad: NDArray[np.float64], theta_rad: NDArray[np.float64], index: float
) -> NDArray[np.float64]:
    """Return the share of the flux that comes back from cells of directions, (n_phi, n_theta).

    The cosine to the normal is sin(theta) cos(phi). At the critical angle the reflectance falls
    from one within degrees; its value at a cell's centre would stand for neither side.

    Parameters
    ----------
    phi_rad, theta_rad : edges of the cells, phi within 0 .. pi/2 and theta within 0 .. pi
    """
    found = np.zeros((phi_rad.size - 1, theta_rad.size - 1))
    for p in range(found.shape[0]):
        for t in range(found.shape[1]):
            flux = 0.0
            for i in range(WITHIN):
                phi = phi_rad[p] + (i + 0.5) / WITHIN * (phi_rad[p + 1] - phi_rad[p])
                for j in range(WITHIN):
                    theta = theta_rad[t] + (j + 0.5) / WITHIN * (theta_rad[t + 1] - theta_rad[t])
                    cosine = math.sin(theta) * math.cos(phi)
                    each = cosine * math.sin(theta)
                    flux += each
                    found[p, t] += each * reflectance(cosine, index)
            found[p, t] /= flux
    return found
