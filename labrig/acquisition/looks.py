"""What a picture itself says against its exposure or its pattern, where clocks cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.acquisition.shift_sums import ENOUGH_PIXELS, SURE, Sums, add_up
from labrig.acquisition.thinned import Mask, Thinned, Thinner, typical
from labrig.models.plan import Plan, Shot, StripesPattern
from labrig.rig import OpenRig

RATIO_TOLERANCE = 0.03  # of brightness between two brackets of one pattern
LAMP_TOLERANCE = 0.2  # and between two frames of one exposure, for a lamp drifts
WRONG_STRIPES = 0.1  # of the stripes of one picture among an odd number
ALIKE, DIFFERENT = 2.0, 8.0  # chi^2 of two frames: one pattern gives 1, two that can be told more
CLEAR = 36.0  # chi^2 of one pixel whose change is no noise, even if that is twice what is stated
MANY_GROUPS = 16  # brackets that alternate; of older groups all shifts have been seen
PILED, LEAST_NOISE_DN = 0.02, 1.5  # share of pixels at one value that such noise cannot explain


class Cause(StrEnum):
    """Why an attempt gave no frame; each has its own counter and its own remedy."""

    NOT_FIRED = "trigger-not-fired"
    NO_FRAME = "no-frame"
    EARLY = "early"
    DUPLICATE = "duplicate"
    CORRUPT = "corrupt"
    WRONG_EXPOSURE = "wrong-exposure"
    WRONG_PATTERN = "wrong-pattern"
    DEVICE_LOST = "device-lost"


Doubt = tuple[Cause, str]


@dataclass(frozen=True, slots=True, eq=False)
class Swing:
    """What stripes have been seen to change: by (n,) pixel, DN/s, and at which shifts.

    After half of the shifts an edge has passed every pixel; before that it is known of some alone,
    and these will not change again at once.
    """

    per_s: NDArray[np.float64]
    shifts: set[int]


class Looks:
    """Remembers accepted pictures, thinned, and holds new ones to them.

    ``lamp`` is the light of the last reference, as a share of the first.
    """

    def __init__(self, rig: OpenRig, plan: Plan) -> None:
        self._rig = rig
        self._limits = plan.limits
        self._full = {
            s.id
            for s in plan.sets
            if isinstance(s.pattern, StripesPattern) and (s.pattern.low, s.pattern.high) == (0, 255)
        }
        self._thinner = Thinner(rig)
        self.lamp = 1.0
        self._known: dict[str | None, tuple[str, Thinned]] = {}  # by pattern, with the shot's id
        self._lit: dict[str, dict[float, Thinned]] = {"white": {}, "black": {}}  # by exposure
        self._last: tuple[Shot, Thinned] | None = None
        self._swing: dict[str, dict[float, Swing]] = {}  # by set and exposure
        self._groups: dict[str, dict[int, Thinned]] = {}

    def doubt(
        self, shot: Shot, pixels: NDArray[np.uint16], details: dict[str, Any]
    ) -> Doubt | None:
        """Return what speaks against a picture; None if nothing does, and then remember it.

        Two ways: it must be the picture that its pattern gave before, as much brighter as it was
        exposed longer; and against the shot before, a new pattern must be seen to have come, at
        pixels that are known to see it.
        """
        if shot.role == "white" and self._last is None:
            self._thinner.aim(pixels)
        now = self._thinner.thin(pixels, shot.exposure_s, self.lamp)
        if (clipped_dn := self._clipped(now)) is not None:
            details["clipped_at_dn"] = clipped_dn
            now = replace(now, clipped=now.clipped | (now.counts >= clipped_dn))
        if shot.shutter != "covered":
            doubt = self._against_known(shot, now, details) or self._against_last(
                shot, now, details
            )
            if doubt is not None:
                return doubt
            self._remember(shot, now)
        self._last = (shot, now)
        return None

    def compared_with(self, shot: Shot) -> str:
        """Return the id of the shot whose picture a new one is held to; empty if there is none."""
        return self._known[shot.pattern][0] if shot.pattern in self._known else ""

    def begin_again(self) -> None:
        """Trust none of the pictures accepted so far: one of them was wrong."""
        self.forget_pictures()
        self._swing.clear()

    def forget_pictures(self) -> None:
        """Hold no new picture to an old one: what is before the camera may have changed."""
        self._known.clear()
        self._groups.clear()
        for taken in self._lit.values():
            taken.clear()

    def group_doubt(self, shot: Shot) -> str | None:
        """Return in words how the shifts of a group contradict one another, once all are there."""
        seen = self._groups.get(shot.group, {})
        if shot.shifts is None or len(seen) < shot.shifts:
            return None
        full = shot.set in self._full
        found = add_up([seen[k] for k in range(shot.shifts)], self._lit_at(shot) if full else None)
        return None if found is None else self._contradiction(shot.group, found)

    def _contradiction(self, group: str, found: Sums) -> str | None:
        if found.residual > self._limits.shift_residual or found.stripes > WRONG_STRIPES:
            return (
                f"group {group}: {found.worst}, by {100.0 * found.residual:.1f} % of the light; "
                "one of them saw another pattern, or two, or another exposure."
            )
        if (
            found.brightness is not None
            and abs(found.brightness - 1.0) > self._limits.shift_brightness
        ):
            return (
                f"group {group}: its shifts are {found.brightness:.2f} times as bright as half of "
                "white and black together; the exposure is not the one reported, or the camera's "
                "response is not the one declared."
            )
        return None

    def _lit_at(self, shot: Shot) -> tuple[Thinned, Thinned] | None:
        """Return white and black, of the same exposure or the next shorter one if there is one."""
        found = []
        for taken in self._lit.values():
            if not taken:
                return None
            shorter = [e for e in taken if e <= shot.exposure_s]
            found.append(taken[max(shorter) if shorter else min(taken)])
        return found[0], found[1]

    def _remember(self, shot: Shot, now: Thinned) -> None:
        self._known[shot.pattern] = (shot.id, now)
        if shot.role in self._lit:
            self._lit[shot.role][shot.exposure_s] = now
        if shot.shift is None:
            return
        if self._last is not None and self._last[0].set == shot.set:
            self._learn_swing(shot, now, self._last[1])
        if shot.shift == 0:
            self._groups.pop(shot.group, None)
        self._groups.setdefault(shot.group, {})[shot.shift] = now
        while len(self._groups) > MANY_GROUPS:
            del self._groups[next(iter(self._groups))]

    def _learn_swing(self, shot: Shot, now: Thinned, before: Thinned) -> None:
        """Remember how much each pixel has been seen to change between two shifts."""
        if now.exposure_s != before.exposure_s:
            return
        change = np.abs(now.light - before.light)
        change[change**2 < CLEAR * (now.variance + before.variance)] = 0.0
        if np.count_nonzero(change) < ENOUGH_PIXELS:
            return
        known = self._swing.setdefault(shot.set, {})
        swing = known.setdefault(shot.exposure_s, Swing(np.zeros(change.size), set()))
        np.maximum(swing.per_s, change / now.exposure_s, out=swing.per_s)
        swing.shifts.add(shot.shift or 0)

    def _against_known(self, shot: Shot, now: Thinned, details: dict[str, Any]) -> Doubt | None:
        """Hold a picture to the last one of its pattern."""
        if shot.pattern not in self._known:
            return None
        _, known = self._known[shot.pattern]
        light, variance = known.at(now.exposure_s, now.lamp)
        usable = ~now.clipped & ~known.clipped
        bright = usable & (np.minimum(now.light, known.light) > 0.05 * self._thinner.white)
        ratio = 1.0
        if bright.sum() >= ENOUGH_PIXELS:
            ratio = float(now.light[bright].sum() / light[bright].sum())
            details["bracket_ratio"] = ratio
            same = known.exposure_s == now.exposure_s
            if abs(ratio - 1.0) > (LAMP_TOLERANCE if same else RATIO_TOLERANCE):
                return Cause.WRONG_EXPOSURE, (
                    f"the frame is {ratio:.3f} times as bright as the same pattern at "
                    f"{known.exposure_s:g} s lets expect; the exposure is not the one reported, "
                    "or the camera's response is not the one declared."
                )
        white = self._white_at(now)
        if white is None or usable.sum() < ENOUGH_PIXELS:
            return None
        power = float(np.mean(white[usable] ** 2))
        noise = float(np.mean((now.variance + ratio**2 * variance)[usable]))
        excess = float(typical((now.light - ratio * light)[usable] ** 2)) - noise
        if excess < SURE * noise * np.sqrt(2.0 / usable.sum()) or power <= 0.0:
            return None
        residual = float(np.sqrt(excess / power))
        details["picture_residual"] = residual
        if residual <= self._limits.shift_residual:
            return None
        return Cause.WRONG_PATTERN, (
            f"the picture is not the one that this pattern gave at {known.exposure_s:g} s: it "
            f"differs by {100.0 * residual:.1f} % of the light; the projector did not show it, or "
            "not all the time."
        )

    def _white_at(self, now: Thinned) -> NDArray[np.float64] | None:
        """Return the light of the first white, scaled to another exposure."""
        whites = self._lit["white"]
        return whites[min(whites)].at(now.exposure_s, now.lamp)[0] if whites else None

    def _against_last(self, shot: Shot, now: Thinned, details: dict[str, Any]) -> Doubt | None:
        """Hold a picture to the shot before, whose pattern was another."""
        if self._last is None:
            return None
        last, before = self._last
        same_scene = last.exposure_s == shot.exposure_s and last.shutter == shot.shutter
        if last.pattern == shot.pattern or not same_scene:
            return None
        variance = now.variance + before.variance
        seeing = self._seeing(shot, variance, ~(now.clipped & before.clipped))
        if seeing is None:
            return None
        chi2 = float(np.mean((now.light - before.light)[seeing] ** 2 / variance[seeing]))
        details["change_chi2"] = chi2
        if chi2 >= ALIKE:
            return None
        return Cause.WRONG_PATTERN, (
            f"the picture is that of shot {last.id} (chi^2 {chi2:.2f}), though the pattern is "
            "another; the projector did not change."
        )

    def _seeing(self, shot: Shot, variance: NDArray[np.float64], open_: Mask) -> Mask | None:
        """Return the pixels at which a new pattern must be seen; None if there are too few.

        Pixels that are clipped before and after see nothing, and nor do those where the stripes
        of this set have no contrast that noise would not hide.
        """
        every = self._swing.get(shot.set, {}).values()
        whole = [s.per_s for s in every if 2 * len(s.shifts) >= (shot.shifts or 0)]
        if not whole or shot.shifts is None:
            return None
        expected = (np.maximum.reduce(whole) * shot.exposure_s) ** 2 / variance
        seeing = np.asarray(open_ & (expected > CLEAR))
        if seeing.sum() < ENOUGH_PIXELS:
            return None
        # an edge passes a pixel twice in a period
        mean = float(expected[seeing].mean()) * 2.0 / shot.shifts
        return seeing if mean > DIFFERENT else None

    def _clipped(self, now: Thinned) -> float | None:
        """Return the counts at which the sensor clips below its white level; None if it does not.

        Noise spreads the brightest pixels; many of them at one value mean that it was cut there.
        """
        brightest = int(now.counts.argmax())
        top = float(now.counts[brightest])
        noisy = now.variance[brightest] > LEAST_NOISE_DN**2
        piled = np.mean(now.counts == now.counts[brightest]) > PILED
        return top if noisy and piled and top < self._rig.camera_can.white_level_dn else None


def poor(details: Mapping[str, Any], white_level_dn: int, allowed: float | None) -> list[str]:
    """Return what makes a frame that counts a poor one, in words.

    Parameters
    ----------
    allowed : share of pixels that may be saturated; None for the long exposures of a bracket,
        which are meant to clip
    """
    told = []
    share = details["saturated_fraction"]
    if allowed is not None and share > allowed:
        told.append(f"{100.0 * share:.2g} % of the pixels are saturated.")
    if "clipped_at_dn" in details:
        told.append(
            f"pixels pile up at {details['clipped_at_dn']:.0f} DN, below the white level of "
            f"{white_level_dn} DN; correct white_level_dn."
        )
    return told
