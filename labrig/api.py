"""The functions of `labrig`, loaded when the first of them is asked for."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labrig import calibration_records as _calibration_records
from labrig import config as _config
from labrig import results as _results
from labrig import rig as _rig
from labrig import session as _session
from labrig.acquisition import capturing as _capturing
from labrig.folders import config_folder
from labrig.models.analysis import Analysis
from labrig.models.calibration import BoardFile, RecordFile
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.models.series import Concentrations
from labrig.results import Result
from labrig.rig import OpenRig
from labrig.session import Problem, Session
from labrig.session import importing as _importing

if TYPE_CHECKING:
    from labrig.pipeline import Until
    from labrig.solving import Cost, Solved, explain, write_solution
    from labrig.solving import solve_scene as solve
else:

    def __getattr__(name: str) -> Any:
        """Load the solver when it is asked for: single scattering alone has no need of it."""
        if name not in _SOLVING:
            msg = f"module 'labrig.api' has no attribute {name!r}"
            raise AttributeError(msg)
        from labrig import solving  # noqa: PLC0415

        return getattr(solving, _SOLVING[name])


__all__ = [
    "Analysis",
    "Cost",
    "OpenRig",
    "Plan",
    "Problem",
    "Result",
    "Rig",
    "Scene",
    "Session",
    "Solved",
    "analyse",
    "calibrate",
    "capture",
    "config_folder",
    "draw_board",
    "explain",
    "import_session",
    "load_analysis",
    "load_plan",
    "load_rig",
    "load_scene",
    "load_series",
    "open_rig",
    "read_calibration",
    "read_results",
    "reopen_rig",
    "report",
    "report_calibration",
    "resume",
    "reweight",
    "solve",
    "verify",
    "write_solution",
]

StrPath = str | PathLike[str]
Counted = Callable[[int, int], None]
_SOLVING = {"solve": "solve_scene"}
_SOLVING |= {name: name for name in ("Cost", "Solved", "explain", "write_solution")}


def load_plan(path: StrPath) -> Plan:
    """Read a capture plan; raise `labrig.errors.ConfigError` naming file and key."""
    return _config.load(Path(path), Plan)


def load_rig(path: StrPath) -> Rig:
    """Read a rig file; raise `labrig.errors.ConfigError` naming file and key."""
    return _config.load(Path(path), Rig)


def load_scene(path: StrPath) -> Scene:
    """Read a scene file; raise `labrig.errors.ConfigError` naming file and key."""
    return _config.load(Path(path), Scene)


def load_series(path: StrPath) -> Concentrations:
    """Read the concentrations of a series; raise `labrig.errors.ConfigError` if it is none."""
    return _config.load(Path(path), Concentrations)


def load_analysis(path: StrPath) -> Analysis:
    """Read an analysis file; raise `labrig.errors.ConfigError` naming file and key.

    Records it names are found relative to the file.
    """
    found = _config.load(Path(path), Analysis)
    beside = Path(path).resolve().parent
    named = {kind: str(beside / record) for kind, record in found.calibration.items()}
    return found.model_copy(update={"calibration": named})


def read_results(path: StrPath) -> Result:
    """Read a results folder, or the newest one of a session folder.

    Raises
    ------
    labrig.errors.SessionError
        If there are none, or they are damaged.
    """
    return _results.read_results(Path(path))


def verify(session: StrPath, *, progress: Counted | None = None) -> list[Problem]:
    """Check every file of a session; a whole session has no problems.

    Raises
    ------
    labrig.errors.SessionError
        If the folder is no session.
    """
    return _session.verify(Path(session), progress)


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
    latency = None if isinstance(rig, Rig) else _config.latency_beside(Path(rig))
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
    header = _session.Session.open(path).header
    kept, scene, latency = _capturing.rig_of(header, path)
    if rig is not None:
        kept, latency = load_rig(rig), _config.latency_beside(Path(rig))
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


def analyse(
    session: StrPath,
    config: Analysis | StrPath | None = None,
    *,
    until: Until = "results",
    out: StrPath | None = None,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Analyse a session; ``until="separation"`` for samples that are no scattering tank.

    Raises
    ------
    labrig.errors.LabrigError, analysis.errors.AnalysisError, calibration.errors.CalibrationError
        Where no trustworthy answer exists.
    """
    from labrig import pipeline  # noqa: PLC0415 - loads the solver

    if config is not None and not isinstance(config, Analysis):
        config = load_analysis(config)
    return pipeline.analyse(
        Path(session),
        config,
        until=until,
        out=None if out is None else Path(out),
        progress=progress,
    )


