"""How directed the light of a bounce is, over the whole tank."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.light_field import BounceField

Array = NDArray[np.float64]


def anisotropy(field: BounceField) -> Array:
    """Return |<exp(i theta)>| of all the light of each bounce, (K,): one for a beam."""
    return np.abs(_first_moment(field))


def mean_direction_deg(field: BounceField) -> Array:
    """Return the direction of <exp(i theta)> of each bounce, degrees, (K,)."""
    return np.degrees(np.angle(_first_moment(field)))


def _first_moment(field: BounceField) -> NDArray[np.complex128]:
    """Return <exp(i theta)>, (K,); the first bounce is the beam itself.

    Raises
    ------
    AnalysisError
        If the light fields were not kept.
    """
    if field.light_field is None:
        msg = "directions are asked of bounces whose light fields were not kept; keep them."
        raise AnalysisError(msg)
    by_angle = field.light_field.sum(axis=(1, 2), dtype=np.float64)
    turned = by_angle @ np.exp(1j * field.grid.theta_rad)
    beam = np.exp(1j * np.radians(field.beam.angle_deg))
    return np.concatenate([[beam], turned / by_angle.sum(axis=1)])
