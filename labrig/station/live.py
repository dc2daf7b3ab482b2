"""Live pictures of an open rig between runs: one pattern, or stripes that shift without end."""

from __future__ import annotations

import time
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera.protocol import CameraSettings, Frame
from drivers.errors import NoFrameError
from drivers.simulation.clock import VirtualClock
from drivers.waiting import CancelToken
from labrig.acquisition.estimate import discard_of, settle_of
from labrig.acquisition.header import setup_of
from labrig.acquisition.looks import Looks
from labrig.acquisition.sequence import MARGIN_S, AttemptError, Cause, Sequencer
from labrig.errors import LabrigError
from labrig.models.plan import BlackPattern, Plan, Shot, UniformPattern
from labrig.patterns import Image, digest, draw
from labrig.plan import bracket_of, stripes_of
from labrig.rig import OpenRig
from labrig.station.door import Applied, Picture, Show, StripeSet
from labrig.steps.rectify import turned

SILENT_S = 2.0  # without a frame for so long the operator is told
FASTEST_S = 1.0 / 30.0  # between two pictures where time costs nothing
BLACK_AGE_S = 10.0  # a black picture is taken again while stripes cycle
CYCLE_S = 1.0 / 60.0  # longest exposure of cycling stripes: no set of six is a second old then
CELLS = 4.0  # of the reduced picture, at least, in a period of the stripes
APART = 0.1  # periods in a cell, between two waves that look alike over the shifts
MOST_BINNED, UNKNOWN_BINNED = 8, 2  # pixels along a side; where the period is not known


class SilentError(LabrigError):
    """Raised when the camera sends nothing, and says not why."""


