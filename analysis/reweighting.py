"""Bounces of another scattering coefficient out of those of one (Eq. 11)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError

T = TypeVar("T", np.float32, np.float64)


def reweight(
    bounces: NDArray[T], *, first: int, sigma_s_per_mm: float, wanted_per_mm: float
) -> NDArray[T]:
    """Return bounces as another sigma_s makes them: ``I_k (sigma_s' / sigma_s)^(k-1)`` (Eq. 11).

    Extinction and g stay, so that nothing is solved anew: curves, pictures and light fields alike.

    Parameters
    ----------
    bounces : (K, ...), bounce ``first`` and those that follow, for ``sigma_s_per_mm``
    wanted_per_mm : sigma_s', not negative

    Raises
    ------
    AnalysisError
        If sigma_s is not positive, or the one wanted is negative.
    """
    if not (sigma_s_per_mm > 0.0 and wanted_per_mm >= 0.0 and first >= 1):
        msg = (
            f"bounce {first} with sigma_s = {sigma_s_per_mm} cannot be weighted for "
            f"{wanted_per_mm}: the first must be positive, the other not negative."
        )
        raise AnalysisError(msg)
    orders = np.arange(first, first + bounces.shape[0])
    weight = (wanted_per_mm / sigma_s_per_mm) ** (orders - 1.0)
    shape = (-1,) + (1,) * (bounces.ndim - 1)
    return bounces * weight.astype(bounces.dtype).reshape(shape)
