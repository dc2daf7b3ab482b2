"""The picture of a wholly lit tank that a fit of stripes and white light stands for.

Waves along the face are put together again: the ballistic beam with its own edges, what it
scatters as a Fourier series over twice the tank's width, and what the side walls take away.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis.medium import Beam, Tank
from analysis.stripe_aware import StripeAware
from analysis.stripe_problem import Observed
from analysis.transport.eigenmodes import plane_light

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

N_WAVES = 48  # of the light that was scattered: the shortest is a 48th of twice the tank's width
FINE = 4000  # points across the beam


def white_picture(
    fit: StripeAware, observed: Observed, tank: Tank, beam: Beam, x_mm: Array, y_mm: Array
) -> Array:
    """Return the light of a wholly lit field at depths x_mm (n_x,) and heights y_mm (n_y,).

    ``C/W' sum_q w^(q)/w^(0) A(x; q) exp(i q (y - x tan(theta_0)))``, q a multiple of 2 pi / W' with
    W' twice the width, plus the side walls' loss, which only changes slowly along y. Means over
    the cells around evenly spaced points, as far as the beam's edges and its decay matter. In
    camera units, (n_y, n_x).
    """
    slope = observed.slope
    entry = y_mm[:, None] - slope * x_mm
    edges, light = beam.profile_points()
    fine = np.linspace(edges[0], edges[-1], FINE)
    shape = np.interp(fine, edges, light)
    across = float(np.trapezoid(shape, fine))
    path = math.hypot(1.0, slope) * fit.medium.sigma_t_per_mm
    half_y, half = 0.5 * (y_mm[1] - y_mm[0]), 0.5 * path * (x_mm[1] - x_mm[0])
    below = np.concatenate([[0.0], np.cumsum(0.5 * (shape[1:] + shape[:-1]) * np.diff(fine))])
    lit = np.interp(entry + half_y, fine, below) - np.interp(entry - half_y, fine, below)
    found = lit / (2.0 * half_y * across) * np.exp(-path * x_mm) * math.sinh(half) / half
    period = 2.0 * tank.width_mm
    for j in range(N_WAVES + 1):
        q = 2.0 * np.pi * j / period
        profile = complex(np.trapezoid(shape * np.exp(-1j * q * fine), fine)) / across
        amplitude = profile * (_answer(fit, q, x_mm, slope, tank.depth_mm) - np.exp(-path * x_mm))
        amplitude *= np.sinc(j / (N_WAVES + 1))  # Lanczos' factor, against ringing at the edges
        found += (1.0 if j == 0 else 2.0) / period * (amplitude * np.exp(1j * q * entry)).real
    found += _inside(fit, observed, tank, x_mm, y_mm, found)
    return np.asarray(fit.scale_c * found)


def _answer(fit: StripeAware, q: float, x_mm: Array, slope: float, depth_mm: float) -> ComplexArray:
    """Return A(x; q) in the frame of the beam."""
    return plane_light(
        fit.medium,
        x_mm,
        depth_mm=depth_mm,
        wavenumber_per_mm=q,
        angle_deg=math.degrees(math.atan(slope)),
    )


def _inside(
    fit: StripeAware, observed: Observed, tank: Tank, x_mm: Array, y_mm: Array, endless: Array
) -> Array:
    """Return what the side walls change inside the tank, per unit of C, by its first waves.

    Those with walls were fitted; those without are sums over the picture without walls.
    """
    fitted = np.zeros(endless.shape)
    step = np.full(y_mm.size, y_mm[1] - y_mm[0])
    step[[0, -1]] *= 0.5
    q_j = observed.white.wavenumber_per_mm
    profile = np.r_[1.0, fit.profile]
    for j, (q, loss) in enumerate(zip(q_j, fit.losses, strict=True)):
        shift = np.exp(-1j * q * observed.slope * x_mm)
        real, imaginary = (np.interp(x_mm, observed.x_mm, part) for part in (loss.real, loss.imag))
        with_walls = profile[j] * _answer(fit, q, x_mm, observed.slope, tank.depth_mm)
        with_walls = (with_walls + real + 1j * imaginary) * shift
        wave = np.exp(1j * q * (y_mm - observed.white.origin_mm))
        change = with_walls - (np.conj(wave) * step) @ endless
        fitted += (1.0 if j == 0 else 2.0) / tank.width_mm * (wave[:, None] * change).real
    return fitted