class Live:
    """The live view: knows what shall be shown and how it shall be exposed."""

    def __init__(self, rig: OpenRig, plan: Plan) -> None:
        self._rig = rig
        self._plan = plan
        self._cancel = CancelToken()
        stripes = stripes_of(plan)
        rows, cols = rig.projector_can.rows, rig.projector_can.cols
        drawn = {
            "white": draw(UniformPattern(kind="uniform"), rows, cols, 0),
            "black": draw(BlackPattern(kind="black"), rows, cols, 0),
            **{f"shift {k}": draw(stripes, rows, cols, k) for k in range(stripes.shifts)},
        }
        self._images: dict[str, Image] = {n: i for n, i in drawn.items() if i is not None}
        self._shifts = stripes.shifts
        self._setup = setup_of(plan, rig)
        self._shows: Show = "stripes"
        self._armed: Show | None = None
        self._applied = CameraSettings(exposure_s=rig.camera_can.exposure_range_s[0])
        self._cycle_s = CYCLE_S  # exposure of cycling stripes, as the camera took it
        self._sequencer: Sequencer | None = None
        self._turn = 0
        self._reduced: dict[str, tuple[NDArray[np.float32], float]] = {}
        self._fresh = False
        self._last_s = 0.0

    def show(self, what: Show) -> None:
        """Show something from the next picture on."""
        self._shows = what
        self._armed = None

    def expose(self, exposure_s: float, gain_db: float) -> Applied:
        """Set exposure and gain; return what the camera took.

        A setting that the camera refuses leaves the one before, and the answer says why.
        """
        why = ""
        try:
            self._applied = self._rig.camera.apply(
                CameraSettings(exposure_s=exposure_s, gain_db=gain_db)
            )
        except NoFrameError:
            raise
        except Exception as error:
            if not isinstance(error, LabrigError) and type(error).__module__ != "drivers.errors":
                raise
            why = str(error)
        self._armed = None
        self._reduced.clear()
        return Applied(
            asked_exposure_s=exposure_s,
            exposure_s=self._applied.exposure_s,
            asked_gain_db=gain_db,
            gain_db=self._applied.gain_db,
            why=why,
        )

    def take(self) -> Picture:
        """Return the next picture.

        Raises
        ------
        SilentError
            If none came in time.
        LabrigError, DriverError
            If a device is lost.
        """
        if self._armed != self._shows:
            self._arm()
        name: str = self._shows
        exposure_s = self._applied.exposure_s
        if self._shows == "cycle":
            frame, name = self._next_shift()
            exposure_s = self._cycle_s
        else:
            frame = self._newest()
        if isinstance(self._rig.clock, VirtualClock):
            time.sleep(max(self._last_s + FASTEST_S - time.monotonic(), 0.0))
        self._last_s = time.monotonic()
        age_s = 0.0
        if not isinstance(self._rig.clock, VirtualClock):
            age_s = max(self._rig.now_s() - frame.t_arrival_s, 0.0)
        picture = Picture(
            pixels=frame.pixels,
            exposure_s=frame.exposure_s or exposure_s,
            gain_db=frame.gain_db if frame.gain_db is not None else self._applied.gain_db,
            taken_s=self._last_s - age_s,
            shows=name,
        )
        if self._shows == "cycle":
            self._keep(name, picture)
        return picture

    def stripe_set(self) -> StripeSet | None:
        """Return the newest picture of every shift, if one of them is new; None else."""
        names = [f"shift {k}" for k in range(self._shifts)]
        if not self._fresh or "black" not in self._reduced:
            return None
        if any(name not in self._reduced for name in names):
            return None
        self._fresh = False
        return StripeSet(
            counts=np.stack([self._reduced[name][0] for name in names]),
            black=self._reduced["black"][0],
            binned=self._binned,
            exposure_s=self._cycle_s,
            setup=self._setup.model_dump(mode="json"),
            taken_s=min(self._reduced[name][1] for name in names),
            plan_s=sum(bracket_of(self._plan, self._rig.config)),
        )

    def stop(self) -> None:
        """Take no more pictures, and go dark."""
        self._rig.camera.disarm()
        self._rig.projector.make_safe()
        self._armed = None

    def _arm(self) -> None:
        """Show what shall be shown, and let the camera take pictures by the quickest way."""
        rig, cancel = self._rig, self._cancel
        rig.camera.disarm()
        rig.cover(covered=False)
        self._armed = self._shows
        if self._shows == "cycle":
            asked_s = max(
                min(self._applied.exposure_s, CYCLE_S), rig.camera_can.exposure_range_s[0]
            )
            self._cycle_s = rig.camera.apply(replace(self._applied, exposure_s=asked_s)).exposure_s
            handles = rig.arm([*self._images.values()])
            self._sequencer = Sequencer(
                rig=rig,
                handles={
                    digest(image): handle
                    for image, handle in zip(self._images.values(), handles, strict=True)
                },
                settle_s=settle_of(self._plan, rig.projector_can.settle_s),
                discard=discard_of(self._plan, rig.camera_can.exposure_latency_frames),
                looks=Looks(rig, self._plan),
                gain_db=self._applied.gain_db,
            )
            self._turn = 0
            self._reduced.clear()
            return
        deadline_s = rig.now_s() + MARGIN_S
        if self._shows == "off":
            receipt = rig.projector.lamp_off(deadline_s=deadline_s, cancel=cancel)
        else:
            name = "shift 0" if self._shows == "stripes" else self._shows
            (handle,) = rig.projector.load([self._images[name]])
            receipt = rig.projector.show(handle, deadline_s=deadline_s, cancel=cancel)
        rig.clock.wait_until(receipt.latest_s + rig.projector_can.settle_s, cancel)
        self._applied = rig.camera.apply(replace(self._applied, pixel_format=None))
        rig.camera.arm("free-run" if self._runs_free else rig.trigger_mode)

    @property
    def _runs_free(self) -> bool:
        return "free-run" in self._rig.camera_can.trigger_modes

    def _newest(self) -> Frame:
        rig, can = self._rig, self._rig.camera_can
        patience_s = self._applied.exposure_s + can.readout_s + SILENT_S
        if not self._runs_free:
            rig.trigger.fire(deadline_s=rig.now_s() + MARGIN_S, cancel=self._cancel)
        try:
            frame = self._collect(patience_s)
            period_s = max(self._applied.exposure_s, can.readout_s)
            if self._runs_free and rig.now_s() - frame.t_arrival_s > 1.5 * period_s:
                rig.camera.flush()  # pictures that waited are old ones
                frame = self._collect(patience_s)
        except NoFrameError as error:
            msg = f"The camera sent no frame for {SILENT_S:.1f} s. {_sentence(error)}"
            raise SilentError(msg) from error
        return frame

    def _collect(self, patience_s: float) -> Frame:
        deadline_s = self._rig.now_s() + patience_s
        return self._rig.camera.collect(deadline_s=deadline_s, cancel=self._cancel)

    def _next_shift(self) -> tuple[Frame, str]:
        """Take the next shift of the cycle by the rules of a run; black now and then."""
        sequencer = self._sequencer
        if sequencer is None:
            msg = "stripes are taken after arming"
            raise AssertionError(msg)
        black = self._reduced.get("black")
        old = black is None or time.monotonic() - black[1] > BLACK_AGE_S
        turn = self._turn % self._shifts
        shift = None if old and turn == 0 else turn
        name = "black" if shift is None else f"shift {shift}"
        self._turn += shift is not None
        shot = Shot(
            id=f"live-{self._turn}-{name.replace(' ', '-')}",
            set="live",
            role="black" if shift is None else "stripes",
            group="live",
            exposure_s=self._cycle_s,
            shift=shift,
            shifts=None if shift is None else self._shifts,
            pattern=digest(self._images[name]),
        )
        sequencer.looks.forget_pictures()  # the operator moves lens and sample meanwhile
        try:
            return sequencer.attempt(shot, self._cancel, again=False).frame, name
        except AttemptError as error:
            sequencer.looks.begin_again()
            if error.cause is Cause.NO_FRAME:
                msg = f"The camera sent no frame. {_sentence(error)}"
                raise SilentError(msg) from error
            if error.frame is None or error.cause is Cause.DEVICE_LOST:
                raise
            return error.frame, "doubtful"

    def _keep(self, name: str, picture: Picture) -> None:
        if name not in self._images:
            return
        region = turned(picture.pixels, self._setup)
        n = self._binned
        rows, cols = (size // n for size in region.shape)
        part = np.ascontiguousarray(region[: rows * n, : cols * n])
        small = cv2.resize(part.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
        clipped = (part >= self._rig.camera_can.white_level_dn).astype(np.float32)
        if clipped.any():
            lost = cv2.resize(clipped, (cols, rows), interpolation=cv2.INTER_AREA) > 0.0
            small[lost] = np.nan
        self._reduced[name] = (small, picture.taken_s)
        self._fresh = name != "black"

    @property
    def _binned(self) -> int:
        """Pixels that are averaged along each side."""
        scale, projection = self._setup.geometry.mm_per_px, self._setup.projection
        stripes = self._setup.stripes
        if scale is None or projection is None or stripes is None:
            return UNKNOWN_BINNED
        return binned_for(stripes.period_px * projection.mm_per_px / scale, self._shifts)


def binned_for(period_px: float, shifts: int) -> int:
    """Return how many pixels of the camera may be averaged along each side.

    As many as leave a few cells to a period of the stripes. Over N shifts their harmonics of
    order h and h - N look alike, and are told apart by their waves alone: not by cells of which a
    period holds N, or a whole part of it.
    """
    for n in range(MOST_BINNED, 1, -1):
        alias = shifts * n / period_px
        if period_px / n >= CELLS and abs(alias - round(alias)) > APART:
            return n
    return 1


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text[:1].upper() + text[1:]