def calibrate(
    kind: str,
    session: StrPath,
    *,
    out: StrPath | None = None,
    dark: StrPath | None = None,
    board: StrPath | None = None,
) -> Path:
    """Make a calibration record of a session, with its page; return its folder beside the session.

    Parameters
    ----------
    kind : dark, flat, photon-transfer, response, geometry or projector
    dark : dark record for a flat; else the session's own dark frames
    board : board file for the geometry; else the board that `draw_board` draws by default

    Raises
    ------
    labrig.errors.LabrigError, calibration.errors.CalibrationError
        If the session does not hold what the kind needs, or nothing trustworthy comes of it.
    """
    from labrig.calibrating import run as calibration_run  # noqa: PLC0415 - loads OpenCV

    record = calibration_run.calibrate(
        kind,
        Path(session),
        out=None if out is None else Path(out),
        dark=None if dark is None else Path(dark),
        board=None if board is None else Path(board),
    )
    report_calibration(record)
    return record


def read_calibration(path: StrPath) -> RecordFile:
    """Read a calibration record; raise `labrig.errors.ConfigError` if it is none or damaged."""
    return _calibration_records.read_record(Path(path))[0]


def report_calibration(record: StrPath, out: StrPath | None = None) -> Path:
    """Write figures and a self-contained HTML page of a calibration record; return the page."""
    from labrig.calibrating.page import write_record_page  # noqa: PLC0415 - matplotlib takes a second

    return write_record_page(Path(record), None if out is None else Path(out))


def draw_board(out: StrPath, **sizes: float) -> tuple[Path, ...]:
    """Write a ChArUco board in true size: ``board.pdf``, ``board.png`` and ``board.yaml``.

    ``sizes`` are squares_x, squares_y, square_mm and marker_mm.

    Raises
    ------
    labrig.errors.LabrigError, calibration.errors.CalibrationError
        If the sizes make no board, or the place cannot be written.
    """
    from labrig.calibrating import board  # noqa: PLC0415 - loads OpenCV

    content = {"schema": "labrig-board/1", **sizes}
    return board.draw_board(Path(out), _config.parse(content, BoardFile, source="board"))


def reweight(result: Result, sigma_s_per_mm: float) -> Result:
    """Return a result's bounces as another scattering coefficient makes them (Eq. 11).

    Nothing is solved anew: sigma_t and g stay, ``fluence`` and ``light_field`` of bounce k are
    weighted by ``(sigma_s' / sigma_s)^(k-1)``.

    Raises
    ------
    labrig.errors.AnalysisRefusedError
        If the result holds no bounces.
    analysis.errors.AnalysisError
        If sigma_s is negative, or that of the result is not positive.
    """
    from labrig.reweighted import reweight as weighted  # noqa: PLC0415 - loads the analysis

    return weighted(result, sigma_s_per_mm)


def report(
    result: Result | StrPath,
    out: StrPath | None = None,
    *,
    beside: Result | StrPath | None = None,
) -> Path:
    """Write figures and a self-contained HTML report; return the path of the page.

    Parameters
    ----------
    result : a result, its folder, a session folder (its newest result), or a calibration record
    beside : a second result: the page holds both side by side, for beams that enter straight and
        aslant, two fillings, two exposures

    Raises
    ------
    labrig.errors.SessionError
        If there are no results, or they are damaged.
    """
    from labrig.reporting.beside_page import write_beside  # noqa: PLC0415 - matplotlib takes a second
    from labrig.reporting.report_page import write_report  # noqa: PLC0415 - to load

    place = None if out is None else Path(out)
    if not isinstance(result, Result) and _calibration_records.is_record(Path(result)):
        return report_calibration(result, out)
    found = result if isinstance(result, Result) else read_results(Path(result))
    if beside is None:
        return write_report(found, place, found.run.get("truth"))
    other = beside if isinstance(beside, Result) else read_results(Path(beside))
    return write_beside(found, other, place)
