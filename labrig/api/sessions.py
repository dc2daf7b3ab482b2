"""Sessions: taken by a rig, imported, checked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from labrig import rig as _rig
from labrig import session as _session
from labrig.acquisition import capturing as _capturing
from labrig.api.files import StrPath, load_rig, load_scene
from labrig.config import latency_beside
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.rig import OpenRig
from labrig.session import Problem, Session
from labrig.session import importing as _importing

__all__ = ["OpenRig", "Problem", "Session"]
__all__ += ["capture", "import_session", "open_rig", "reopen_rig", "resume", "verify"]

Counted = Callable[[int, int], None]


def open_rig(
    rig: Rig | StrPath,
    scene: Scene | StrPath | None,
    plan: Plan,
    *,
    progress: Counted | None = None,
) -> OpenRig:
    """Open the devices of a rig, ready for a plan; use it in a ``with`` block.

    A rig given as a file brings the latency record that lies beside it. A simulated rig looks at
    the scene; a real one needs none.
    ``progress(done, all)`` follows the Monte Carlo that makes a new scene's light.

    Raises
    ------
    labrig.errors.LabrigError, drivers.errors.DriverError
        If rig, scene and plan do not fit one another.
    """
    latency = None if isinstance(rig, Rig) else latency_beside(Path(rig))
    rig = rig if isinstance(rig, Rig) else load_rig(rig)
    scene = scene if scene is None or isinstance(scene, Scene) else load_scene(scene)
    return _rig.open_rig(rig, scene, plan, latency=latency, progress=progress)


def capture(plan: Plan, rig: OpenRig, out: StrPath, *, progress: Counted | None = None) -> Path:
    """Take every shot of a plan; return the sealed session folder made below ``out``.

    Raises
    ------
    labrig.errors.LabrigError, drivers.errors.DriverError
        The session then stays unsealed and keeps every frame taken.
    """
    return _capturing.capture(plan, rig, Path(out), progress=progress)


def reopen_rig(
    session: StrPath, rig: StrPath | None = None, *, progress: Counted | None = None
) -> OpenRig:
    """Open the rig that a session was begun with, ready for its plan; use it in a ``with`` block.

    Parameters
    ----------
    rig : rig file, where a port has another name now or the latency was measured anew;
        else the rig as the session keeps it

    Raises
    ------
    labrig.errors.LabrigError, drivers.errors.DriverError
        If the session cannot be trusted, or a device is not there.
    """
    path = Path(session)
    header = Session.open(path).header
    kept, scene, latency = _capturing.rig_of(header, path)
    if rig is not None:
        kept, latency = load_rig(rig), latency_beside(Path(rig))
    plan = _capturing.plan_of(header, path)
    return _rig.open_rig(kept, scene, plan, latency=latency, progress=progress)


def resume(
    session: StrPath, rig: StrPath | None = None, *, progress: Counted | None = None
) -> Path:
    """Take the shots that an interrupted session lacks; return its folder.

    ``rig`` is as in `reopen_rig`.

    Raises
    ------
    labrig.errors.LabrigError, drivers.errors.DriverError
        If the session cannot be trusted, is complete, or the rig is another one.
    """
    with reopen_rig(session, rig) as opened:
        return _capturing.resume(Path(session), opened, progress=progress)


def import_session(manifest: StrPath, out: StrPath, *, progress: Counted | None = None) -> Path:
    """Make a session of existing image files; return its folder made below ``out``.

    Raises
    ------
    labrig.errors.ConfigError
        If manifest or pictures are unfit; nothing is written then.
    """
    return _importing.import_session(Path(manifest), Path(out), progress=progress)


def verify(session: StrPath, *, progress: Counted | None = None) -> list[Problem]:
    """Check every file of a session; a whole session has no problems.

    Raises
    ------
    labrig.errors.SessionError
        If the folder is no session.
    """
    return _session.verify(Path(session), progress)
