"""Makes a camera of a recorded session, so that a run can be had again without its sample."""

from __future__ import annotations

from drivers.camera.protocol import CameraCapabilities, Frame
from drivers.camera.replay import ReplayCamera
from drivers.waiting import Clock
from labrig.config import parse
from labrig.errors import SessionError
from labrig.models.setup import Setup
from labrig.session import CommittedFrame, Session


def replay_camera(session: Session, clock: Clock) -> ReplayCamera:
    """Return a camera that gives out a session's frames in the order they were taken.

    Raises
    ------
    SessionError
        If the session has no frames, or one is not as it was committed.
    """
    taken = sorted(session.frames.values(), key=_number)
    if not taken:
        msg = f"session {session.path.name!r} holds no frame that could be replayed."
        raise SessionError(msg)
    setup = parse(session.header.get("setup"), Setup, source=f"{session.path}: setup")
    frames = [_frame(session, line) for line in taken]
    exposures = [frame.exposure_s for frame in frames if frame.exposure_s is not None]
    rows, cols = frames[0].pixels.shape
    return ReplayCamera(
        frames,
        CameraCapabilities(
            rows=rows,
            cols=cols,
            bits=setup.camera.bits,
            white_level_dn=int(setup.camera.white_level_dn),
            exposure_range_s=(min(exposures), max(exposures)),
            readout_s=0.0,
            timestamp_source="none",
        ),
        clock,
    )


def _number(line: CommittedFrame) -> int:
    return int(line.details["n"])


def _frame(session: Session, line: CommittedFrame) -> Frame:
    pixels = session.read(line.shot)
    pixels.setflags(write=False)
    d = line.details
    return Frame(
        pixels=pixels,
        sequence=int(d.get("sequence") or _number(line)),
        t_start_s=None,
        t_end_s=None,
        t_arrival_s=0.0,
        exposure_s=d.get("exposure_reported_s") or d.get("exposure_asked_s"),
        gain_db=d.get("gain_reported_db"),
        extras={"shot": line.shot},
    )
