"""Kernels of the separation: one pass over the shifts, with variances and mask.

Each fills pictures (rows, cols) from stacks (n, rows, cols); the equations stand in
`analysis.separation`.
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
                lost = 0.0 * total[i]  # NaN where a shift was saturated
                x = begin + i
                single[y, x] = high[i] - low[i] + lost
                multiple[y, x] = low[i] / duty + lost
                single_variance[y, x] = of_high[i] + of_low[i] + lost
                multiple_variance[y, x] = of_low[i] / duty**2 + lost
                chi2[y, x] = np.nan
                detected[y, x] = _seen(single[y, x], single_variance[y, x])


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
    for y in range(rows):
        for k in range(n):
            lit[k] = pattern[k, y, 0]
        for begin in range(0, cols, BLOCK):
            end = min(begin + BLOCK, cols)
            for k in range(0 if alike else n):
                lit[k, : end - begin] = pattern[k, y, begin:end]
            _sum_shifts(net, variance, lit, y, begin, end, sums)
            for i in range(end - begin):
                p = p1[i] / n
                spread = p2[i] - n * p * p
                told |= spread > least
                p1[i], p2[i] = p, 1.0 / spread if spread > least else np.nan
            of_direct, of_rest = single_variance[y, begin:end], multiple_variance[y, begin:end]
            direct, rest, left = single[y, begin:end], multiple[y, begin:end], chi2[y, begin:end]
            _solve_block(sums, net[0, y, begin:end], n, duty, direct, rest, left)
            _spread_block(sums, n, duty, of_direct, of_rest)
            for x in range(begin, end):
                detected[y, x] = _seen(single[y, x], single_variance[y, x])
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
    n: int,
    duty: float,
    single: Array,
    multiple: Array,
    chi2: Array,
) -> None:
    """Fill a block (size,) with D, G and chi2; ``sums`` holds mean p and 1 / its spread."""
    p1, p2, y1, y2, py, v1, _, _ = sums
    per_freedom = n / (n - 2) if n > 2 else np.nan
    for i in range(single.size):
        mean = y1[i] / n
        cross = py[i] - n * p1[i] * mean
        direct = cross * p2[i]
        single[i] = direct
        multiple[i] = (first[i] + mean - p1[i] * direct) / duty
        chi2[i] = (y2[i] - n * mean * mean - direct * cross) / v1[i] * per_freedom


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _spread_block(
    sums: Stack, n: int, duty: float, single_variance: Array, multiple_variance: Array
) -> None:
    """Fill a block (size,) with the variances of D and G; NaN where a shift was saturated."""
    p1, p2, y1, _, _, v1, pv, ppv = sums
    for i in range(single_variance.size):
        p = p1[i]
        # sums over shifts of (p - mean p)^2 V and (p - mean p) V
        square, tilted = ppv[i] - 2.0 * p * pv[i] + p * p * v1[i], pv[i] - p * v1[i]
        of_direct = square * p2[i] * p2[i] + 0.0 * y1[i]
        of_rest = v1[i] / n**2 - 2.0 * p / n * tilted * p2[i] + p * p * of_direct
        single_variance[i] = of_direct
        multiple_variance[i] = of_rest / duty**2


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
    lines = np.empty((5, cols))
    for y in range(rows):
        lines[:] = 0.0
        real, imaginary, y1, y2, v1 = lines
        for k in range(n):
            for x in range(cols):
                value = np.float64(net[k, y, x])
                real[x] += wave[0, k] * value
                imaginary[x] += wave[1, k] * value
                y1[x] += value
                y2[x] += value * value
                v1[x] += variance[k, y, x]
        for x in range(cols):
            mean, noise = y1[x] / n, v1[x] / n
            power = real[x] ** 2 + imaginary[x] ** 2
            left = y2[x] - n * mean * mean - 0.5 * n * power
            debiased = power - (4.0 / n * noise if noise >= 0.0 else 0.0)
            direct = np.sqrt(debiased if debiased > 0.0 else 0.0 * mean) * per_contrast[x]
            of_direct = 2.0 / n * noise * per_contrast[x] ** 2 + 0.0 * mean
            single[y, x] = direct
            multiple[y, x] = mean / duty - direct
            single_variance[y, x] = of_direct
            multiple_variance[y, x] = noise / n / duty**2 + of_direct
            detected[y, x] = _seen(direct, of_direct)
            chi2[y, x] = left / noise / (n - 3)


@njit(cache=True, nogil=True, error_model="numpy")
def _seen(direct: float, variance: float) -> bool:
    """Return whether direct light exceeds its noise; if that is unknown, whether there is any."""
    bright = (direct > 0.0) & (direct * direct > DETECTION_SNR**2 * variance)
    return bool(bright | (np.isnan(variance) & np.isfinite(direct)))
