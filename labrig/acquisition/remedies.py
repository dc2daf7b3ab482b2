"""Which failed attempt asks for what: each cause has its own counter and its own remedy."""

from __future__ import annotations

from collections import Counter
from enum import Enum, auto

from labrig.acquisition.looks import Cause
from labrig.models.plan import Limits

MIN_FAILURES = 3  # a short run may have as many without being stopped by their share


class Remedy(Enum):
    """What to do about an attempt that gave no frame."""

    AGAIN = auto()  # the pattern is still up
    SHOW_AGAIN = auto()
    SET_AGAIN = auto()  # the exposure; the pattern is still up
    REARM = auto()  # close and open the devices
    REPEAT_GROUP = auto()  # with the devices closed and opened
    COMPARE_ANEW = auto()  # the picture it was held to may be the wrong one: take both again
    PAUSE = auto()


def remedy_for(
    cause: Cause, counts: Counter[Cause], failures: int, n_shots: int, limits: Limits
) -> tuple[Remedy, str]:
    """Return what to do, and why if it is to stop.

    Parameters
    ----------
    counts : attempts at this shot that failed, by cause, this one included
    failures : attempts of this run that failed
    """
    if cause is Cause.DEVICE_LOST:
        return Remedy.REPEAT_GROUP, ""
    if counts[cause] >= limits.attempts_per_shot:
        why = f"It failed {limits.attempts_per_shot} times for this cause."
        if cause in (Cause.WRONG_EXPOSURE, Cause.WRONG_PATTERN):
            return Remedy.COMPARE_ANEW, why
        return Remedy.PAUSE, why
    if failures > max(limits.failures_per_run * n_shots, MIN_FAILURES):
        return Remedy.PAUSE, f"{failures} attempts of this run failed."
    if cause is Cause.NOT_FIRED or (cause is Cause.DUPLICATE and counts[cause] == 2):
        return Remedy.REARM, ""
    if cause is Cause.WRONG_EXPOSURE:
        return Remedy.SET_AGAIN, ""
    return Remedy.SHOW_AGAIN if cause is Cause.WRONG_PATTERN else Remedy.AGAIN, ""
