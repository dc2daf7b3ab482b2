"""Owns the devices for the operator's window: live pictures between runs, and the runs themselves.

All of it happens in the one thread that calls `Station.run`; a run gets the camera from the live
view, and gives it back.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from pathlib import Path

from calibration.errors import CalibrationError
from drivers.errors import DriverError
from labrig.acquisition.capturing import plan_of, prepare, prepare_resume, rig_of
from labrig.acquisition.probe import resolve
from labrig.acquisition.run_state import Command, Event
from labrig.acquisition.runner import Runner
from labrig.config import latency_beside, load, parse
from labrig.errors import LabrigError
from labrig.models.plan import Plan, Shot
from labrig.models.rig import Rig, SimulatedCameraConfig
from labrig.models.scene import Scene
from labrig.plan import bracket_of, expand, stripes_of
from labrig.rig import OpenRig, open_rig
from labrig.session import Session
from labrig.station.door import (
    Counts,
    Disconnected,
    Door,
    Picture,
    RunEnded,
    Said,
    Show,
    Trouble,
    Working,
)
from labrig.station.live import Live, SilentError
from labrig.station.telling import connected, planned, told

IDLE_S = 0.05  # between two looks for questions while there is nothing to show
ERRORS = (LabrigError, DriverError, CalibrationError, OSError)


class Station:
    """The rig's one owner. Questions come through the door and are answered by messages.

    Parameters
    ----------
    rig, scene, plan : files; the scene is what a simulated rig looks at
    out : data root, below which sessions are made
    """

    def __init__(self, door: Door, *, rig: Path, scene: Path, plan: Path, out: Path) -> None:
        self._door = door
        self._files = (rig, scene)
        self._plan_file = plan
        self._out = out
        self._plan: Plan | None = None
        self._config: Rig | None = None
        self._rig: OpenRig | None = None
        self._live: Live | None = None
        self._paused = False
        self._wanted: tuple[float, float] = (0.0, 0.0)
        self._shows: Show = "stripes"

    def run(self) -> None:
        """Serve until the door is closed; the rig is then closed and dark."""
        self._guard(self._begin)
        try:
            while not self._door.closing.is_set():
                live = self._live
                while self._answer(block=live is None or self._paused):
                    pass
                if self._live is not None and not self._paused:
                    self._look(self._live)
        finally:
            self._close()

    # What the window may ask; each of these runs in this thread.

    def connect(self, rig: Path | None = None, scene: Path | None = None) -> None:
        """Open the rig, or another one, and show its light."""
        self._files = (rig or self._files[0], scene or self._files[1])
        self._close()
        config = load(self._files[0], Rig)
        simulated = isinstance(config.camera, SimulatedCameraConfig)
        seen = load(self._files[1], Scene) if simulated else None
        plan = self._need_plan()
        self._config = config

        def follow(done: int, total: int) -> None:
            self._door.told.put(Working(what="computing the scene's light", done=done, total=total))

        try:
            self._open(
                open_rig(
                    config, seen, plan, latency=latency_beside(self._files[0]), progress=follow
                )
            )
        except ERRORS as error:
            self._door.told.put(Disconnected(why=str(error)))
            raise
        finally:
            self._door.told.put(Working(what="", done=0, total=0))
        self.tell_plan()

    def expose(self, exposure_s: float, gain_db: float) -> None:
        """Set exposure and gain of the live view; what the camera takes is told."""
        self._wanted = (exposure_s, gain_db)
        if self._live is not None:
            self._door.told.put(self._live.expose(exposure_s, gain_db))

    def show(self, what: Show) -> None:
        """Let the projector show something."""
        self._shows = what
        if self._live is not None:
            self._live.show(what)

    def hold(self, *, paused: bool) -> None:
        """Stop the live view, or let it go on."""
        self._paused = paused

    def change_plan(
        self,
        *,
        period_px: int | None = None,
        shifts: int | None = None,
        bracket_s: tuple[float, ...] | None = None,
    ) -> None:
        """Change stripes or bracket; a simulated tank answers one period, and is made anew."""
        before = self._need_plan()
        content = before.model_dump(mode="json", by_alias=True)
        for entry in content["sets"]:
            if entry["pattern"]["kind"] == "stripes":
                entry["pattern"]["period_px"] = period_px or entry["pattern"]["period_px"]
                entry["pattern"]["shifts"] = shifts or entry["pattern"]["shifts"]
        if bracket_s is not None:
            content["exposures"] |= {"bracket_s": list(bracket_s), "auto": None}
        try:
            changed = parse(content, Plan, source="plan")
            if self._config is not None:
                expand(changed, self._config)
        finally:
            self.tell_plan()  # a refused change is seen to have been refused
        self._plan = changed
        if self._rig is not None and stripes_of(changed) != stripes_of(before):
            if self._rig.simulated:
                self.connect()
                return
            self._relive()
        self.tell_plan()

    def capture(self, operator: str | None = None) -> None:
        """Run the plan into a new session."""
        rig, plan = self._need_rig(), self._need_plan()
        self._run(lambda: prepare(plan, rig, self._out, operator=operator))

    def resume(self, session: Path) -> None:
        """Take what an interrupted session lacks, on the rig it was begun with."""
        header = Session.open(session).header
        if not header.get("simulated"):
            rig = self._need_rig()
            self._run(lambda: prepare_resume(session, rig))
            return
        config, scene, latency = rig_of(header, session)
        self._close()
        try:
            with open_rig(config, scene, plan_of(header, session), latency=latency) as opened:
                self._rig = opened
                self._run(lambda: prepare_resume(session, opened))
        finally:
            self._rig = None
            self.connect()

    def recover(self) -> None:
        """Close the devices and open them again: what Retry asks after a loss."""
        self._door.told.put(Trouble(text=""))
        self._paused = False
        self.connect()

    def tell_plan(self) -> None:
        """Tell what the plan is, what it costs and whether it could run."""
        if self._config is not None:
            latency = latency_beside(self._files[0])
            self._door.told.put(planned(self._need_plan(), self._config, latency, self._out))

    # How it is done.

    def _begin(self) -> None:
        self._plan = load(self._plan_file, Plan)
        self.connect()

    def _answer(self, *, block: bool) -> bool:
        """Do the next thing that was asked; return whether there was one."""
        try:
            question = (
                self._door.asked.get(timeout=IDLE_S) if block else (self._door.asked.get_nowait())
            )
        except queue.Empty:
            return False
        self._guard(lambda: question(self))
        return True

    def _guard(self, act: Callable[[], None]) -> None:
        """Do something; what goes wrong is told, and the station goes on."""
        try:
            act()
        except ERRORS as error:
            self._door.told.put(Said(level="error", text=" ".join(str(error).split())))
            if self._rig is None:
                self._trouble(error)

    def _trouble(self, error: Exception) -> None:
        text = " ".join(str(error).split())
        self._door.told.put(Trouble(text=text, safe="Nothing that was saved is lost."))

    def _look(self, live: Live) -> None:
        """Take one live picture and hand it over; silence and loss are told once."""
        try:
            picture = live.take()
        except SilentError as error:
            self._paused = True
            self._trouble(error)
        except ERRORS as error:
            self._paused = True
            self._live = None
            self._trouble(error)
            self._door.told.put(Disconnected(why=str(error)))
        else:
            self._door.pictures.put(picture)
            found = live.stripe_set()
            if found is not None:
                self._door.stripes.put(found)

    def _open(self, rig: OpenRig) -> None:
        self._rig = rig
        self._plan = resolve(self._need_plan(), rig)  # an automatic bracket is found now
        self._door.told.put(connected(rig))
        self._relive()

    def _relive(self) -> None:
        """Begin the live view of the rig that is open."""
        rig, plan = self._need_rig(), self._need_plan()
        self._live = Live(rig, plan)
        exposure_s, gain_db = self._wanted
        low, high = rig.camera_can.exposure_range_s
        if not low <= exposure_s <= high:
            exposure_s = min(bracket_of(plan, rig.config)) if plan.exposures.bracket_s else 0.02
        self._live.show(self._shows)
        self.expose(exposure_s, gain_db)

    def _run(self, make: Callable[[], Runner]) -> None:
        """Run to the end in this thread, then give the camera back to the live view."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        try:
            runner = make()
        except ERRORS as error:
            self._door.told.put(RunEnded(state="refused", reason=str(error), session=None))
            self._relive()
            return
        handed: list[str] = []

        def hear(event: Event) -> None:
            self._door.told.put(told(event))
            latest = runner.latest
            if latest is not None and handed[-1:] != [latest[0].id]:
                handed[:] = [latest[0].id]
                self._door.pictures.put(self._of_run(*latest))

        runner.subscribe(hear)
        self._door.listen(lambda word: runner.post(Command(word)))
        runner.post(Command.START)
        try:
            ended = runner.run()
        finally:
            self._door.listen(None)
        state = ended.status.state
        folder = runner.path if runner.armed else None
        self._door.told.put(RunEnded(state=str(state), reason=ended.status.reason, session=folder))
        try:
            self._relive()
        except ERRORS as error:
            self._live = None
            self._trouble(error)

    def _of_run(self, shot: Shot, pixels: Counts) -> Picture:
        return Picture(
            pixels=pixels,
            exposure_s=shot.exposure_s,
            gain_db=self._need_plan().exposures.gain_db,
            taken_s=time.monotonic(),
            shows=shot.id,
        )

    def _close(self) -> None:
        if self._live is not None:
            self._live.stop()
        self._live = None
        if self._rig is not None:
            self._rig.close()
        self._rig = None

    def _need_plan(self) -> Plan:
        if self._plan is None:
            self._plan = load(self._plan_file, Plan)
        return self._plan

    def _need_rig(self) -> OpenRig:
        if self._rig is None:
            msg = "no rig is connected; connect one first."
            raise LabrigError(msg)
        return self._rig
