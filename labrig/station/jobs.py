"""What the window lets its helper processes do: long in Python, and so out of the window's way."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import labrig
from labrig.config import parse
from labrig.errors import RunError
from labrig.models.scene import Scene
from labrig.reporting import views
from labrig.results import Result, read_results, value_of
from labrig.station.decomposition import decompose
from labrig.station.showing import bounces_of, sessions, show
from labrig.station.shown import Bounces, Listed, Price, Shown

__all__ = ["analyse", "decompose", "export", "listed", "page", "prices", "resolve", "shown", "warm"]

Tell = Callable[[str], None]
DEFAULT_KINDS = ("png", "pdf", "csv", "nc")


def warm() -> bool:
    """Load the solvers and matplotlib, so that the first figure need not wait for them."""
    from labrig.reporting import drawing  # noqa: PLC0415

    return bool(drawing.DPI)


def analyse(session: Path, *, tell: Tell) -> Shown:
    """Analyse a session; return what is shown of it."""
    return show(labrig.analyse(session, progress=tell).path)


def shown(path: Path) -> Shown:
    """Return what is shown of a result that stands."""
    return show(path)


def listed(root: Path) -> list[Listed]:
    """Return the sessions below a data root."""
    return sessions(root)


def prices(path: Path, *, tolerance: float) -> list[Price]:
    """Return what the bounces of a result's medium would take, looser and tighter ones beside."""
    found = []
    for cost in labrig.explain(_scene(read_results(path)), tolerance=tolerance):
        choice = cost.choice
        grid = choice.resolution
        found.append(
            Price(
                tolerance=choice.tolerance,
                engine=choice.engine,
                grid=str(grid),
                seconds=cost.seconds,
                gigabytes=choice.memory_bytes / 1e9,
            )
        )
    return found


def resolve(path: Path, *, tolerance: float) -> Bounces:
    """Solve the bounces of a result's medium anew to a tolerance: what the price was asked for."""
    result = read_results(path)
    scene = _scene(result)
    field = labrig.solve(scene, tolerance=tolerance).field
    scale, angle = views.scale_c(result), math.radians(scene.beam.angle_deg)
    rows = (scene.beam.from_mm, scene.beam.to_mm)
    x, y = field.grid.x_mm, field.grid.y_mm
    depth, curves = views.followed(field.fluence, x=x, y=y, rows=rows, angle_rad=angle)
    light = field.light_field
    if light is None:
        msg = "light keeps its direction in this medium: there is no light field to show."
        raise RunError(msg)
    medium = scene.medium
    return bounces_of(
        fluence=field.fluence,
        light_field=light.astype(np.float32),
        x=x,
        y=y,
        theta=field.grid.theta_rad,
        curves=(depth, scale * curves),
        scale_c=scale,
        medium=(medium.sigma_t_per_mm, medium.sigma_s_per_mm, medium.g),
        beam=(*rows, angle),
        error_estimate=field.error_estimate,
    )


def export(path: Path, out: Path, *, kinds: tuple[str, ...] = DEFAULT_KINDS) -> list[Path]:
    """Write figures (png, pdf), curves and numbers (csv), fields (nc) and the report; list them."""
    from labrig.reporting import drawing, figure_set  # noqa: PLC0415 - takes a second to load

    result = read_results(path)
    written: list[Path] = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        if {"png", "pdf"} & set(kinds):
            for name, figure in figure_set.all_figures(result).items():
                drawing.save(figure, out / name)
                for kind in ("png", "pdf"):
                    file = out / f"{name}.{kind}"
                    if kind in kinds:
                        written.append(file)
                    else:
                        file.unlink(missing_ok=True)
        if "csv" in kinds:
            written += _write_csv(result, out)
        if "nc" in kinds:
            written += [
                Path(shutil.copy2(result.path / name, out / name))
                for name in ("fields.nc", "run.json")
            ]
    except OSError as error:
        msg = f"{out}: cannot be written ({error.strerror or error}); choose another folder."
        raise RunError(msg) from error
    return written


def page(path: Path, out: Path) -> list[Path]:
    """Write the report as one page, with its figures."""
    return [labrig.report(path, out)]


def _write_csv(result: Result, out: Path) -> list[Path]:
    """Write the parameters, and every curve against depth."""
    unit = views.length_unit(result)
    parameters = out / "parameters.csv"
    with parameters.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["parameter", "value", "std", "unit"])
        for name in (f"sigma_t_per_{unit}", f"sigma_s_per_{unit}", "g", "scale_c"):
            if name in result.run:
                found = result.run[name]
                of = f"1/{unit}" if "_per_" in name else "counts/s" if name == "scale_c" else "1"
                writer.writerow([name, found["value"], found["std"], of])
    written = [parameters]
    tables = {
        f"{name}-profile": [
            f"{name}_depth",
            *(f"{name}_{w}" for w in ("profile", "profile_std", "profile_fit")),
        ]
        for name in ("single", "white")
        if f"{name}_depth" in result.fields
    }
    for stem, columns in tables.items():
        _table(out / f"{stem}.csv", columns, [result.fields[c].values for c in columns])
        written.append(out / f"{stem}.csv")
    if "fluence" in result.fields:
        depth, curves = views.along_beam(result)
        names = [f"depth_{unit}", *(f"bounce_{k}" for k in range(1, curves.shape[0] + 1))]
        _table(out / "bounces.csv", names, [depth, *curves])
        written.append(out / "bounces.csv")
    return written


def _table(path: Path, names: list[str], columns: list[Any]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(zip(*(np.asarray(c).tolist() for c in columns), strict=True))


def _scene(result: Result) -> Scene:
    """Return the medium that a result found, in the tank it was measured in."""
    run, unit = result.run, views.length_unit(result)
    setup = run.get("provenance", {}).get("setup", {})
    if unit != "mm" or not (setup.get("tank") and setup.get("beam")):
        msg = "without tank and beam in mm there is nothing to solve; give them in the rig file."
        raise RunError(msg)
    content = {
        "schema": "labrig-scene/1",
        "medium": {
            "sigma_t_per_mm": run["sigma_t_per_mm"]["value"],
            "sigma_s_per_mm": run["sigma_s_per_mm"]["value"],
            "g": value_of(run["g"]),
        },
        "tank": setup["tank"],
        "beam": setup["beam"],
    }
    return parse(content, Scene, source=str(result.path))
