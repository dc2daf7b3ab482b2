"""What is known about a camera: levels, gain, noise and response."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.response import LINEAR, Response

SATURATED_SHARE = 0.95  # of the white level; above it the response bends before it clips


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A camera: ``response(counts) = black + gain * electrons``, clipped at the white level.

    Attributes
    ----------
    gain_dn_per_e : system gain K, DN per electron; None where it was never measured
    read_noise_e : standard deviation of a frame without light, electrons; None likewise
    response : what turns counts into linear counts
    shutter_offset_s : t0; light is collected for t + t0 (`calibration.photon_transfer`)

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
    response: Response = LINEAR
    shutter_offset_s: float = 0.0

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
        """Variance of a frame without light, read noise and quantisation, DN^2.

        None without gain and read noise, and for a response that is not linear: K and read noise
        are figures of linear counts.
        """
        if self.gain_dn_per_e is None or self.read_noise_e is None or self.response is not LINEAR:
            return None
        return (self.gain_dn_per_e * self.read_noise_e) ** 2 + 1.0 / 12.0


def refuse_unfit_frame(
    frame: NDArray[Any], *, bits: int, like: NDArray[np.uint16] | None = None
) -> None:
    """Refuse what is no frame of a camera.

    Raises
    ------
    CalibrationError
        If it is no picture of whole counts, brighter than the bits can hold, or of another size.
    """
    if frame.ndim != 2 or frame.dtype.kind != "u":
        finite = "" if frame.dtype.kind != "f" or np.isfinite(frame).all() else " with NaN or inf"
        msg = (
            f"a frame of {frame.dtype}{finite} and shape {frame.shape}: unsigned counts "
            "(rows, cols) as the camera gave them are wanted."
        )
        raise CalibrationError(msg)
    if like is not None and frame.shape != like.shape:
        msg = f"frames of {like.shape} and {frame.shape} px; all must be of one size."
        raise CalibrationError(msg)
    if int(frame.max()) >= 2**bits:
        msg = (
            f"a frame holds {int(frame.max())} DN, more than {bits} bits can; "
            "declare the right bits, or shift left-aligned data to the right."
        )
        raise CalibrationError(msg)
