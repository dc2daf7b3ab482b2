"""Kernels of the separation: one pass over the shifts, with variances and mask.

Each fills pictures (rows, cols) from stacks (n, rows, cols) and reckons in the precision of these;
the equations stand in `analysis.separation`. Inner loops run over pixels without a division or a
number of another precision that can be had outside, or they are no vectors of full width.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stack = NDArray[np.floating[Any]]

DETECTION_SNR = 2.0  # below it direct light is "not detected"
BLOCK = 256  # pixels of a row whose sums stay in the fastest memory


@njit(cache=True, nogil=True, error_model="numpy")
def extrema(  # noqa: PLR0913, PLR0917 - a compiled kernel takes its arrays one by one
    net: Stack,
    variance: Stack,
    duty: float,
    single: Array,
    multiple: Array,
    single_variance: Array,
    multiple_variance: Array,
    detected: NDArray[np.uint8],
    chi2: Array,
) -> None:
    """Fill the pictures (rows, cols) by the extremes of net (n, rows, cols)."""
    n, rows, cols = net.shape
    ends, noise = np.empty((3, BLOCK), net.dtype), np.empty((2, BLOCK), variance.dtype)
    high, low, total = ends
    of_high, of_low = noise
    per_duty, unknown = net.dtype.type(1.0 / duty), net.dtype.type(np.nan)
    for y in range(rows):
        for begin in range(0, cols, BLOCK):
            size = min(BLOCK, cols - begin)
            for i in range(size):
                high[i] = low[i] = total[i] = net[0, y, begin + i]
                of_high[i] = of_low[i] = variance[0, y, begin + i]
            for k in range(1, n):
                values, spreads = net[k, y, begin:], variance[k, y, begin:]
                for i in range(size):
                    value, spread = values[i], spreads[i]
                    total[i] += value
                    of_high[i] = spread if value > high[i] else of_high[i]
                    high[i] = value if value > high[i] else high[i]
                    of_low[i] = spread if value < low[i] else of_low[i]
                    low[i] = value if value < low[i] else low[i]
            for i in range(size):
                lost = total[i] - total[i]  # NaN where a shift was saturated
                x = begin + i
                single[y, x] = high[i] - low[i] + lost
                multiple[y, x] = low[i] * per_duty + lost
                single_variance[y, x] = of_high[i] + of_low[i] + lost
                multiple_variance[y, x] = of_low[i] * per_duty * per_duty + lost
                chi2[y, x] = unknown
            _see(single[y], single_variance[y], detected[y], begin, begin + size)


@njit(cache=True, nogil=True, error_model="numpy")
def known(  # noqa: PLR0913, PLR0917
    net: Stack,
    variance: Stack,
    pattern: Stack,
    duty: float,
    least: float,
    single: Array,
    multiple: Array,
    single_variance: Array,
    multiple_variance: Array,
    detected: NDArray[np.uint8],
    chi2: Array,
) -> bool:
    """Fill the pictures by least squares; True if the pattern tells anything anywhere.

    ``pattern`` is (n, rows, 1 or cols); pixels whose pattern changes by less than ``least`` have
    no answer. In blocks of a row with the shifts outside, so that the inner loops are vectors.
    """
    n, rows, cols = net.shape
    sums, lit = np.empty((8, BLOCK), net.dtype), np.empty((n, BLOCK), net.dtype)
    p1, p2 = sums[:2]
    alike = pattern.shape[2] == 1
    told = False
    per_n, per_duty = net.dtype.type(1.0 / n), net.dtype.type(1.0 / duty)
    one, unknown = net.dtype.type(1.0), net.dtype.type(np.nan)
    per_freedom = net.dtype.type(n / (n - 2) if n > 2 else np.nan)
    for y in range(rows):
        for k in range(n):
            lit[k] = pattern[k, y, 0]
        for begin in range(0, cols, BLOCK):
            end = min(begin + BLOCK, cols)
            for k in range(0 if alike else n):
                lit[k, : end - begin] = pattern[k, y, begin:end]
            _sum_shifts(net, variance, lit, y, begin, end, sums)
            for i in range(end - begin):
                p = p1[i] * per_n
                spread = p2[i] - p1[i] * p
                told |= spread > least
                p1[i], p2[i] = p, one / spread if spread > least else unknown
            of_direct, of_rest = single_variance[y, begin:end], multiple_variance[y, begin:end]
            direct, rest, left = single[y, begin:end], multiple[y, begin:end], chi2[y, begin:end]
            _solve_block(
                sums, net[0, y, begin:end], per_n, per_duty, per_freedom, direct, rest, left
            )
            _spread_block(sums, per_n, per_duty, of_direct, of_rest)
            _see(single[y], single_variance[y], detected[y], begin, end)
    return told


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sum_shifts(
    net: Stack, variance: Stack, lit: Stack, y: int, begin: int, end: int, sums: Stack
) -> None:
    """Sum over the shifts of a part of a row: p, p^2, y, y^2, p y, V, p V, p^2 V.

    ``lit`` is (n, BLOCK), the pattern of that part; y is net less its first shift, so that single
    precision does for a small D on a large G. Inlined, or the compiler makes no vectors of it.
    """
    size = end - begin
    sums[:] = 0.0
    p1, p2, y1, y2, py, v1, pv, ppv = sums
    first = net[0, y, begin:end]
    for k in range(net.shape[0]):
        values, spreads, light = net[k, y, begin:end], variance[k, y, begin:end], lit[k]
        for i in range(size):
            p1[i] += light[i]
            p2[i] += light[i] * light[i]
        for i in range(size):
            value = values[i] - first[i]
            y1[i] += value
            y2[i] += value * value
            py[i] += light[i] * value
        for i in range(size):
            tilted = light[i] * spreads[i]
            v1[i] += spreads[i]
            pv[i] += tilted
            ppv[i] += light[i] * tilted


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _solve_block(
    sums: Stack,
    first: Stack,
    per_n: float,
    per_duty: float,
    per_freedom: float,
    single: Array,
    multiple: Array,
    chi2: Array,
) -> None:
    """Fill a block (size,) with D, G and chi2; ``sums`` holds mean p and 1 / its spread."""
    p1, p2, y1, y2, py, v1, _, _ = sums
    for i in range(single.size):
        mean = y1[i] * per_n
        cross = py[i] - p1[i] * y1[i]
        direct = cross * p2[i]
        single[i] = direct
        multiple[i] = (first[i] + mean - p1[i] * direct) * per_duty
        chi2[i] = (y2[i] - y1[i] * mean - direct * cross) / v1[i] * per_freedom


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _spread_block(
    sums: Stack, per_n: float, per_duty: float, single_variance: Array, multiple_variance: Array
) -> None:
    """Fill a block (size,) with the variances of D and G; NaN where a shift was saturated."""
    p1, p2, y1, _, _, v1, pv, ppv = sums
    for i in range(single_variance.size):
        p = p1[i]
        # sums over shifts of (p - mean p)^2 V and (p - mean p) V
        tilted = pv[i] - p * v1[i]
        square = ppv[i] - p * (pv[i] + tilted)
        of_direct = square * p2[i] * p2[i] + (y1[i] - y1[i])
        of_mean = per_n * (per_n * v1[i] - (p + p) * tilted * p2[i])
        single_variance[i] = of_direct
        multiple_variance[i] = (of_mean + p * p * of_direct) * per_duty * per_duty


@njit(cache=True, nogil=True, error_model="numpy")
def harmonic(  # noqa: PLR0913, PLR0917
    net: Stack,
    variance: Stack,
    wave: Array,
    per_contrast: Array,
    duty: float,
    single: Array,
    multiple: Array,
    single_variance: Array,
    multiple_variance: Array,
    detected: NDArray[np.uint8],
    chi2: Array,
) -> None:
    """Fill the pictures by the first harmonic; ``wave`` is (2, n), cosine and sine times 2/N."""
    n, rows, cols = net.shape
    sums = np.empty((5, BLOCK), net.dtype)
    real, imaginary, y1, y2, v1 = sums
    per_n, per_duty = net.dtype.type(1.0 / n), net.dtype.type(1.0 / duty)
    half_n, per_half_n = net.dtype.type(0.5 * n), net.dtype.type(2.0 / n)
    per_freedom, none = net.dtype.type(n / (n - 3)), net.dtype.type(0.0)
    for y in range(rows):
        for begin in range(0, cols, BLOCK):
            size = min(BLOCK, cols - begin)
            sums[:] = 0.0
            first = net[0, y, begin : begin + size]
            for k in range(n):
                values, spreads = net[k, y, begin:], variance[k, y, begin:]
                cosine, sine = wave[0, k], wave[1, k]
                for i in range(size):
                    value = values[i] - first[i]
                    real[i] += cosine * value
                    imaginary[i] += sine * value
                    y1[i] += value
                    y2[i] += value * value
                    v1[i] += spreads[i]
            for i in range(size):
                x = begin + i
                mean, noise = y1[i] * per_n, v1[i] * per_n
                power = real[i] * real[i] + imaginary[i] * imaginary[i]
                left = y2[i] - y1[i] * mean - half_n * power
                spread = per_half_n * noise
                debiased = power - (spread + spread if noise >= none else none)
                lost = mean - mean  # NaN where a shift was saturated
                direct = np.sqrt(debiased if debiased > none else lost) * per_contrast[x]
                of_mean = noise * per_n * per_duty * per_duty
                of_direct = spread * per_contrast[x] * per_contrast[x] + lost
                single[y, x] = direct
                multiple[y, x] = (first[i] + mean) * per_duty - direct
                single_variance[y, x] = of_direct
                multiple_variance[y, x] = of_mean + of_direct
                chi2[y, x] = left / v1[i] * per_freedom
            _see(single[y], single_variance[y], detected[y], begin, begin + size)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _see(single: Array, variance: Array, detected: NDArray[np.uint8], begin: int, end: int) -> None:
    """Mark where in a row direct light exceeds its noise, if that is unknown where there is any."""
    least, none = single.dtype.type(DETECTION_SNR**2), single.dtype.type(0.0)
    direct, spread, seen = single[begin:end], variance[begin:end], detected[begin:end]
    for i in range(end - begin):
        d, v = direct[i], spread[i]
        seen[i] = ((d > none) & (d * d > least * v)) | (np.isnan(v) & np.isfinite(d))
