"""A dilution series: how the medium's parameters follow the concentration."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from labrig.errors import AnalysisRefusedError
from labrig.models.series import Concentrations
from labrig.results import Result

Array = NDArray[np.float64]

DOUBTFUL = 0.01  # probability below which a straight line is called into question
FEWEST = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """``value = intercept + slope * concentration``, weighted by the stated uncertainties.

    Attributes
    ----------
    value, std : (n,), of each session; std holds noise and model error
    covariance : (2, 2) of (intercept, slope)
    chi2, p_straight : of the line; the probability that a straight line scatters as much
    bend, bend_std : coefficient of concentration^2 when one is fitted too; NaN below 4 sessions
    """

    name: str
    unit: str
    value: Array
    std: Array
    intercept: float
    slope: float
    covariance: Array
    chi2: float
    p_straight: float
    bend: float
    bend_std: float

    def at(self, concentration: Array) -> Array:
        """Return the line."""
        return np.asarray(self.intercept + self.slope * concentration)

    @property
    def straight(self) -> bool:
        """Whether nothing speaks against a straight line."""
        bent = math.isfinite(self.bend) and abs(self.bend) > 3.0 * self.bend_std
        return self.p_straight > DOUBTFUL or not bent


@dataclass(frozen=True, slots=True, kw_only=True)
class DilutionSeries:
    """Sessions by rising concentration, and the line of each parameter."""

    sessions: tuple[str, ...]
    concentration: Array
    concentration_unit: str
    lines: tuple[Line, ...]
    notes: tuple[str, ...]


def fit_series(results: Sequence[Result], known: Concentrations) -> DilutionSeries:
    """Fit sigma_t, sigma_s and g of several sessions against their concentration.

    Raises
    ------
    AnalysisRefusedError
        If there are fewer than three sessions or concentrations, one has none, or the lengths of
        some are in px.
    """
    if len(results) < FEWEST:
        msg = f"{len(results)} sessions: a line and a test of it need {FEWEST} or more."
        raise AnalysisRefusedError(msg)
    found = sorted(
        ((_concentration(result, known), result) for result in results), key=lambda pair: pair[0]
    )
    x = np.array([c for c, _ in found])
    ordered = [result for _, result in found]
    if np.unique(x).size < FEWEST:
        msg = f"{np.unique(x).size} different concentrations: {FEWEST} or more are needed."
        raise AnalysisRefusedError(msg)
    units = {str(r.run.get("length_unit")) for r in ordered}
    if len(units) > 1:
        msg = f"sessions with lengths in {' and '.join(sorted(units))} cannot be compared."
        raise AnalysisRefusedError(msg)
    unit = units.pop()
    lines = tuple(
        _line(name, of, x, ordered)
        for name, of in (
            (f"sigma_t_per_{unit}", f"1/{unit}"),
            (f"sigma_s_per_{unit}", f"1/{unit}"),
            ("g", "1"),
        )
    )
    notes = [
        f"{line.name} does not follow a straight line: chi^2 {line.chi2:.3g}, probability "
        f"{line.p_straight:.2g}, and a bend of {line.bend / line.bend_std:+.1f} std."
        for line in lines
        if not line.straight
    ]
    methods = {str(r.run.get("method", {}).get("parameters")) for r in ordered}
    if len(methods) > 1:
        notes.append("The sessions' parameters were found by different methods: see run.json.")
    return DilutionSeries(
        sessions=tuple(session_name(r) for r in ordered),
        concentration=x,
        concentration_unit=known.unit,
        lines=lines,
        notes=tuple(notes),
    )


def write_csv(series: DilutionSeries, path: Path) -> None:
    """Write a line a session."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        names = [part for line in series.lines for part in (line.name, f"{line.name}_std")]
        table.writerow(["session", f"concentration ({series.concentration_unit})", *names])
        for k, (session, c) in enumerate(zip(series.sessions, series.concentration, strict=True)):
            cells = [f"{v[k]:.6g}" for line in series.lines for v in (line.value, line.std)]
            table.writerow([session, f"{c:g}", *cells])


def _line(name: str, unit: str, x: Array, results: Sequence[Result]) -> Line:
    value, std = np.empty(x.size), np.empty(x.size)
    for k, result in enumerate(results):
        found = result.run.get(name)
        if not isinstance(found, Mapping):
            msg = f"{result.path}: holds no {name}; analyse the session to the end."
            raise AnalysisRefusedError(msg)
        if found["value"] is None:
            msg = f"{result.path}: does not determine {name}; leave this session out."
            raise AnalysisRefusedError(msg)
        parts = [float(found.get(key) or 0.0) for key in ("std", "model_std")]
        value[k], std[k] = float(found["value"]), math.hypot(*parts)
    if not (std > 0.0).all():
        std = np.ones_like(std)  # unknown: each counts as much, and no chi^2 can be told
    parameters, covariance, chi2 = _polynomial(x, value, std, 1)
    told = x.size > 2 and not np.all(std == 1.0)
    bend, bend_std = math.nan, math.nan
    if x.size > FEWEST:
        curve, spread, _ = _polynomial(x, value, std, 2)
        bend, bend_std = float(curve[2]), math.sqrt(spread[2, 2])
    return Line(
        name=name,
        unit=unit,
        value=value,
        std=std,
        intercept=float(parameters[0]),
        slope=float(parameters[1]),
        covariance=covariance,
        chi2=chi2,
        p_straight=float(chi2_distribution.sf(chi2, x.size - 2)) if told else math.nan,
        bend=bend,
        bend_std=bend_std,
    )


def _polynomial(x: Array, value: Array, std: Array, degree: int) -> tuple[Array, Array, float]:
    """Return coefficients from the constant on, their covariance, and chi^2."""
    matrix = np.vander(x, degree + 1, increasing=True) / std[:, None]
    covariance = np.asarray(np.linalg.inv(matrix.T @ matrix), dtype=np.float64)
    parameters = covariance @ matrix.T @ (value / std)
    rest = value / std - matrix @ parameters
    return parameters, covariance, float(rest @ rest)


def _concentration(result: Result, known: Concentrations) -> float:
    for name in _names(result):
        if name in known.concentration:
            return known.concentration[name]
    msg = (
        f"session {session_name(result)} has no concentration; name it by its folder, its id or, "
        f"if simulated, its scene ({', '.join(_names(result))})."
    )
    raise AnalysisRefusedError(msg)


def _names(result: Result) -> list[str]:
    session = result.run.get("session", {})
    folder = Path(str(session.get("path", ""))).name
    names = [folder, str(session.get("id", "")), str(session.get("scene", ""))]
    return list(dict.fromkeys(name for name in names if name))


def session_name(result: Result) -> str:
    """Return what a result's session is called."""
    return _names(result)[0] if _names(result) else result.path.name
