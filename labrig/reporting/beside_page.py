"""Writes two results side by side, as of a beam that enters straight and one aslant (Fig. 14)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.errors import RunError
from labrig.reporting import views
from labrig.reporting.figure_set import all_figures
from labrig.reporting.page import Plate, plates, templates, write_page
from labrig.reporting.report_page import CAPTIONS, headline
from labrig.reporting.report_rows import parameter_rows
from labrig.results import Result


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A parameter of both, as text, and how far apart they are."""

    name: str
    base: str
    index: str
    unit: str
    both: list[str]
    apart: str


def write_beside(first: Result, second: Result, out: Path | None = None) -> Path:
    """Write ``beside.html`` with the parameters and every figure of both; return the page.

    Parameters
    ----------
    out : folder to write into; else the first result's own

    Raises
    ------
    RunError
        If the two are in different units of length, or the place cannot be written.
    """
    both = (first, second)
    units = [views.length_unit(result) for result in both]
    if units[0] != units[1]:
        msg = (
            f"{first.path} is in {units[0]}, {second.path} in {units[1]}: give both sessions a "
            "geometry record, and analyse them again."
        )
        raise RunError(msg)

    def page(files: Path) -> str:
        drawn = [
            {plate.name: plate for plate in plates(all_figures(result), CAPTIONS, files, suffix)}
            for result, suffix in zip(both, ("-1", "-2"), strict=True)
        ]
        return _render(both, drawn, units[0])

    return write_page(out or first.path, "beside.html", page)


def _render(both: tuple[Result, Result], drawn: list[dict[str, Plate]], unit: str) -> str:
    return (
        templates()
        .get_template("beside.html")
        .render(
            heads=[_head(result) for result in both],
            unit=unit,
            rows=_rows(both, unit),
            figures=[
                (*CAPTIONS[name], [of.get(name) for of in drawn])
                for name in CAPTIONS
                if any(name in of for of in drawn)
            ],
            notes=[list(result.run.get("notes", [])) for result in both],
        )
    )


def _head(result: Result) -> dict[str, Any]:
    slant = result.attributes.get("beam_angle_rad")
    beam = "" if slant is None else f"beam at {math.degrees(slant):.3g}°"
    return {**headline(result.run), "beam": beam}


def _rows(both: tuple[Result, Result], unit: str) -> list[Row]:
    tables = [{row.key: row for row in parameter_rows(r.run, unit, {})} for r in both]
    return [
        Row(
            name=row.name,
            base=row.base,
            index=row.index,
            unit=row.unit,
            both=[table[key].measured if key in table else views.UNKNOWN for table in tables],
            apart=_apart(both, key),
        )
        for key, row in {**tables[0], **tables[1]}.items()
    ]


def _apart(both: tuple[Result, Result], key: str) -> str:
    """Return the difference of a parameter, and how many std of it that is."""
    one, other = (result.run.get(key) for result in both)
    if one is None or other is None or one["value"] is None or other["value"] is None:
        return views.UNKNOWN
    stds = [found.get(of) for found in (one, other) for of in ("std", "model_std")]
    std = math.hypot(*[s for s in stds if s is not None])
    change = other["value"] - one["value"]
    times = f", {abs(change) / std:.1f} std" if std > 0.0 else ""
    return f"{change:+.2g}{times}".replace("-", "−")
