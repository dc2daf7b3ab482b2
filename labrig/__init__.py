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

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labrig.api import (
        Analysis,
        Cost,
        OpenRig,
        Plan,
        Problem,
        Result,
        Rig,
        Scene,
        Session,
        Solved,
        analyse,
        calibrate,
        capture,
        config_folder,
        draw_board,
        explain,
        import_session,
        load_analysis,
        load_plan,
        load_rig,
        load_scene,
        load_series,
        open_rig,
        read_calibration,
        read_results,
        reopen_rig,
        report,
        report_calibration,
        resume,
        reweight,
        solve,
        verify,
        write_solution,
    )

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


def __getattr__(name: str) -> Any:
    """Load the functions when one is asked for: the window must show before the solvers load."""
    if name in __all__:
        from labrig import api  # noqa: PLC0415 - that is the point

        return getattr(api, name)
    msg = f"module {__name__!r} has no attribute {name!r}"
    raise AttributeError(msg)
