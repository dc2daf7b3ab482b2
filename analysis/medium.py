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
Gain = Literal["refused", "allowed"]


def _refuse_non_finite(record: object) -> None:
    for field in fields(record):  # type: ignore[arg-type]
        value = getattr(record, field.name)
        if isinstance(value, float | int) and not math.isfinite(value):
            msg = f"{field.name} = {value} is not a finite number; give a measured value."
            raise AnalysisError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A homogeneous scattering medium.

    ``gain`` = "allowed" lets sigma_s exceed sigma_t: no liquid does, but the equations of single
    orders stand, and the paper's literal mode can want it.

    Raises
    ------
    AnalysisError
        If a coefficient is not finite or negative, sigma_s exceeds sigma_t without ``gain``, or
        g is no cosine.
    """

    sigma_t_per_mm: float
    sigma_s_per_mm: float
    g: float
    phase: Phase = "hg-plane"
    gain: Gain = "refused"

    def __post_init__(self) -> None:
        _refuse_non_finite(self)
        if self.gain not in ("refused", "allowed"):
            msg = f"gain = {self.gain!r} is unknown; choose refused or allowed."
            raise AnalysisError(msg)
        if min(self.sigma_t_per_mm, self.sigma_s_per_mm) < 0.0:
            msg = (
                f"sigma_t = {self.sigma_t_per_mm}, sigma_s = {self.sigma_s_per_mm} / mm: "
                "coefficients cannot be negative."
            )
            raise AnalysisError(msg)
        if self.sigma_s_per_mm > self.sigma_t_per_mm and self.gain == "refused":
            msg = (
                f"sigma_s = {self.sigma_s_per_mm} / mm exceeds sigma_t = {self.sigma_t_per_mm} "
                "/ mm: light cannot scatter more than it is extinguished; "
                "gain: allowed asks for it all the same."
            )
            raise AnalysisError(msg)
        if not -1.0 <= self.g <= 1.0:
            msg = f"g = {self.g} is outside -1 .. 1: an asymmetry is a mean cosine."
            raise AnalysisError(msg)
        if self.phase not in ("hg-plane", "hg-paper"):
            msg = f"phase = {self.phase!r} is unknown; choose hg-plane or hg-paper."
            raise AnalysisError(msg)

    @property
    def albedo(self) -> float:
        """Share of the extinction that is scattering, sigma_s / sigma_t; 0 in empty space."""
        if self.sigma_s_per_mm == 0.0:
            return 0.0
        return self.sigma_s_per_mm / self.sigma_t_per_mm if self.sigma_t_per_mm else math.inf


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
class Slab:
    """A layer of liquid of even height, seen from above: the floor is black, the surface is free.

    Attributes
    ----------
    depth_mm : from the lit face to the far wall, both of which let light out and none in
    height_mm : from the floor to the surface
    surface_index : index of refraction of the liquid relative to what is above it; one for a
        surface that reflects nothing
    """

    depth_mm: float
    height_mm: float
    surface_index: float = 1.0

    def __post_init__(self) -> None:
        _refuse_non_finite(self)
        if min(self.depth_mm, self.height_mm) <= 0.0:
            msg = (
                f"a slab of depth {self.depth_mm} and height {self.height_mm} mm holds no liquid; "
                "measure both, they must be positive."
            )
            raise AnalysisError(msg)
        if self.surface_index < 1.0:
            msg = (
                f"surface_index = {self.surface_index} is below one: liquid under air has about "
                "1.33, a surface that reflects nothing has 1."
            )
            raise AnalysisError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """Parallel light entering at x = 0 between two heights.

    The irradiance is counted across the beam, so the ballistic fluence is the irradiance where
    the beam enters, whatever its slant. ``angle_deg`` is the direction inside the medium.

    Attributes
    ----------
    profile : pairs (y_mm, irradiance) at the lit face from ``from_mm`` to ``to_mm``, linear
        between them; without it the irradiance is one
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
        """Return heights (mm) and irradiances between which the profile is linear."""
        points = self.profile or ((self.from_mm, 1.0), (self.to_mm, 1.0))
        table = np.array(points, dtype=np.float64)
        return table[:, 0], table[:, 1]

    def entering(self, tank: Tank) -> Beam:
        """Return the part of this beam that enters through the tank's face.

        A beam wider than the face overfills it, and the rest passes by.

        Raises
        ------
        AnalysisError
            If one edge only lies outside 0 .. width, or no light enters at all: such a beam is
            taken for a mistake.
        """
        width = tank.width_mm
        below, above = self.from_mm < 0.0, self.to_mm > width
        if below != above:
            msg = (
                f"the beam from {self.from_mm} to {self.to_mm} mm leaves the tank's face "
                f"0 .. {width} mm; mend the beam or the tank."
            )
            raise AnalysisError(msg)
        if not below:
            return self
        y, irradiance = self.profile_points()
        inside = (y > 0.0) & (y < width)
        heights = [0.0, *y[inside].tolist(), width]
        cut = tuple((h, float(np.interp(h, y, irradiance))) for h in heights)
        return Beam(
            from_mm=0.0,
            to_mm=width,
            angle_deg=self.angle_deg,
            profile=None if self.profile is None else cut,
        )
