"""Stripes and white light as waves along the lit face, at every depth.

Transport through a homogeneous medium keeps the wavenumber q along the face. The light of a beam
of any width and profile w(y) is therefore, summed over all heights against exp(-i q y),
``w^(q) A(x; q)`` with w^ the profile's transform and A the answer to a wave of no end: neither
the beam's edges nor its profile touch the depth dependence. Only the side walls do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.spectrum_kernels import gather

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Stack = NDArray[np.floating[Any]]

MIN_SHIFTS = 4  # fewer alias the projector's second harmonic onto the first
MIN_SHIFTS_OF_THIRD = 6
MIN_NEAR = 4  # depths near the face from which the contrast is measured
MAX_RATIO_STD = 0.2  # of the third harmonic over the first, relative; noisier, it tells nothing
LARGEST_KEPT = 1.1  # more than all of the third harmonic: no blurred square wave
CONTRAST_ERROR = 2e-3  # of c1, relative: what a blur that is not Gaussian does to it
MIN_PERIODS = 3.0  # of the stripes within the beam
NEAR_SHARE = 0.25  # of the brightest: how deep the stripes' wavenumber is measured
STRIPED = 0.5  # of the brightest wave: weaker ones are no stripes
OVERSAMPLED = 16  # steps of wavenumber searched, within the resolution of the picture's height


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeWave:
    """One series of shifted stripes.

    Attributes
    ----------
    wavenumber_per_mm : q, measured in the pictures; its sign is the direction of the shifts
    slope : tan of the beam's direction inside the medium, from the stripes' drift with depth
    amplitude, std : (n_x,), the wave's amplitude in phase with itself, and its standard deviation,
        over that of the white light's integral across the beam
    profile, profile_std : (J,) complex and real, w^(q_j) / w^(0) of the illumination; see
        `WhiteLight`
    contrast, contrast_std : c1, amplitude of the stripes over white light where they enter, and its
        relative standard deviation; None where it is not known
    shared : (n_x,), covariance of the amplitude with the white light's integral, where that is the
        mean of the same shifts: lit pixels are noisier, and both take that in. None if untold
    """

    wavenumber_per_mm: float
    slope: float
    amplitude: Array
    std: Array
    profile: ComplexArray
    profile_std: Array
    contrast: float | None = None
    contrast_std: float = 0.0
    shared: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteLight:
    """The light of a wholly lit field, by waves along the face.

    Attributes
    ----------
    wavenumber_per_mm : (J + 1,), q_j, the first zero
    moment : (J + 1, n_x) complex, sum over rows of the light times exp(-i q_j (y - y_0)) dy, mm
    covariance : (n_x, 2 J + 2, 2 J + 2), of the real parts, then the imaginary ones
    origin_mm : y_0
    """

    wavenumber_per_mm: Array
    moment: ComplexArray
    covariance: Array
    origin_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bins:
    """Columns of a picture gathered to depths.

    Attributes
    ----------
    x_mm : (n_x,), mean depth
    first : (n_x + 1,), the first column of each bin, and the end
    """

    x_mm: Array
    first: NDArray[np.int64]

    @classmethod
    def of(cls, n_cols: int, pixel_mm: float, width_mm: float) -> Bins:
        """Return bins of whole columns, about ``width_mm`` wide and none wider than twice that."""
        per_bin = max(1, round(width_mm / pixel_mm))
        n = max(1, n_cols // per_bin)
        first = np.arange(n + 1) * per_bin
        first[-1] = min(n_cols, first[-1])
        x_mm = np.asarray(0.5 * (first[:-1] + first[1:]) * pixel_mm, dtype=np.float64)
        return cls(x_mm=x_mm, first=first)

    def gather(self, net: Stack, variance: Stack) -> tuple[Array, Array]:
        """Return the mean of every row and bin of shifts (n, rows, cols), and their noise.

        Pixels that lack a value in any shift are left out; the second, (rows, n_x), is the
        variance of the first, (n, rows, n_x), as a mean over the shifts.
        """
        shape = (net.shape[1], self.x_mm.size)
        mean, noise = np.empty((net.shape[0], *shape)), np.empty(shape)
        gather(net, variance, self.first, mean, noise)
        return mean, noise


def white_light(
    white: Array, variance: Array, pixel_mm: float, wavenumber_per_mm: Array
) -> WhiteLight:
    """Return the white light's waves; NaN at depths where a row has no value.

    Parameters
    ----------
    white, variance : (rows, n_x), light of a wholly lit field and its variance; a variance of NaN
        counts as none
    """
    rows = white.shape[0]
    y = (np.arange(rows) + 0.5) * pixel_mm
    origin = 0.5 * rows * pixel_mm
    angle = np.outer(wavenumber_per_mm, y - origin)
    base = np.concatenate([np.cos(angle), -np.sin(angle)]) * pixel_mm
    sums = base @ white
    n = wavenumber_per_mm.size
    known = np.where(np.isfinite(variance), variance, 0.0)
    return WhiteLight(
        wavenumber_per_mm=wavenumber_per_mm,
        moment=sums[:n] + 1j * sums[n:],
        covariance=np.einsum("ay,yx,by->xab", base, known, base, optimize=True),
        origin_mm=origin,
    )


def demodulate(net: Stack) -> ComplexArray:
    """Return ``z = (2/N) sum_k net_k exp(-2 pi i k/N)`` of shifted stripes, (rows, cols).

    Raises
    ------
    AnalysisError
        For fewer than four shifts.
    """
    n = net.shape[0]
    if n < MIN_SHIFTS:
        msg = f"{n} shifts: the stripes' wave needs at least {MIN_SHIFTS} over a period; take more."
        raise AnalysisError(msg)
    return _harmonic(net, 1) * 2.0


def stripe_wave(
    z: ComplexArray,
    variance: Array,
    pixel_mm: float,
    bins: Bins,
    white: WhiteLight,
    shared: ComplexArray | None = None,
) -> StripeWave:
    """Return the stripes' amplitude against depth, and the profile of their illumination.

    The shifts' harmonics of order 1 - N and 1 + N, which alias onto the first, have other
    wavenumbers and vanish in the sum over the height.

    Parameters
    ----------
    z, variance : (rows, n_x), binned `demodulate` and the variance of its real part
    shared : (rows, n_x), covariance of z with the white light of its pixels, if that is told

    Raises
    ------
    AnalysisError
        If the stripes cannot be found, or the picture holds fewer than three periods.
    """
    rows = z.shape[0]
    y = np.asarray((np.arange(rows) + 0.5) * pixel_mm - white.origin_mm, dtype=np.float64)
    whole = np.isfinite(z).all(axis=0)
    power = np.where(whole, np.abs(np.where(whole, z, 0.0)).sum(axis=0), 0.0)
    if not power.any():
        msg = "no depth has all its rows unsaturated: the stripes' wave cannot be measured."
        raise AnalysisError(msg)
    near = whole & (power > NEAR_SHARE * power.max())
    q = _wavenumber(z[:, near], y, pixel_mm)
    q_j = white.wavenumber_per_mm[1:]
    waves = np.exp(-1j * np.outer(np.r_[q, q + q_j], y)) * pixel_mm
    sums = waves @ z
    known = np.where(np.isfinite(variance), variance, 0.0)
    std = pixel_mm * np.sqrt(known.sum(axis=0))
    amplitude, turn, drift = in_phase(sums[0], bins.x_mm)
    common = None if shared is None else pixel_mm * (waves[0] @ np.nan_to_num(shared) * turn).real
    slope = -drift / q
    # The waves of the profile beside the stripes' own, in the frame of the beam.
    along = sums[1:] * turn * np.exp(1j * slope * np.outer(q_j, bins.x_mm))
    weight = np.where(near, amplitude, 0.0)
    norm = float(weight @ weight)
    return StripeWave(
        wavenumber_per_mm=q,
        slope=slope,
        amplitude=np.where(whole, amplitude, np.nan),
        std=std,
        profile=np.asarray(np.where(near, along, 0.0) @ weight / norm, dtype=np.complex128),
        profile_std=np.full(q_j.size, math.sqrt(float(np.sum((weight * std) ** 2))) / norm),
        shared=common,
    )


def third_harmonic(net: Stack) -> ComplexArray | None:
    """Return ``(1/N) sum_k net_k exp(-6 pi i k/N)`` of shifted stripes; None for fewer than six.

    Below six shifts other harmonics alias onto the third.
    """
    n = net.shape[0]
    if n < MIN_SHIFTS_OF_THIRD:
        return None
    return _harmonic(net, 3)


def _harmonic(net: Stack, order: int) -> ComplexArray:
    n = net.shape[0]
    angle = 2.0 * np.pi * order * np.arange(n) / n
    even = np.tensordot(np.cos(angle) / n, net, axes=1)
    return np.asarray(even - 1j * np.tensordot(np.sin(angle) / n, net, axes=1))


def measured_contrast(
    stripe: StripeWave,
    third: ComplexArray,
    pixel_mm: float,
    bins: Bins,
    *,
    duty: float,
    near_mm: float,
    answer: Callable[[float, Array], Array] | None = None,
) -> StripeWave:
    """Return stripes with the contrast c1 that their own third harmonic tells.

    A Gaussian blur that leaves s of the first harmonic of a square wave leaves s^9 of the third:
    ``a_3 / a_1 = s^8 sin(3 pi duty) / (3 sin(pi duty))`` where the light enters, so that one
    percent of the ratio is an eighth of a percent of ``c1 = (2/pi) sin(pi duty) s``. A pixel's
    width is allowed for.

    Parameters
    ----------
    third : (rows, n_x), binned `third_harmonic`
    near_mm : depths up to here are used
    answer : what the medium makes of a wave, A(q, x); else the ratio is that of the face, from a
        line through these depths, 1 percent off where light is scattered back
    """
    q = stripe.wavenumber_per_mm
    y = (np.arange(third.shape[0]) + 0.5) * pixel_mm
    wave = (np.exp(-3j * q * y) * pixel_mm) @ third
    near = (bins.x_mm < near_mm) & np.isfinite(wave) & (stripe.amplitude > 0.0)
    sharp = abs(math.sin(3.0 * math.pi * duty) / (3.0 * math.sin(math.pi * duty)))
    if near.sum() < MIN_NEAR or sharp < 1e-3:
        return stripe
    x_mm = bins.x_mm[near]
    ratio = 2.0 * np.abs(wave[near]) / stripe.amplitude[near]
    if answer is not None:
        ratio = ratio * answer(abs(q), x_mm) / answer(3.0 * abs(q), x_mm)
    line, covariance = np.polyfit(x_mm, ratio, 1 if answer is None else 0, cov=True)
    at_face = float(line[-1])
    of_pixel = [float(np.sinc(h * abs(q) * pixel_mm / (2.0 * math.pi))) for h in (1, 3)]
    kept = at_face / sharp * of_pixel[0] / of_pixel[1]
    std = math.sqrt(float(covariance[-1, -1])) / at_face if at_face > 0.0 else math.inf
    if not (0.0 < kept < LARGEST_KEPT and std < MAX_RATIO_STD):
        return stripe
    smear = min(kept, 1.0) ** 0.125
    return replace(
        stripe,
        contrast=2.0 / math.pi * math.sin(math.pi * duty) * smear * of_pixel[0],
        contrast_std=math.hypot(std / 8.0, CONTRAST_ERROR),
    )


def in_phase(wave: ComplexArray, x_mm: Array) -> tuple[Array, ComplexArray, float]:
    """Return what of a wave (n_x,) lies along its own straight phase.

    Beside it what turns the wave there, (n_x,), and the phase's slope, 1/mm; both from where the
    wave exceeds a tenth of its maximum.
    """
    size = np.abs(wave)
    bright = np.isfinite(wave) & (size > 0.1 * np.nanmax(size))
    drift = 0.0
    if bright.sum() > 1:
        phase = np.unwrap(np.angle(wave[bright]))
        drift = float(np.polyfit(x_mm[bright], phase, 1, w=size[bright])[0])
    turn = np.exp(-1j * drift * x_mm)
    mean = (wave * turn)[bright].sum()
    turn *= np.conj(mean) / abs(mean)
    return np.asarray((wave * turn).real), turn, drift


def _wavenumber(z: ComplexArray, y_mm: Array, pixel_mm: float) -> float:
    """Return where the power over wavenumber, summed over the columns, has its maximum."""
    rows = y_mm.size
    n = OVERSAMPLED * rows
    power = np.abs(np.fft.fft(z, n, axis=0)) ** 2
    spectrum = power.sum(axis=1)
    frequency = np.fft.fftfreq(n, pixel_mm)
    # White light seen through unequal shifts stands at zero; stripes do not.
    lit = np.sum(np.abs(z).mean(axis=1) > 0.3 * np.abs(z).mean(axis=1).max()) * pixel_mm
    brightest = float(spectrum.max())
    spectrum[np.abs(frequency) * lit < MIN_PERIODS] = 0.0
    k = int(np.argmax(spectrum))
    left, peak, right = spectrum[k - 1], spectrum[k], spectrum[(k + 1) % n]
    bend = left - 2.0 * peak + right
    if not peak > STRIPED * brightest or not bend < 0.0:
        msg = (
            f"no stripes are seen within the beam: fewer than {MIN_PERIODS:g} periods, or none at "
            "all; show finer stripes."
        )
        raise AnalysisError(msg)
    step = frequency[1] - frequency[0]
    return float(2.0 * np.pi * (frequency[k] + 0.5 * step * (left - right) / bend))
