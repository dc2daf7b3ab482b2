"""The kernel that gathers columns to depths; what it means stands in `analysis.spectrum`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stack = NDArray[np.floating[Any]]


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    net: Stack, variance: Stack, first: NDArray[np.int64], mean: Array, noise: Array
) -> None:
    """Fill mean (n, rows, n_x) and noise (rows, n_x) from stacks (n, rows, cols)."""
    n, rows, cols = net.shape
    known, counts = np.empty(cols, np.bool_), np.empty(first.size - 1)
    for y in range(rows):
        known[:] = True
        for k in range(n):
            for x in range(cols):
                known[x] &= np.isfinite(net[k, y, x])
        for b in range(first.size - 1):
            counts[b] = known[first[b] : first[b + 1]].sum()
            noise[y, b] = 0.0
        for k in range(n):
            for b in range(first.size - 1):
                total = spread = 0.0
                for x in range(first[b], first[b + 1]):
                    if known[x]:
                        total += net[k, y, x]
                        spread += variance[k, y, x]
                mean[k, y, b] = total / counts[b]
                noise[y, b] += spread / (n * counts[b] ** 2)
