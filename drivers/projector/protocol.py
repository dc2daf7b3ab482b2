"""What every projector is to the rest of the program.

All instants are on the host's monotonic clock, in seconds. A call that may block takes an instant
``deadline_s`` and a cancel token, keeps the first within a fifth and the second within 0.2 s; none
waits for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.waiting import CancelToken

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorCapabilities:
    """What a projector can do, and how long its light takes to come and to settle.

    Attributes
    ----------
    rows, cols : native size, px; images are never scaled
    latency_s : from request to change of light, at least and at most, refresh period included
    settle_s : from the change of light until it is steady
    calibrated : ISO date and time (UTC) of the latency calibration; None if these are guesses
    confirmed : whether receipts rest on a flip event; else on ``latency_s`` alone
    colour_wheel : grey is made by turns, so exposures must be whole refresh periods
    lamp_control : whether `Projector.lamp_off` works; else the operator covers the lens
    """

    rows: int
    cols: int
    refresh_hz: float
    latency_s: tuple[float, float]
    settle_s: float
    calibrated: str | None = None
    confirmed: bool = False
    colour_wheel: bool = False
    gamma_note: str = ""
    lamp_control: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PatternHandle:
    """A loaded image: its place in the order of loading, and the digest of its pixels."""

    index: int
    digest: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowReceipt:
    """What was shown, and when the light can have changed, s.

    ``handle`` is None for black and for a lamp that is off; ``confirmed`` if the bounds rest on
    an event of the display, else they are assumed from the calibrated latency.
    """

    handle: PatternHandle | None
    requested_s: float
    earliest_s: float
    latest_s: float
    confirmed: bool = False


class Projector(Protocol):
    """A projector that shows one loaded image at a time, pixel for pixel."""

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``."""

    def open(self) -> ProjectorCapabilities:
        """Connect, black; say what the projector can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError
            With the remedy. An open projector is busy to a second `open`.
        """

    def close(self) -> None:
        """Go black and disconnect; harmless if done twice, bounded, never raises."""

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device, as JSON."""

    def load(self, images: Sequence[Image]) -> tuple[PatternHandle, ...]:
        """Take (rows, cols) uint8 images of native size, in place of those loaded before.

        Raises
        ------
        SettingRefusedError
            If size or depth do not fit; nothing is scaled.
        """

    def show(self, handle: PatternHandle, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:
        """Show a loaded image and say when its light can have come.

        Raises
        ------
        SettingRefusedError, DeadlineError, DeviceLostError, CancelledError
        """

    def black(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:
        """Show level 0 everywhere; its leak remains. Raises as `show`."""

    def lamp_off(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:
        """Give no light at all until the next `show` or `black`. Raises as `show`.

        Raises
        ------
        SettingRefusedError
            If the projector has no lamp control.
        """

    def current(self) -> PatternHandle | None:
        """Return what is shown; None for black and for a lamp that is off."""

    def make_safe(self) -> None:
        """Go black whatever the state; bounded, never raises."""
