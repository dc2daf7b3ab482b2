"""What every camera is to the rest of the program."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCapabilities:
    """What a camera can do; counts at ``white_level_dn`` are clipped."""

    rows: int
    cols: int
    bits: int
    white_level_dn: int
    exposure_range_s: tuple[float, float]
    readout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One picture, owned and read-only, with when and how it was exposed.

    Attributes
    ----------
    pixels : (rows, cols) uint16, counts (DN)
    t_start_s, t_end_s : exposure on the host's monotonic clock, each sure to ``uncertainty_s``
    exposure_s : as the camera reports it for this frame
    """

    pixels: NDArray[np.uint16]
    sequence: int
    t_start_s: float
    t_end_s: float
    uncertainty_s: float
    exposure_s: float
    extras: dict[str, Any] = field(default_factory=dict)


class Camera(Protocol):
    """A monochrome area camera, exposing once per trigger."""

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""

    def open(self) -> CameraCapabilities:
        """Connect; say what the camera can do."""

    def close(self) -> None:
        """Disconnect; harmless if done twice."""

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""

    def apply(self, *, exposure_s: float) -> float:
        """Set the exposure; return what the camera really has; raise `SettingRefusedError`."""

    def flush(self) -> int:
        """Discard frames not yet collected; return how many."""

    def trigger(self) -> float:
        """Start one exposure; return the instant of firing, s."""

    def collect(self, *, deadline_s: float) -> Frame:
        """Wait for the next frame until an instant; raise `NoFrameError` if none came."""
