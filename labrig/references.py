"""What a run measures beside its plan: white and black light, by which the lamp is followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.waiting import CancelToken
from labrig.estimate import discard_of, settle_of
from labrig.looks import Looks
from labrig.models.plan import BlackPattern, Pattern, Plan, Shot, UniformPattern
from labrig.patterns import Image, digest, draw
from labrig.plan import CapturePlan
from labrig.rig import OpenRig
from labrig.sequence import MARGIN_S, Sequencer, Step


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Mean counts of white and of black light; whether the lamp has changed since the last."""

    levels: dict[str, float]
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
        levels, notes = {}, []
        if self._only_exposure and not self._tested:
            notes = self._test_response(sequencer, cancel)
        for name in self._own:
            taken = sequencer.attempt(self._shot(name, self._exposure_s), cancel, again=False)
            levels[f"{name}_dn"] = float(np.mean(taken.frame.pixels))
        light_dn = levels["white_dn"] - levels["black_dn"]
        levels["light_dn"] = light_dn
        before_dn, self._light_dn = self._light_dn, light_dn
        if not before_dn:
            text = "; ".join([f"reference light {light_dn:.1f} DN", *notes])
            return Measured(levels=levels, changed=False, text=text)
        change = light_dn / before_dn - 1.0
        sequencer.looks.lamp *= light_dn / before_dn
        changed = abs(change) > self._plan.limits.reference_drift
        text = f"reference light {light_dn:.1f} DN, {100 * change:+.2f} % since the last one"
        return Measured(levels=levels, changed=changed, text="; ".join([text, *notes]))

    def _test_response(self, sequencer: Sequencer, cancel: CancelToken) -> list[str]:
        """Take white at two exposures, where the plan has one: its light must follow them.

        Nothing else in a plan of one exposure would tell a bent response from a linear one where
        stripes are sharp. Looks refuses the frames if their ratio is off.
        """
        low, _ = self._rig.camera_can.exposure_range_s
        other_s = 0.5 * self._exposure_s
        if other_s < low:
            other_s = 2.0 * self._exposure_s
        sequencer.attempt(self._shot("white", self._exposure_s), cancel, again=False)
        shot = self._shot("white", other_s)
        taken = sequencer.attempt(
            shot.model_copy(update={"id": "response-white"}), cancel, again=False
        )
        self._tested = True
        ratio = taken.details.get("bracket_ratio")
        if ratio is None:
            return [
                "the camera's response was not tested: too little light between black and white"
            ]
        return [f"white at {other_s:g} s is {ratio:.3f} times as bright as expected"]

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
