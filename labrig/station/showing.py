"""From results on disk to what the window shows of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from labrig.reporting import views
from labrig.reporting.report_rows import parameter_rows, quality_rows, remarks
from labrig.results import Result, read_results, value_of
from labrig.session.catalogue import catalogue
from labrig.station.shown import Array, Bounces, Decay, Extent, Image, Listed, Row, Shown

SHOWN = 6  # bounces whose light says which part of the tank is worth a look


def show(path: Path) -> Shown:
    """Return what the window shows of a results folder, or of a session's newest one.

    Raises
    ------
    SessionError
        If there are no results, or they are damaged.
    """
    result = read_results(path)
    run, unit = result.run, views.length_unit(result)
    captured = views.picture(result, "captured")
    session = Path(str(run.get("session", {}).get("path", result.path)))
    has_white = "white_profile" in result.fields
    return Shown(
        path=result.path,
        session=session,
        title=session.name,
        unit=unit,
        rows=tuple(_rows(result, unit)),
        warnings=(*run.get("notes", ()), *remarks(run, unit)),
        quality=tuple(quality_rows(run.get("quality", {}), unit)),
        seconds={str(k): float(v) for k, v in run.get("seconds", {}).items()},
        captured=captured.values.astype(np.float32),
        single=_picture(result, "single"),
        multiple=_picture(result, "multiple"),
        extent=_extent(captured),
        decays=tuple(
            Decay(
                title=d.title,
                depth=d.depth,
                value=d.value,
                std=d.std,
                fit=d.fit,
                fitted=d.fitted,
                sigma_t=d.sigma_t,
                rms_relative=d.rms_relative,
            )
            for d in views.decays(result)
        ),
        white_depth=result.fields["white_depth"].values if has_white else np.empty(0),
        white=result.fields["white_profile"].values if has_white else np.empty(0),
        bounces=_bounces(result, unit) if "fluence" in result.fields else None,
    )


def sessions(root: Path) -> list[Listed]:
    """Return the sessions below a data root, newest first; none if there is no such folder."""
    if not root.is_dir():
        return []
    return [
        Listed(
            path=root / entry.path,
            name=entry.name,
            state=entry.state,
            saved=entry.saved,
            planned=entry.planned,
            created=entry.created,
            fitted=any((root / entry.path / "results").glob("*/run.json")),
        )
        for entry in reversed(catalogue(root))
    ]


def bounces_of(  # noqa: PLR0913 - the parts of a field have no common home but their result
    *,
    fluence: Array,
    light_field: Image,
    x: Array,
    y: Array,
    theta: Array,
    curves: tuple[Array, Array],
    scale_c: float,
    medium: tuple[float, float, float],
    beam: tuple[float, float, float],
    error_estimate: Array | None = None,
) -> Bounces:
    """Return bounces as shown; ``medium`` is sigma_t, sigma_s, g; ``beam`` from, to, angle."""
    picture = views.Picture(values=fluence[0], y=y, x=x, unit="")
    worth = [views.Picture(values=of, y=y, x=x, unit="") for of in fluence[:SHOWN]]
    lit = views.lit_part(worth, squarish=True)
    rows, cols = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    return Bounces(
        sigma_t=medium[0],
        sigma_s=medium[1],
        g=medium[2],
        depth=curves[0],
        curves=curves[1],
        x=x,
        y=y,
        extent=_extent(picture),
        pictures=(scale_c * fluence).astype(np.float32),
        theta=theta,
        light_field=light_field,
        beam_angle_rad=beam[2],
        beam_rows=(beam[0], beam[1]),
        lit=(int(rows[0]), int(rows[-1]), int(cols[0]), int(cols[-1])),
        error_estimate=error_estimate,
    )


def _bounces(result: Result, unit: str) -> Bounces:
    fields, about, run = result.fields, result.attributes, result.run
    return bounces_of(
        fluence=fields["fluence"].values,
        light_field=fields["light_field"].values,
        x=fields["x"].values,
        y=fields["y"].values,
        theta=fields["theta"].values,
        curves=views.along_beam(result),
        scale_c=views.scale_c(result),
        medium=(
            run[f"sigma_t_per_{unit}"]["value"],
            run[f"sigma_s_per_{unit}"]["value"],
            value_of(run["g"]),
        ),
        beam=(
            float(about["beam_from"]),
            float(about["beam_to"]),
            float(about.get("beam_angle_rad", math.nan)),
        ),
    )


def _rows(result: Result, unit: str) -> list[Row]:
    rows = []
    for p in parameter_rows(result.run, unit, result.run.get("truth", {})):
        name = p.name.split(",")[0]
        symbol = p.base + ({"t": "ₜ", "s": "ₛ", "a": "ₐ"}.get(p.index, p.index))
        rows.append(
            Row(
                name=f"{name} {symbol}",
                value=p.measured,
                unit=p.unit,
                truth=p.truth,
                off=p.deviation,
            )
        )
    return rows


def _picture(result: Result, name: str) -> Image:
    return np.asarray(views.picture(result, name).values, dtype=np.float32)


def _extent(picture: views.Picture) -> Extent:
    left, right, bottom, top = picture.extent
    return Extent(left=left, right=right, bottom=bottom, top=top)
