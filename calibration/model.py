"""What is known about a camera: levels, gain and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from calibration.errors import CalibrationError

SATURATED_SHARE = 0.95  # of the white level; above it the response bends before it clips


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A linear camera: ``counts = black + gain * electrons``, clipped at the white level.

    Attributes
    ----------
    gain_dn_per_e : system gain K, DN per electron; None where it was never measured
    read_noise_e : standard deviation of a frame without light, electrons; None likewise

    Raises
    ------
    CalibrationError
        If a level does not fit the bit depth or a noise figure is not positive.
    """

    bits: int
    black_level_dn: float
    white_level_dn: float
    gain_dn_per_e: float | None = None
    read_noise_e: float | None = None
    response: Literal["linear"] = "linear"

    def __post_init__(self) -> None:
        top = 2**self.bits - 1
        if not 0.0 <= self.black_level_dn < self.white_level_dn <= top:
            msg = (
                f"black level {self.black_level_dn} and white level {self.white_level_dn} DN "
                f"do not fit a {self.bits}-bit camera (0 <= black < white <= {top})."
            )
            raise CalibrationError(msg)
        for name in ("gain_dn_per_e", "read_noise_e"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                msg = f"{name} = {value} is not a positive number; leave it out if it is unknown."
                raise CalibrationError(msg)

    @property
    def saturation_dn(self) -> float:
        """Counts from which a pixel is taken for saturated, DN."""
        return SATURATED_SHARE * self.white_level_dn

    @property
    def floor_variance_dn2(self) -> float | None:
        """Variance of a frame without light, read noise and quantisation, DN^2."""
        if self.gain_dn_per_e is None or self.read_noise_e is None:
            return None
        return (self.gain_dn_per_e * self.read_noise_e) ** 2 + 1.0 / 12.0
