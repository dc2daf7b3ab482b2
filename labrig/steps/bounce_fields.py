"""Bounces as named fields of a file: those of an analysis and those of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.light_field import BounceField
from labrig.results import Field


def bounce_fields(field: BounceField, unit: str) -> dict[str, Field]:
    """Return the bounces and their coordinates as named fields; ``unit`` is that of lengths."""
    grid, n = field.grid, field.n_bounces
    fields = {
        "x": axis("x", grid.x_mm, unit),
        "y": axis("y", grid.y_mm, unit),
        "bounce": axis("bounce", np.arange(1, n + 1), "1"),
        "fluence": Field(
            dims=("bounce", "y", "x"),
            values=field.fluence,
            unit="1",
            meaning="phi_k, one where the beam enters; times scale_c: the picture of bounce k",
        ),
    }
    if field.error_estimate is not None:
        fields["error_estimate"] = Field(
            dims=("bounce",),
            values=field.error_estimate,
            unit="1",
            meaning="relative rms error of each bounce's fluence",
        )
    if field.light_field is not None and n > 1:
        fields["theta"] = axis("theta", grid.theta_rad, "rad")
        fields["scattered_bounce"] = axis("scattered_bounce", np.arange(2, n + 1), "1")
        fields["light_field"] = Field(
            dims=("scattered_bounce", "y", "x", "theta"),
            values=field.light_field.astype(np.float32, copy=False),
            unit="1/rad",
            meaning="L_k, radiance per radian of bounces 2 .. K",
        )
    return fields


def axis(name: str, values: NDArray[Any], unit: str) -> Field:
    """Return a coordinate as the field that its dimension is named after."""
    return Field(dims=(name,), values=values, unit=unit, meaning=f"coordinate {name}")
