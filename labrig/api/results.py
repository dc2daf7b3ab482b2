"""Results: made of sessions, read, weighted anew, reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from labrig import results as _results
from labrig.api.calibrating import report_calibration
from labrig.api.files import StrPath, load_analysis
from labrig.calibration_records import is_record
from labrig.models.analysis import Analysis
from labrig.results import Result

if TYPE_CHECKING:
    from labrig.pipeline import Until

__all__ = ["Result", "analyse", "read_results", "report", "reweight"]


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


def read_results(path: StrPath) -> Result:
    """Read a results folder, or the newest one of a session folder.

    Raises
    ------
    labrig.errors.SessionError
        If there are none, or they are damaged.
    """
    return _results.read_results(Path(path))


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
    if not isinstance(result, Result) and is_record(Path(result)):
        return report_calibration(result, out)
    found = result if isinstance(result, Result) else read_results(Path(result))
    if beside is None:
        return write_report(found, place, found.run.get("truth"))
    other = beside if isinstance(beside, Result) else read_results(Path(beside))
    return write_beside(found, other, place)
