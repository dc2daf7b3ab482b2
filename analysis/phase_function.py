"""The Henyey-Greenstein phase function in a plane, in two explicit modes (Eq. 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipe

from analysis.medium import Medium, Phase

Array = NDArray[np.float64]

G_SEARCHED = 0.995
UNRESOLVED = 0.01  # |g|^(n_theta/2), the first coefficient left out, must not exceed it


def power_removed(g: float, phase: Phase) -> float:
    """Return f0, the integral of the phase function over the circle.

    One for ``hg-plane``; ``N3(g) = E(k) / (pi (1 - |g|))``, ``k^2 = 4|g|/(1+|g|)^2`` for
    ``hg-paper``, which is Eq. 2 (normalised over the sphere) used literally in the plane.
    """
    if phase == "hg-plane":
        return 1.0
    a = abs(g)
    return float(ellipe(4.0 * a / (1.0 + a) ** 2) / (np.pi * (1.0 - a)))


def phase_function(theta: Array, g: float, phase: Phase) -> Array:
    """Return p(theta), per radian, for a deflection theta (rad, any shape).

    Notes
    -----
    The denominator 1 + g^2 - 2 g cos(theta) is written as (1-|g|)^2 + 4|g| sin^2(theta/2)
    (cos^2 for g < 0): the textbook form loses every digit as |g| tends to one.
    """
    a = abs(g)
    half = np.sin(0.5 * theta) if g >= 0.0 else np.cos(0.5 * theta)
    denominator = (1.0 - a) ** 2 + 4.0 * a * half**2
    numerator = (1.0 - a) * (1.0 + a)
    if phase == "hg-plane":
        return np.asarray(numerator / (2.0 * np.pi * denominator))
    return np.asarray(numerator / (4.0 * np.pi * denominator**1.5))


def fourier_coefficients(g: float, phase: Phase, n: int) -> Array:
    """Return f_0 .. f_(n-1) of p(theta) = sum_m f_|m| exp(i m theta) / (2 pi), (n,).

    Exactly ``g^m`` for ``hg-plane``. For ``hg-paper`` by the trapezoidal rule on enough points
    that the coefficients folded back, of order |g|^M, are below rounding.
    """
    if phase == "hg-plane":
        return np.asarray(g ** np.arange(n, dtype=np.float64))
    digits = 37.0 / -np.log(max(abs(g), 1e-3))
    n_points = int(2 ** np.ceil(np.log2(max(64.0, 2.0 * n, n + digits + 64.0))))
    theta = 2.0 * np.pi * np.arange(n_points) / n_points
    spectrum = np.fft.rfft(phase_function(theta, g, phase)).real
    return np.asarray(spectrum[:n] * (2.0 * np.pi / n_points))


def scattering_moments(
    g: float, phase: Phase, theta_rad: Array, *, n_orders: int, negligible: float
) -> tuple[Array, Array]:
    """Return the moments over direction that scattering weighs, and their weights.

    The rows of the first, (r, n), are 1, cos(m theta) and sin(m theta); with the integrals M of
    those times L, the scattered light ``integral of p(theta - theta') L(theta')`` is the sum of
    rows times weights (r,) times M. The coefficients are exact, p is never sampled.

    Parameters
    ----------
    n_orders : m stays below it
    negligible : coefficients below this share of the first are left out at the end of the series
    """
    coefficients = fourier_coefficients(g, phase, n_orders)
    matter = np.flatnonzero(np.abs(coefficients) > negligible * coefficients[0])
    m = np.arange(1, int(matter[-1]) + 1)
    angle = m[:, None] * theta_rad
    basis = np.concatenate([np.ones((1, theta_rad.size)), np.cos(angle), np.sin(angle)])
    weights = np.concatenate([coefficients[:1], *[2.0 * coefficients[m]] * 2]) / (2.0 * np.pi)
    return basis, np.asarray(weights)


def convolution_matrix(g: float, phase: Phase, n_theta: int) -> Array:
    """Return S of shape (n_theta, n_theta): S @ L is the integral of p(theta - theta') L(theta').

    For n_theta equal angles, from all the moments that these resolve.
    """
    theta = 2.0 * np.pi * (np.arange(n_theta) + 0.5) / n_theta
    basis, weights = scattering_moments(
        g, phase, theta, n_orders=(n_theta + 1) // 2, negligible=0.0
    )
    return np.asarray((basis.T * weights) @ basis * (2.0 * np.pi / n_theta))


def alike(medium: Medium, phase: Phase) -> Medium | None:
    """Return the medium of another phase function that scatters alike; None if there is none.

    Its sigma_t is equal, and so are what is scattered at all, sigma_s f_0, and its mean cosine,
    f_1 / f_0. A sigma_s above sigma_t is no medium.
    """
    f0, f1 = fourier_coefficients(medium.g, medium.phase, 2)

    def excess(g: float) -> float:
        other = fourier_coefficients(g, phase, 2)
        return float(other[1] / other[0] - f1 / f0)

    from scipy.optimize import brentq  # noqa: PLC0415 - a third of a second, for this alone

    g = float(brentq(excess, -G_SEARCHED, G_SEARCHED))
    sigma_s = medium.sigma_s_per_mm * float(f0) / power_removed(g, phase)
    if sigma_s > medium.sigma_t_per_mm:
        return None
    return Medium(sigma_t_per_mm=medium.sigma_t_per_mm, sigma_s_per_mm=sigma_s, g=g, phase=phase)
