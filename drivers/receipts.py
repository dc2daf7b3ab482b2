"""What a fired trigger says, whether a box or the camera itself fired it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggerReceipt:
    """The edge lies between two instants of the host's monotonic clock, s.

    ``count`` is the number of pulses given since `open`, this one included; None if the trigger
    does not count.
    """

    earliest_s: float
    latest_s: float
    count: int | None = None
