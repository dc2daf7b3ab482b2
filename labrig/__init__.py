"""Measure how light travels in scattering media.

Everything the command line does is one call of this module:

>>> import labrig
>>> plan = labrig.load_plan("configs/plans/six-shifts.yaml")
>>> with labrig.open_rig(
...     "configs/rigs/simulated.yaml", "configs/scenes/dilute-milk.yaml", plan
... ) as rig:
...     session = labrig.capture(plan, rig, "sessions")  # doctest: +SKIP
>>> result = labrig.analyse(session)  # doctest: +SKIP
>>> page = labrig.report(result)  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrig.api.calibrating import calibrate as calibrate
    from labrig.api.calibrating import draw_board as draw_board
    from labrig.api.calibrating import read_calibration as read_calibration
    from labrig.api.calibrating import report_calibration as report_calibration
    from labrig.api.files import Analysis as Analysis
    from labrig.api.files import Plan as Plan
    from labrig.api.files import Rig as Rig
    from labrig.api.files import Scene as Scene
    from labrig.api.files import config_folder as config_folder
    from labrig.api.files import load_analysis as load_analysis
    from labrig.api.files import load_plan as load_plan
    from labrig.api.files import load_rig as load_rig
    from labrig.api.files import load_scene as load_scene
    from labrig.api.files import load_series as load_series
    from labrig.api.results import Result as Result
    from labrig.api.results import analyse as analyse
    from labrig.api.results import read_results as read_results
    from labrig.api.results import report as report
    from labrig.api.results import reweight as reweight
    from labrig.api.sessions import OpenRig as OpenRig
    from labrig.api.sessions import Problem as Problem
    from labrig.api.sessions import Session as Session
    from labrig.api.sessions import capture as capture
    from labrig.api.sessions import import_session as import_session
    from labrig.api.sessions import open_rig as open_rig
    from labrig.api.sessions import reopen_rig as reopen_rig
    from labrig.api.sessions import resume as resume
    from labrig.api.sessions import verify as verify
    from labrig.api.solving import Cost as Cost
    from labrig.api.solving import Solved as Solved
    from labrig.api.solving import explain as explain
    from labrig.api.solving import solve as solve
    from labrig.api.solving import write_solution as write_solution

_STANDS_IN = {
    "Analysis": "files",
    "Cost": "solving",
    "OpenRig": "sessions",
    "Plan": "files",
    "Problem": "sessions",
    "Result": "results",
    "Rig": "files",
    "Scene": "files",
    "Session": "sessions",
    "Solved": "solving",
    "analyse": "results",
    "calibrate": "calibrating",
    "capture": "sessions",
    "config_folder": "files",
    "draw_board": "calibrating",
    "explain": "solving",
    "import_session": "sessions",
    "load_analysis": "files",
    "load_plan": "files",
    "load_rig": "files",
    "load_scene": "files",
    "load_series": "files",
    "open_rig": "sessions",
    "read_calibration": "calibrating",
    "read_results": "results",
    "reopen_rig": "sessions",
    "report": "results",
    "report_calibration": "calibrating",
    "resume": "sessions",
    "reweight": "results",
    "solve": "solving",
    "verify": "sessions",
    "write_solution": "solving",
}
__all__ = list(_STANDS_IN)


def __getattr__(name: str) -> Any:
    """Load a function when it is asked for: nobody waits for devices he has no use of."""
    if name in _STANDS_IN:
        return getattr(import_module(f"labrig.api.{_STANDS_IN[name]}"), name)
    msg = f"module {__name__!r} has no attribute {name!r}"
    raise AttributeError(msg)
