"""What a run measures beside its plan: white and black light, by which the lamp is followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.waiting import CancelToken
from labrig.acquisition.estimate import discard_of, settle_of
from labrig.acquisition.looks import Looks
from labrig.acquisition.sequence import MARGIN_S, Sequencer, Step
from labrig.models.plan import BlackPattern, Pattern, Plan, Shot, UniformPattern
from labrig.patterns import Image, digest, draw
from labrig.plan import CapturePlan
from labrig.rig import OpenRig

BRIGHT, DARK = (0.25, 0.125, 0.0625, 0.03125), (4.0, 8.0, 16.0, 32.0)  # times the plan's exposure
LONGEST_S = 5.0  # an exposure to test the response with


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Mean counts of white and of black light; whether the lamp has changed since the last.

    Among the ``levels``, where white at two exposures is all that tells a bent response, stands
    their ratio over that of the exposures: ``response_ratio``, None if it could not be had.
    """

    levels: dict[str, float | None]
    changed: bool
    text: str


class References:
    """Arms a rig for a plan, and follows its lamp."""

    def __init__(
        self, plan: Plan, rig: OpenRig, *, before: Mapping[str, Any] | None = None
    ) -> None:
        self._plan = plan
        self._rig = rig
        rows, cols = rig.projector_can.rows, rig.projector_can.cols
        patterns: dict[str, Pattern] = {
            "white": UniformPattern(kind="uniform"),
            "black": BlackPattern(kind="black"),
        }
        drawn = {name: draw(pattern, rows, cols, 0) for name, pattern in patterns.items()}
        self._own: dict[str, Image] = {n: image for n, image in drawn.items() if image is not None}
        self._images: dict[str, Image] = {}
        self._exposure_s = 0.0
        self._only_exposure = self._tested = False
        self._tries = 0
        light = None if before is None else before.get("light_dn")
        self._light_dn = light if isinstance(light, int | float) else None

    def sequencer(self, expanded: CapturePlan, on_step: Callable[[str, Step], None]) -> Sequencer:
        """Load all patterns, arm the camera; return what makes attempts."""
        own = {digest(image): image for image in self._own.values()}
        self._images = {**own, **expanded.images}
        exposures_s = {shot.exposure_s for shot in expanded.shots}
        self._exposure_s, self._only_exposure = min(exposures_s), len(exposures_s) == 1
        handles = self._rig.arm([*self._images.values()])
        return Sequencer(
            rig=self._rig,
            handles=dict(zip(self._images, handles, strict=True)),
            settle_s=settle_of(self._plan, self._rig.projector_can.settle_s),
            discard=discard_of(self._plan, self._rig.camera_can.exposure_latency_frames),
            looks=Looks(self._rig, self._plan),
            gain_db=self._plan.exposures.gain_db,
            on_step=on_step,
        )

    def rearm(self, sequencer: Sequencer) -> None:
        """Close and open the devices, load and arm them again."""
        self._rig.reopen()
        handles = self._rig.arm([*self._images.values()])
        sequencer.handles = dict(zip(self._images, handles, strict=True))
        sequencer.forget()

    def warm_up(
        self, sequencer: Sequencer, cancel: CancelToken
    ) -> list[tuple[str, dict[str, Any]]]:
        """Let the lamp become steady, as long as the plan says; return what to note of it."""
        seconds = self._plan.timing.warmup_s
        if not seconds:
            return []
        begun_s = self._rig.now_s()
        handle = sequencer.handles[digest(self._own["white"])]
        self._rig.projector.show(handle, deadline_s=begun_s + MARGIN_S, cancel=cancel)
        self._rig.clock.wait_until(begun_s + seconds, cancel)
        return [(f"the lamp was on for {seconds:g} s before the first shot", {})]

    def measure(self, sequencer: Sequencer, cancel: CancelToken) -> Measured:
        """Take a white and a black frame, and compare them with the last ones."""
        levels: dict[str, float | None] = {}
        notes = []
        testing = self._only_exposure and not self._tested
        if testing:
            low_s, high_s = self._rig.camera_can.exposure_range_s
            others_s = (0.5 * self._exposure_s, 2.0 * self._exposure_s)
            for other_s in [e for e in others_s if low_s <= e <= high_s][:1]:
                self._take_white(other_s, sequencer, cancel)
        dn = {}
        for name in self._own:
            taken = sequencer.attempt(self._shot(name, self._exposure_s), cancel, again=False)
            dn[name] = float(np.mean(taken.frame.pixels))
            if testing and name == "white":
                levels["response_ratio"] = taken.details.get("bracket_ratio")
        light_dn = dn["white"] - dn["black"]
        if testing and levels["response_ratio"] is None:
            bright = dn["white"] > 0.5 * self._rig.camera_can.white_level_dn
            levels["response_ratio"] = self._ratio_elsewhere(
                BRIGHT if bright else DARK, sequencer, cancel
            )
        if testing:
            self._tested = True
            notes = [_tested(levels["response_ratio"])]
        levels |= {**{f"{name}_dn": value for name, value in dn.items()}, "light_dn": light_dn}
        before_dn, self._light_dn = self._light_dn, light_dn
        if not before_dn:
            text = "; ".join([f"reference light {light_dn:.1f} DN", *notes])
            return Measured(levels=levels, changed=False, text=text)
        change = light_dn / before_dn - 1.0
        sequencer.looks.lamp *= light_dn / before_dn
        changed = abs(change) > self._plan.limits.reference_drift
        text = f"reference light {light_dn:.1f} DN, {100 * change:+.2f} % since the last one"
        return Measured(levels=levels, changed=changed, text="; ".join([text, *notes]))

    def _ratio_elsewhere(
        self, factors: Sequence[float], sequencer: Sequencer, cancel: CancelToken
    ) -> float | None:
        """Return the ratio of white at two other exposures, neither dark nor clipped."""
        low_s, high_s = self._rig.camera_can.exposure_range_s
        for factor in factors:
            exposure_s = factor * self._exposure_s
            if low_s <= exposure_s <= min(high_s, LONGEST_S):
                details = self._take_white(exposure_s, sequencer, cancel)
                if details.get("bracket_ratio") is not None:
                    return float(details["bracket_ratio"])
        return None

    def _take_white(
        self, exposure_s: float, sequencer: Sequencer, cancel: CancelToken
    ) -> Mapping[str, Any]:
        """Take white at an exposure that the plan has not: light must follow exposure.

        Nothing else in such a plan would tell a bent response from a linear one where stripes are
        sharp. A white picture whose ratio to the one before is off is refused.
        """
        self._tries += 1
        shot = self._shot("white", exposure_s)
        shot = shot.model_copy(update={"id": f"response-white-{self._tries}"})
        return sequencer.attempt(shot, cancel, again=False).details

    def _shot(self, name: str, exposure_s: float) -> Shot:
        return Shot(
            id=f"reference-{name}",
            set="reference",
            role="white" if name == "white" else "black",
            group="reference",
            exposure_s=exposure_s,
            pattern=digest(self._own[name]),
        )

    def seconds(self, shots: Sequence[Shot]) -> float:
        """Return how long some shots will take, s."""
        if not shots:
            return 0.0
        can = self._rig.projector_can
        wait_s = can.latency_s[1] + settle_of(self._plan, can.settle_s)
        each_s = wait_s + self._rig.camera_can.readout_s
        return sum(shot.exposure_s for shot in shots) + len(shots) * each_s


def _tested(ratio: float | None) -> str:
    """Return in words what white at another exposure said of the camera's response."""
    if ratio is None:
        return "the camera's response was not tested, for white light is too dark or too bright"
    return f"white follows the exposure within {100.0 * abs(ratio - 1.0):.1f} %"
