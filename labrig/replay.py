"""Makes a camera of a recorded session, so that a run can be had again without its sample."""

from __future__ import annotations

from collections import defaultdict
from itertools import cycle

from drivers.camera.protocol import CameraCapabilities, Frame
from drivers.camera.replay import SAME, ReplayCamera
from drivers.simulation.world import World
from labrig.config import parse
from labrig.errors import RunError, SessionError
from labrig.models.plan import Shot
from labrig.models.rig import ReplayCameraConfig
from labrig.models.setup import CameraConfig, Setup
from labrig.patterns import digest
from labrig.session import Session

Seen = tuple[str | None, bool]  # the projector's picture, None if it is off; whether covered


def replay_camera(entry: ReplayCameraConfig, world: World) -> ReplayCamera:
    """Return a camera that sees what a session saw of the picture that a projector now shows.

    Frames of one picture and exposure come in the order they were taken, over and over.

    Raises
    ------
    SessionError
        If the session has no frames, or cannot be trusted.
    RunError
        If the rig's entry is about another camera than the session's.
    """
    session = Session.open(entry.session)
    shots = [Shot.model_validate(shot) for shot in session.header.get("shots", ())]
    taken = [shot for shot in shots if shot.id in session.frames]
    if not taken:
        msg = f"session {session.path.name!r} holds no frame that could be replayed."
        raise SessionError(msg)
    _refuse_other(entry, session, session.read(taken[0].id).shape)
    of_seen: dict[Seen, dict[float, list[str]]] = defaultdict(lambda: defaultdict(list))
    for shot in taken:
        of_seen[shot.pattern, shot.shutter == "covered"][shot.exposure_s].append(shot.id)
    turns = {seen: {e: cycle(ids) for e, ids in of.items()} for seen, of in of_seen.items()}

    def recall(exposure_s: float) -> Frame | None:
        image, covered = world.showing
        recorded = turns.get((None if image is None else digest(image), covered), {})
        for known_s, ids in recorded.items():
            if abs(known_s - exposure_s) <= SAME * known_s:
                return _frame(session, next(ids), world.clock.now_s())
        return None

    exposures_s = tuple(sorted({shot.exposure_s for shot in taken}))
    capabilities = CameraCapabilities(
        rows=entry.rows,
        cols=entry.cols,
        bits=entry.bits,
        white_level_dn=int(entry.white_level_dn),
        exposure_range_s=(exposures_s[0], exposures_s[-1]),
        readout_s=0.0,
        timestamp_source="none",
    )
    return ReplayCamera(recall, exposures_s, capabilities, world.clock, session.path.name)


def _refuse_other(entry: ReplayCameraConfig, session: Session, shape: tuple[int, ...]) -> None:
    setup = parse(session.header.get("setup"), Setup, source=f"{session.path}: setup")
    told = {name: getattr(entry, name) for name in (*CameraConfig.model_fields, "rows", "cols")}
    seen = {**setup.camera.model_dump(), "rows": shape[0], "cols": shape[1]}
    off = [name for name, value in told.items() if value != seen[name]]
    if off:
        name = off[0]
        msg = (
            f"the rig's camera.{name} is {told[name]}, that of session {session.path.name!r} "
            f"{seen[name]}; describe the camera that the session was captured with."
        )
        raise RunError(msg)


def _frame(session: Session, shot: str, now_s: float) -> Frame:
    pixels = session.read(shot)
    pixels.setflags(write=False)
    details = session.frames[shot].details
    return Frame(
        pixels=pixels,
        sequence=0,
        t_start_s=None,
        t_end_s=None,
        t_arrival_s=now_s,
        exposure_s=details.get("exposure_reported_s") or details.get("exposure_asked_s"),
        gain_db=details.get("gain_reported_db"),
        extras={"shot": shot},
    )
