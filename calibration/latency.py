"""A projector's latency and settling, from flips between black and white seen by a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

STEADY = 0.005  # share of the step within which light counts as settled
TAIL = 3.09  # standard deviations; one in a thousand lies beyond
MIN_FLIPS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Flip:
    """Frames around one flip.

    Attributes
    ----------
    requested_s : when the new picture was asked for
    exposure_s : of every frame
    starts_s : (n,) begin of each frame's exposure, on the same clock
    brightness_dn : (n,) mean counts
    """

    requested_s: float
    exposure_s: float
    starts_s: Array
    brightness_dn: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class FlipTimes:
    """Latency of one flip, and after how long the light was surely steady, s."""

    latency_s: float
    settle_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """Bounds of many flips, s; ``timestamps`` is what the frames' stamps were found to mean."""

    earliest_s: float
    latest_s: float
    settle_s: float
    jitter_s: float
    timestamps: Literal["start", "end", "unknown"]


def times_of(flip: Flip) -> FlipTimes:
    """Return when the light of a flip changed, from the frame that saw both pictures.

    That frame holds a share f of the new light, so the change came (1 - f) exposures after its
    begin. A change between two frames is put at the end of the gap.

    Raises
    ------
    CalibrationError
        If the light did not change.
    """
    before = flip.starts_s + flip.exposure_s <= flip.requested_s
    if before.sum() < 1 or flip.starts_s.size - before.sum() < 3:
        msg = "a flip needs a frame before it and three after; take more frames."
        raise CalibrationError(msg)
    old = float(np.median(flip.brightness_dn[before]))
    new = float(np.median(flip.brightness_dn[-2:]))
    if abs(new - old) < 1.0:
        msg = f"the light went from {old:.1f} to {new:.1f} DN; let the camera see the projector."
        raise CalibrationError(msg)
    share = np.clip((flip.brightness_dn - old) / (new - old), 0.0, 1.0)
    first = int(np.argmax(share > 0.02))
    change_s = flip.starts_s[first] + (1.0 - share[first]) * flip.exposure_s
    unsteady = np.flatnonzero(np.abs(flip.brightness_dn - new) > STEADY * abs(new - old))
    last = max(int(unsteady[-1]), first) if unsteady.size else first
    return FlipTimes(
        latency_s=float(change_s - flip.requested_s),
        settle_s=float(max(flip.starts_s[last] + flip.exposure_s - change_s, 0.0)),
    )


def estimate_latency(flips: Sequence[Flip], *, refresh_s: float) -> Latency:
    """Return bounds that 99.9 % of flips keep, one refresh added, from flips at random phase.

    Flips at two exposures also tell what the time stamps mean: stamps of the end of an exposure,
    taken for its begin, make the latency longer by the exposure.

    Raises
    ------
    CalibrationError
        If there are too few flips, or the light does not change.
    """
    if len(flips) < MIN_FLIPS:
        msg = f"{len(flips)} flips do not bound a latency; take at least {MIN_FLIPS}, better 50."
        raise CalibrationError(msg)
    found = [times_of(flip) for flip in flips]
    latency_s = np.array([times.latency_s for times in found])
    mean, jitter_s = float(latency_s.mean()), float(latency_s.std(ddof=1))
    return Latency(
        earliest_s=max(min(latency_s.min(), mean - TAIL * jitter_s) - refresh_s, 0.0),
        latest_s=max(latency_s.max(), mean + TAIL * jitter_s) + refresh_s,
        # each flip bounds the settling by the end of a frame; the widest is safe
        settle_s=max(times.settle_s for times in found),
        jitter_s=jitter_s,
        timestamps=_meaning(np.array([flip.exposure_s for flip in flips]), latency_s),
    )


def _meaning(exposure_s: Array, latency_s: Array) -> Literal["start", "end", "unknown"]:
    short, long = exposure_s.min(), exposure_s.max()
    if long <= 1.2 * short:
        return "unknown"
    difference_s = np.median(latency_s[exposure_s == long]) - np.median(
        latency_s[exposure_s == short]
    )
    slope = difference_s / (long - short)
    if abs(slope) < 0.3:
        return "start"
    return "end" if 0.7 < slope < 1.3 else "unknown"
