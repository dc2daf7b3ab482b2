"""One attempt at one shot: show, settle, configure, flush, expose, collect, check.

The pattern changes only after an attempt was accepted or given up. A frame can then be wrong only
by being early, and the rules below are about the begin of its exposure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera.protocol import CameraSettings, Frame
from drivers.errors import (
    DeviceLostError,
    FrameCorruptError,
    NoFrameError,
    NotOpenError,
    TriggerNotFiredError,
)
from drivers.projector.protocol import PatternHandle, ShowReceipt
from drivers.waiting import CancelToken
from labrig.acquisition.looks import Cause, Looks
from labrig.errors import RunError
from labrig.models.plan import Shot
from labrig.rig import OpenRig
from labrig.session.format import pixel_digest

__all__ = ["AttemptError", "Cause", "Sequencer", "Step", "Taken"]

MARGIN_S = 1.0  # what a device may need beyond the exposure before it counts as silent


class Step(StrEnum):
    """Steps of an attempt, in order."""

    SHOW = "show"
    SETTLE = "settle"
    CONFIGURE = "configure"
    FLUSH = "flush"
    EXPOSE = "expose"
    COLLECT = "collect"
    CHECK = "check"
    COMMIT = "commit"


class AttemptError(RunError):
    """Raised when an attempt gave no acceptable frame; says why, and holds the frame if any."""

    def __init__(
        self,
        cause: Cause,
        message: str,
        *,
        frame: Frame | None = None,
        details: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(message)
        self.cause: Cause = cause
        self.frame = frame
        self.details = dict(details or {})


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """An accepted frame, and what the journal shall say of it."""

    frame: Frame
    details: dict[str, Any]


@dataclass
class Sequencer:
    """Makes attempts on an open rig, and remembers what the next one must know.

    Attributes
    ----------
    handles : digest of a projector image to what the projector calls it
    settle_s : after the light has changed; never below what was calibrated
    discard : frames thrown away after an exposure change
    looks : what pictures must look like
    on_step : told of each step as it begins, with the shot's id
    """

    rig: OpenRig
    handles: dict[str, PatternHandle]
    settle_s: float
    discard: int
    looks: Looks
    gain_db: float = 0.0
    on_step: Callable[[str, Step], None] = lambda _shot, _step: None
    _settings: CameraSettings | None = None
    _receipt: ShowReceipt | None = None
    _shown: tuple[str | None, str] | None = None
    _last_sequence: int = 0
    _last_pixels: str = ""

    def forget(self) -> None:
        """Assume nothing about the devices: after a recovery or a pause."""
        self._settings = self._receipt = self._shown = None
        self._last_sequence = 0

    def forget_exposure(self) -> None:
        """Assume nothing about the exposure: it is set again, and the old frames thrown away."""
        self._settings = None

    def attempt(self, shot: Shot, cancel: CancelToken, *, again: bool) -> Taken:
        """Try once to get a frame of a shot.

        Parameters
        ----------
        again : the pattern of the attempt before may stay up, if it is this one

        Raises
        ------
        AttemptError
            With its cause; the light is then as it was, and another attempt can follow.
        CancelledError
            If the token was set.
        """
        try:
            return self._attempt(shot, cancel, again=again)
        except TriggerNotFiredError as error:
            raise AttemptError(Cause.NOT_FIRED, str(error)) from error
        except NoFrameError as error:
            raise AttemptError(Cause.NO_FRAME, str(error)) from error
        except FrameCorruptError as error:
            raise AttemptError(Cause.CORRUPT, str(error)) from error
        except (DeviceLostError, NotOpenError) as error:
            raise AttemptError(Cause.DEVICE_LOST, str(error)) from error

    def _attempt(self, shot: Shot, cancel: CancelToken, *, again: bool) -> Taken:
        receipt = self._show(shot, cancel, again=again)
        self.on_step(shot.id, Step.SETTLE)
        settled_s = receipt.latest_s + self.settle_s
        self.rig.clock.wait_until(settled_s, cancel)
        self.on_step(shot.id, Step.CONFIGURE)
        changed = self._configure(shot, cancel)
        self.on_step(shot.id, Step.FLUSH)
        flushed = self.rig.camera.flush()
        self._last_sequence = max(self._last_sequence, flushed.last_sequence)
        details: dict[str, Any] = {
            "light_earliest_s": receipt.earliest_s,
            "light_latest_s": receipt.latest_s,
            "light_confirmed": receipt.confirmed,
            "settled_s": settled_s,
            "exposure_asked_s": shot.exposure_s,
            "exposure_applied_s": self._settings.exposure_s if self._settings else None,
            "discarded": flushed.discarded + changed,
        }
        self.on_step(shot.id, Step.EXPOSE)
        if self.rig.trigger_mode == "free-run":
            self.on_step(shot.id, Step.COLLECT)
            frame = self._wait_for_proof(shot, settled_s, cancel, details)
        else:
            fired_s = self._fire(shot, cancel, details)
            self.on_step(shot.id, Step.COLLECT)
            frame = self._collect(shot, cancel, fired_s)
            details["proof"] = "triggered"
        self.on_step(shot.id, Step.CHECK)
        self._check(shot, frame, details)
        return Taken(frame=frame, details=details)

    def _show(self, shot: Shot, cancel: CancelToken, *, again: bool) -> ShowReceipt:
        self.on_step(shot.id, Step.SHOW)
        wanted = (shot.pattern, shot.shutter)
        if again and self._receipt is not None and self._shown == wanted:
            return self._receipt
        self._receipt = self._shown = None
        deadline_s = self.rig.now_s() + MARGIN_S
        projector = self.rig.projector
        self.rig.cover(covered=shot.shutter == "covered")
        if shot.pattern is None:
            receipt = projector.lamp_off(deadline_s=deadline_s, cancel=cancel)
        else:
            receipt = projector.show(
                self.handles[shot.pattern], deadline_s=deadline_s, cancel=cancel
            )
        self._receipt, self._shown = receipt, wanted
        return receipt

    def _configure(self, shot: Shot, cancel: CancelToken) -> int:
        """Set the exposure if it is another; return how many frames were thrown away after."""
        camera = self.rig.camera
        wanted = CameraSettings(exposure_s=shot.exposure_s, gain_db=self.gain_db)
        if self._settings is not None and self._settings.exposure_s == wanted.exposure_s:
            return 0
        self._settings = None
        applied = camera.apply(wanted)
        if abs(applied.exposure_s - shot.exposure_s) > 1e-3 * shot.exposure_s:
            msg = (
                f"shot {shot.id}: the camera took {applied.exposure_s} s instead of "
                f"{shot.exposure_s} s; choose an exposure it has."
            )
            raise RunError(msg)
        thrown = 0
        for _ in range(self.discard if self.rig.trigger_mode != "free-run" else 0):
            fired = self.rig.trigger.fire(deadline_s=self.rig.now_s() + MARGIN_S, cancel=cancel)
            self._collect(shot, cancel, fired.latest_s)
            thrown += 1
        self._settings = applied
        return thrown

    def _fire(self, shot: Shot, cancel: CancelToken, details: dict[str, Any]) -> float:
        """Fire once, and once more if the trigger knows that it did not; check the counter."""
        trigger = self.rig.trigger
        before = trigger.counters().pulses
        try:
            fired = trigger.fire(deadline_s=self.rig.now_s() + MARGIN_S, cancel=cancel)
        except TriggerNotFiredError:
            details["fired_again"] = True
            fired = trigger.fire(deadline_s=self.rig.now_s() + MARGIN_S, cancel=cancel)
        counted = trigger.counters().pulses - before
        if counted != 1:
            msg = (
                f"shot {shot.id}: the trigger's counter rose by {counted} where one pulse was "
                "asked for; check its wiring and power."
            )
            raise AttemptError(Cause.NOT_FIRED, msg, details=details)
        details |= {"fired_earliest_s": fired.earliest_s, "fired_latest_s": fired.latest_s}
        return fired.latest_s

    def _collect(self, shot: Shot, cancel: CancelToken, from_s: float) -> Frame:
        can = self.rig.camera_can
        # an old exposure may still be in the pipeline and be the longer one
        longest = max(shot.exposure_s, self._settings.exposure_s if self._settings else 0.0)
        rolled_s = can.row_time_s * can.rows
        deadline_s = max(from_s, self.rig.now_s()) + longest + rolled_s + can.readout_s + MARGIN_S
        return self.rig.camera.collect(deadline_s=deadline_s, cancel=cancel)

    def _wait_for_proof(
        self, shot: Shot, settled_s: float, cancel: CancelToken, details: dict[str, Any]
    ) -> Frame:
        """Take frames of a free-running camera until one surely saw the pattern and exposure.

        With time stamps a frame must begin after the light has settled. Without them so many
        whole frames must have arrived since that none of the old ones can be left.
        """
        can = self.rig.camera_can
        stamped = can.timestamp_source in ("start", "end")
        to_pass = can.queue_depth + can.exposure_latency_frames + 1
        details["proof"] = "timestamped" if stamped else "count"
        since_s, thrown = max(settled_s, self.rig.now_s()), 0
        begun_s = settled_s
        for _ in range(to_pass + can.exposure_latency_frames + 3):
            frame = self._collect(shot, cancel, self.rig.now_s())
            start = frame.t_start_s if stamped else None
            if start is not None:
                begun = start - frame.uncertainty_s >= begun_s
                # without a report, frames begun before the change took hold must pass
                passed = frame.exposure_s is not None or thrown >= can.exposure_latency_frames
                if begun and passed and _exposed(frame, shot):
                    details["discarded"] += thrown
                    return frame
                thrown += begun
            elif frame.t_arrival_s >= since_s:
                if thrown >= to_pass and _exposed(frame, shot):
                    details["discarded"] += thrown
                    return frame
                thrown += 1
        msg = (
            f"shot {shot.id}: {thrown} frames passed after the pattern had settled, and none had "
            f"{shot.exposure_s} s; measure the camera's exposure latency."
        )
        raise AttemptError(Cause.WRONG_EXPOSURE, msg, frame=frame, details=details)

    def _check(self, shot: Shot, frame: Frame, details: dict[str, Any]) -> None:
        """Hold a frame to the rules; complete what the journal shall say of it."""
        white = self.rig.camera_can.white_level_dn
        details |= {
            "sequence": frame.sequence,
            "t_start_s": frame.t_start_s,
            "t_end_s": frame.t_end_s,
            "t_uncertainty_s": frame.uncertainty_s,
            "exposure_reported_s": frame.exposure_s,
            "gain_reported_db": frame.gain_db,
            **_ends(frame.pixels, white),
        }
        if self._last_sequence and frame.sequence > self._last_sequence + 1:
            details["gap"] = frame.sequence - self._last_sequence - 1
        digest = pixel_digest(frame.pixels)
        found = self._fault(shot, frame, digest, details)
        if found is not None:
            cause, message = found
            raise AttemptError(cause, f"shot {shot.id}: {message}", frame=frame, details=details)
        doubt = self.looks.doubt(shot, frame.pixels, details)
        if doubt is not None:
            cause, message = doubt
            raise AttemptError(cause, f"shot {shot.id}: {message}", frame=frame, details=details)
        self._last_sequence, self._last_pixels = frame.sequence, digest

    def _fault(
        self, shot: Shot, frame: Frame, digest: str, details: Mapping[str, Any]
    ) -> tuple[Cause, str] | None:
        """Return the first rule that a frame breaks, in words; None if it keeps them all."""
        if frame.flags:
            return Cause.CORRUPT, f"the driver marks the frame: {', '.join(sorted(frame.flags))}."
        if frame.sequence <= self._last_sequence:
            return Cause.DUPLICATE, (
                f"frame {frame.sequence} came after frame {self._last_sequence}; it is an old one."
            )
        if digest == self._last_pixels and frame.pixels.min() != frame.pixels.max():
            return Cause.DUPLICATE, "the pixels are those of the frame before, which noise forbids."
        # a fired frame cannot begin before its edge, whatever its stamp's uncertainty; a
        # free-running one has nothing but its stamp
        start, end, u = frame.t_start_s, frame.t_end_s, frame.uncertainty_s
        fired_s = details.get("fired_earliest_s")
        surely_s, since_s = (
            (None, 0.0)
            if start is None or not self._stamps_are_times
            else (start - u, details["settled_s"])
            if fired_s is None
            else (start + u, fired_s)
        )
        if surely_s is not None and surely_s < since_s:
            return Cause.EARLY, (
                f"the frame began at {start:.4f} s, before {since_s:.4f} s, when the pattern had "
                "settled; recalibrate the projector's latency."
            )
        if end is not None and end - u > self.rig.now_s():
            return Cause.EARLY, f"the frame ends at {end:.4f} s, in the future; check its clock."
        if not _exposed(frame, shot):
            return Cause.WRONG_EXPOSURE, (
                f"the frame was exposed {frame.exposure_s} s instead of {shot.exposure_s} s."
            )
        return None

    @property
    def _stamps_are_times(self) -> bool:
        return self.rig.camera_can.timestamp_source in ("start", "end")


def _exposed(frame: Frame, shot: Shot) -> bool:
    """Whether a frame reports the exposure that was asked for, or none."""
    reported = frame.exposure_s
    return reported is None or abs(reported - shot.exposure_s) <= 1e-3 * shot.exposure_s


def _ends(pixels: NDArray[np.uint16], white_level_dn: int) -> dict[str, float]:
    """Return the shares of pixels at zero and at the white level; most frames have neither."""
    dark = 0 if pixels.min() else pixels.size - np.count_nonzero(pixels)
    full = 0 if pixels.max() < white_level_dn else np.count_nonzero(pixels >= white_level_dn)
    return {"floor_fraction": dark / pixels.size, "saturated_fraction": full / pixels.size}
