"""The medium, the tank and the beam: what a forward calculation is about.

Conventions: x runs from the lit face into the tank, y along that face, theta is the direction
of travel from +x, positive towards +y. Lengths are mm, coefficients 1/mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError

Phase = Literal["hg-plane", "hg-paper"]


def _refuse_non_finite(record: object) -> None:
    for field in fields(record):  # type: ignore[arg-type]
        value = getattr(record, field.name)
        if isinstance(value, float | int) and not math.isfinite(value):
            msg = f"{field.name} = {value} is not a finite number; give a measured value."
            raise AnalysisError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A homogeneous scattering medium.

    Raises
    ------
    AnalysisError
        If a coefficient is not finite or negative, sigma_s exceeds sigma_t, or g is no cosine.
    """

    sigma_t_per_mm: float
    sigma_s_per_mm: float
    g: float
    phase: Phase = "hg-plane"

    def __post_init__(self) -> None:
        _refuse_non_finite(self)
        if self.sigma_t_per_mm <= 0.0:
            msg = f"sigma_t = {self.sigma_t_per_mm} / mm: the extinction must be positive."
            raise AnalysisError(msg)
        if not 0.0 <= self.sigma_s_per_mm <= self.sigma_t_per_mm:
            msg = (
                f"sigma_s = {self.sigma_s_per_mm} / mm is outside 0 .. sigma_t = "
                f"{self.sigma_t_per_mm} / mm: light cannot scatter more than it is extinguished."
            )
            raise AnalysisError(msg)
        if not -1.0 < self.g < 1.0:
            msg = f"g = {self.g} is outside -1 < g < 1: an asymmetry is a mean cosine."
            raise AnalysisError(msg)
        if self.phase not in ("hg-plane", "hg-paper"):
            msg = f"phase = {self.phase!r} is unknown; choose hg-plane or hg-paper."
            raise AnalysisError(msg)

    @property
    def albedo(self) -> float:
        """Share of the extinction that is scattering, sigma_s / sigma_t."""
        return self.sigma_s_per_mm / self.sigma_t_per_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Tank:
    """The rectangle [0, depth] x [0, width] of liquid with black walls."""

    depth_mm: float
    width_mm: float

    def __post_init__(self) -> None:
        _refuse_non_finite(self)
        if min(self.depth_mm, self.width_mm) <= 0.0:
            msg = (
                f"the tank of {self.depth_mm} x {self.width_mm} mm is empty; "
                "depth and width must be positive."
            )
            raise AnalysisError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """Parallel light entering at x = 0 between two heights.

    The irradiance is counted across the beam, so the ballistic fluence where the beam enters is
    that irradiance, whatever the slant. ``angle_deg`` is the direction inside the medium.
    ``profile`` holds (y_mm, irradiance) pairs from ``from_mm`` to ``to_mm``, linear between
    them; without it the irradiance is one.

    Raises
    ------
    AnalysisError
        If the edges are not in order, the angle does not enter the tank, or the profile is no
        function of y from edge to edge with finite irradiance >= 0, somewhere positive.
    """

    from_mm: float
    to_mm: float
    angle_deg: float = 0.0
    profile: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self) -> None:
        _refuse_non_finite(self)
        if self.from_mm >= self.to_mm:
            msg = f"the beam from {self.from_mm} to {self.to_mm} mm has no width; order its edges."
            raise AnalysisError(msg)
        if not -90.0 < self.angle_deg < 90.0:
            msg = f"angle_deg = {self.angle_deg} does not enter the tank; give -90 < angle < 90."
            raise AnalysisError(msg)
        wrong = self._profile_fault()
        if wrong:
            msg = f"the beam's profile {wrong}; give (y_mm, irradiance) from edge to edge."
            raise AnalysisError(msg)

    def _profile_fault(self) -> str:
        if self.profile is None:
            return ""
        if len(self.profile) < 2:
            return "has fewer than two points"
        y_mm, irradiance = self.profile_points()
        if not (np.isfinite(y_mm).all() and np.all(np.diff(y_mm) > 0.0)):
            return "does not ascend in y"
        if y_mm[0] != self.from_mm or y_mm[-1] != self.to_mm:
            return f"ends at {y_mm[0]} and {y_mm[-1]} mm, not at {self.from_mm} and {self.to_mm} mm"
        if not np.isfinite(irradiance).all() or irradiance.min() < 0.0:
            return "has an irradiance that is negative or no finite number"
        return "" if irradiance.any() else "is dark throughout"

    def profile_points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return heights (mm) and irradiances of the profile, (n,) each; a top hat has two."""
        pairs = self.profile or ((self.from_mm, 1.0), (self.to_mm, 1.0))
        points = np.asarray(pairs, dtype=np.float64)
        return points[:, 0], points[:, 1]

    def within(self, tank: Tank) -> Beam:
        """Return this beam, refused unless it enters the tank wholly.

        Raises
        ------
        AnalysisError
            If an edge lies outside 0 .. width.
        """
        if self.from_mm < 0.0 or self.to_mm > tank.width_mm:
            msg = (
                f"the beam from {self.from_mm} to {self.to_mm} mm leaves the tank's face "
                f"0 .. {tank.width_mm} mm; mend the beam or the tank."
            )
            raise AnalysisError(msg)
        return self
