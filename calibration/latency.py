"""Display latency and settle time of a projector, from the brightness of frames around flips.

The estimator only: flips at random phase and their frames come from the rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

STEADY = 0.005  # of the step: light within it has settled
MIXED = 0.05  # of the step; a frame nearer to an end does not tell when the light changed
MIN_FLIPS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class FlipFrame:
    """One frame near a flip: times on the rig's clock, s, and its mean brightness.

    ``rising`` is black to white.
    """

    requested_s: float
    start_s: float
    end_s: float
    brightness: float
    rising: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """When the light changes after it was asked to.

    Attributes
    ----------
    latency_s, jitter_s : median and standard deviation of the change
    earliest_s, latest_s : of all flips
    settle_s : after the change, until no frame is off by more than 0.5 percent of the step
    changes_s : (n,), of each flip that was caught in an exposure
    """

    latency_s: float
    jitter_s: float
    earliest_s: float
    latest_s: float
    settle_s: float
    changes_s: Array


def fit_latency(frames: Sequence[FlipFrame], *, black: float, white: float) -> Latency:
    """Estimate latency from frames whose exposure caught the change of light.

    A frame of share f of the step was lit for f of its exposure if the light rose within it:
    the change is at ``end - f (end - start)``, falling at ``start + f (end - start)``. Light that
    changes gradually counts as changing at its mean; what lasts longer is settle time.

    Raises
    ------
    CalibrationError
        If black and white are alike, too few flips were caught, or light changes before the flip,
        which means that the time stamps are not those of the exposure.
    """
    if not white > black:
        msg = f"white ({white:g}) is no brighter than black ({black:g}); is the projector seen?"
        raise CalibrationError(msg)
    changes = []
    for frame in frames:
        share = (frame.brightness - black) / (white - black)
        if MIXED < share < 1.0 - MIXED:
            lit_s = share * (frame.end_s - frame.start_s)
            at = frame.end_s - lit_s if frame.rising else frame.start_s + lit_s
            changes.append(at - frame.requested_s)
    if len(changes) < MIN_FLIPS:
        msg = (
            f"{len(changes)} flips were caught within an exposure, {MIN_FLIPS} are needed; flip "
            "more often, at random phase."
        )
        raise CalibrationError(msg)
    found = np.asarray(changes)
    if found.min() < 0.0:
        msg = (
            f"light changed {-1e3 * found.min():.1f} ms before it was asked to: the time stamps "
            "are not the exposure's begin and end."
        )
        raise CalibrationError(msg)
    middle = float(np.median(found))
    return Latency(
        latency_s=middle,
        jitter_s=float(found.std(ddof=1)),
        earliest_s=float(found.min()),
        latest_s=float(found.max()),
        settle_s=_settle(frames, middle, float(found.max()), black, white),
        changes_s=found,
    )


def _settle(
    frames: Sequence[FlipFrame], latency_s: float, latest_s: float, black: float, white: float
) -> float:
    """Return the latest beginning, after the change, of a frame that was not steady yet, s."""
    late = 0.0
    for frame in frames:
        begun = frame.start_s - frame.requested_s
        if begun <= latest_s:
            continue
        share = (frame.brightness - black) / (white - black)
        off = 1.0 - share if frame.rising else share
        if abs(off) > STEADY:
            late = max(late, begun - latency_s)
    return late
