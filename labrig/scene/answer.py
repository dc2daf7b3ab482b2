"""What a tank answers to light: scattered light under white, and under waves along its face.

Light is linear in the projector's columns, and stripes of one period are a sum of a few waves. So
one answer serves every shift, exposure and repeat of a plan; nothing is solved again for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Wave = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Bounces 2 .. K of a tank, for the irradiance of its beam.

    Attributes
    ----------
    x_mm, y_mm : (n_x,), (n_y,), where the values stand: centres of cells, or nodes
    fluence : (K - 1, n_y, n_x), each bounce under white light, sigma_s^(k-1) applied
    std_error : (K - 1, n_y, n_x), of the fluence where it was sampled; None where it was solved
    waves : by period in mm and harmonic h, (n_y, n_x); the sum of all bounces under light that
        enters as exp(i h q y), q = 2 pi / period, over exp(i h q (y - x tan(theta_0)))
    method : what computed it, montecarlo or ordinates
    seconds : CPU, of computing it, be it now or when it was kept
    from_cache : whether nothing had to be computed
    """

    x_mm: Array
    y_mm: Array
    fluence: Array
    std_error: Array | None
    waves: Mapping[tuple[float, int], Wave]
    method: str
    seconds: float
    from_cache: bool

    @property
    def n_bounces(self) -> int:
        """Number of the last bounce, K."""
        return int(self.fluence.shape[0]) + 1

    def harmonics(self, period_mm: float) -> tuple[int, ...]:
        """Return the harmonics known of stripes of a period, ascending; none of another period."""
        return tuple(sorted(h for period, h in self.waves if period == period_mm))


def between(values: Array | Wave, y_mm: Array, x_mm: Array, at_y: Array, at_x: Array) -> Wave:
    """Return values (n_y, n_x) at other heights and depths, linear in between and beyond.

    Returns
    -------
    (at_y.size, at_x.size), complex
    """
    return np.asarray(_weights(y_mm, at_y) @ values @ _weights(x_mm, at_x).T, dtype=np.complex128)


def _weights(nodes: Array, at: Array) -> Array:
    """Return the matrix of linear interpolation, (at.size, nodes.size)."""
    if nodes.size == 1:
        return np.ones((at.size, 1))
    first = np.clip(np.searchsorted(nodes, at) - 1, 0, nodes.size - 2)
    share = (at - nodes[first]) / (nodes[first + 1] - nodes[first])
    matrix = np.zeros((at.size, nodes.size))
    rows = np.arange(at.size)
    matrix[rows, first] = 1.0 - share
    matrix[rows, first + 1] = share
    return matrix
