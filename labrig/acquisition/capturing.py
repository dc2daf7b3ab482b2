"""Captures a plan into a new session, and resumes one that was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrig.acquisition.header import header_of
from labrig.acquisition.preflight import Verdict, check_all
from labrig.acquisition.probe import resolve
from labrig.acquisition.references import References
from labrig.acquisition.run_state import Command, Event, Finish, State
from labrig.acquisition.runner import Runner
from labrig.config import parse
from labrig.errors import PlanError, RunError, SessionError
from labrig.models.latency import LatencyRecord
from labrig.models.plan import Plan, Shot
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import CapturePlan, blocks_of, expand
from labrig.rig import OpenRig
from labrig.session import Session
from labrig.session.recovery import Recovery, reopen
from labrig.session.writer import SessionWriter

NAMES = {"device", "display", "output", "port"}  # a replug may change them; serial numbers tell
TIMES = {"latency_s", "jitter_s", "settle_s", "calibrated"}  # a newer calibration may change them
# what every shot may change, and counters of a box
VOLATILE = {"exposure_s", "exposure_absolute", "exposure_time_absolute", "gain_db", "roi"}
VOLATILE |= {"pixel_format", "mode", "armed", "watchdog_tripped", "damaged_lines"}

Listener = Callable[[Event], None]


class AbortedError(RunError):
    """Raised when a run was aborted; what was saved stays saved, and it can be resumed."""


def prepare(plan: Plan, rig: OpenRig, out: Path, *, operator: str | None = None) -> Runner:
    """Return a runner that captures a plan into a new session below ``out``."""
    expanded = expand(resolve(plan, rig), rig.config)

    def open_session() -> SessionWriter:
        return SessionWriter.create(
            out,
            plan.name,
            header_of(expanded, rig, operator),
            patterns=expanded.images,
            disk=rig.disk,
        )

    return Runner(
        expanded,
        rig,
        open_session,
        verdicts=lambda: [
            *check_all(expanded, rig.config, rig.latency, out),
            *_camera(expanded, rig),
        ],
    )


def prepare_resume(path: Path, rig: OpenRig) -> Runner:
    """Return a runner that captures what an interrupted session lacks.

    Raises
    ------
    SessionError
        If the session cannot be trusted, is complete, or is being written.
    RunError
        If plan or devices are not those it was begun with; the message lists the differences.
    """
    session = Session.open(path)
    if session.sealed and not session.missing:
        msg = f"{path} is complete and sealed: there is nothing to resume."
        raise SessionError(msg)
    plan = plan_of(session.header, path)
    expanded = expand(plan, rig.config)
    _refuse_other_plan(expanded, session)
    _refuse_other_devices(session.header, rig)
    missing = set(session.missing)
    # a group that lacks a shot is taken again as a whole
    torn = [b for b in blocks_of(expanded.shots) if any(shot.id in missing for shot in b)]
    left = [shot for block in torn for shot in block]
    before = next(
        (e["reference"] for e in reversed(session.events) if isinstance(e.get("reference"), dict)),
        None,
    )

    def open_session() -> SessionWriter:
        writer, recovery = reopen(path, disk=rig.disk)
        try:
            _begin_again(writer, recovery, expanded)
        except BaseException as error:
            writer.leave("failed", str(error))
            raise
        return writer

    return Runner(
        expanded,
        rig,
        open_session,
        verdicts=lambda: check_all(expanded, rig.config, rig.latency, path, left=left),
        references=References(plan, rig, before=before),
    )


def finish(runner: Runner) -> Path:
    """Run to the end and return the session's folder.

    Raises
    ------
    Exception
        What made the run fail or refuse; `AbortedError` if it was aborted.
    """
    ended: Finish = runner.run()
    if ended.error is not None:
        raise ended.error
    if ended.status.state is not State.COMPLETED:
        msg = f"the run ended {ended.status.state}: {ended.status.reason}"
        raise (AbortedError if ended.status.state is State.ABORTED else RunError)(msg)
    return runner.path


def capture(
    plan: Plan,
    rig: OpenRig,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    listener: Listener | None = None,
) -> Path:
    """Take every shot of a plan and return the sealed session folder.

    A run that pauses has nobody to ask here: it is aborted, and can be resumed.

    Parameters
    ----------
    out : data root; the session is made below it
    progress : called with (shots saved, shots in all)
    listener : hears every event of the run
    """
    return _unattended(prepare(plan, rig, out), progress, listener)


def resume(
    path: Path,
    rig: OpenRig,
    *,
    progress: Callable[[int, int], None] | None = None,
    listener: Listener | None = None,
) -> Path:
    """Take the shots an interrupted session lacks; return its folder, now sealed."""
    return _unattended(prepare_resume(path, rig), progress, listener)


def _unattended(
    runner: Runner,
    progress: Callable[[int, int], None] | None,
    listener: Listener | None,
) -> Path:
    paused: list[str] = []

    def hear(event: Event) -> None:
        if event.kind == "saved" and progress is not None:
            progress(event.status.saved, event.status.total)
        if event.kind == "state" and event.status.state is State.PAUSED:
            paused.append(event.status.reason)
            runner.post(Command.ABORT)

    if listener is not None:
        runner.subscribe(listener)
    runner.subscribe(hear)
    runner.post(Command.START)
    try:
        return finish(runner)
    except AbortedError as error:
        raise AbortedError(paused[0] if paused else str(error)) from None


def plan_of(header: Mapping[str, Any], path: Path) -> Plan:
    """Return the plan a session was captured with."""
    return parse(header.get("plan"), Plan, source=f"{path}: plan")


def rig_of(header: Mapping[str, Any], path: Path) -> tuple[Rig, Scene | None, LatencyRecord | None]:
    """Return rig, scene and latency of a captured session; its scripted faults are over.

    Raises
    ------
    SessionError
        If the session was not captured here.
    """
    if header.get("rig") is None:
        msg = f"{path} names no rig: it was not captured here, and nothing can be added to it."
        raise SessionError(msg)
    rig = parse(header["rig"], Rig, source=f"{path}: rig")
    simulation = rig.simulation.model_copy(update={"faults": ()})
    told = header.get("scene")
    scene = None if told is None else parse(told, Scene, source=f"{path}: scene")
    kept = (header.get("calibration") or {}).get("projector_latency")
    latency = None if kept is None else parse(kept, LatencyRecord, source=f"{path}: calibration")
    return rig.model_copy(update={"simulation": simulation}), scene, latency


def _begin_again(writer: SessionWriter, recovery: Recovery, expanded: CapturePlan) -> None:
    """Journal the resume; groups that were torn are taken again, in the new segment."""
    writer.record(
        "resume",
        after="interruption",
        lost=list(recovery.lost),
        quarantined=list(recovery.quarantined),
        at=datetime.now(UTC).isoformat(timespec="milliseconds"),
    )
    for block in blocks_of(expanded.shots):
        saved = [shot for shot in block if shot.id in writer.progress.saved]
        if 0 < len(saved) < len(block):
            for shot in saved:
                writer.void(shot.id, "the session was interrupted in the middle of the group")
    writer.record("segment", reason="resumed after an interruption")


def _refuse_other_plan(expanded: CapturePlan, session: Session) -> None:
    if session.header.get("plan_digest") == expanded.digest:
        return
    now = {shot.id: shot for shot in expanded.shots}
    for planned in session.shots:
        shot = parse(dict(planned), Shot, source=f"{session.path}: shots")
        if now.get(shot.id) != shot:
            msg = (
                f"{session.path.name}: shot {shot.id} is planned otherwise on this rig; resume "
                "with the rig and version it was begun with."
            )
            raise RunError(msg)
    msg = f"{session.path.name}: its plan digest is not that of its shots; do not trust it."
    raise RunError(msg)


def _refuse_other_devices(header: Mapping[str, Any], rig: OpenRig) -> None:
    planned = rig.config.model_dump(mode="json", by_alias=True)
    kept = {key: (header.get("rig") or {}).get(key) for key in planned}
    may_change = NAMES | TIMES
    pairs = (
        (header.get("devices") or {}, rig.snapshot(), may_change | VOLATILE),
        (_fixed(kept), _fixed(planned), may_change),
    )
    differences: dict[str, str] = {}
    for then, is_now, ignored in pairs:
        before, now = _flat(then, ignored), _flat(is_now, ignored)
        for name in sorted(before.keys() | now.keys()):
            if before.get(name) != now.get(name):
                told = f"{name} was {before.get(name)!r}, is {now.get(name)!r}"
                differences.setdefault(name.replace(".settings.", "."), told)
    if differences:
        told = "; ".join(differences.values())
        msg = f"the rig is not the one the session was begun with: {told}."
        raise RunError(msg)


def _fixed(rig: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a rig file by which pictures are understood."""
    return {key: rig[key] for key in ("camera", "projector", "trigger", "geometry", "projection")}


def _flat(tree: Mapping[str, Any], ignored: set[str], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= _flat(value, ignored, f"{prefix}{name}.")
        elif name not in ignored:
            found[f"{prefix}{name}"] = list(value) if isinstance(value, tuple) else value
    return found


def _camera(expanded: CapturePlan, rig: OpenRig) -> list[Verdict]:
    """Hold the exposures to what the open camera says it has."""
    low, high = rig.camera_can.exposure_range_s
    for shot in expanded.shots:
        if not low <= shot.exposure_s <= high:
            text = (
                f"plan {expanded.plan.name!r} asks for {shot.exposure_s} s, the camera has "
                f"{low} .. {high} s; change exposures.bracket_s."
            )
            return [Verdict(name="camera", ok=False, text=text, fatal=PlanError)]
    return []
