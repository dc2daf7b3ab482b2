"""What every projector is to the rest of the program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorCapabilities:
    """Native size, refresh rate, and how long light takes to come and to settle."""

    rows: int
    cols: int
    refresh_hz: float
    settle_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowReceipt:
    """When the light can have changed: not before ``earliest_s``, not after ``latest_s``."""

    requested_s: float
    earliest_s: float
    latest_s: float


class Projector(Protocol):
    """A projector that shows one image at a time, pixel for pixel."""

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""

    def open(self) -> ProjectorCapabilities:
        """Connect; say what the projector can do."""

    def close(self) -> None:
        """Go dark and disconnect; harmless if done twice."""

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""

    def show(self, image: Image | None) -> ShowReceipt:
        """Show an image of native size, None for lamp off; raise `SettingRefusedError`."""
