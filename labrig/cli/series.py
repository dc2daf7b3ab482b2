"""The command that compares sessions: of a dilution series, or of one liquid at several heights."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.table import Table

import labrig
from labrig.cli.say import AsJson, out_console, say, say_json
from labrig.errors import AnalysisRefusedError
from labrig.fillings import Fillings, compare_fillings, write_fillings
from labrig.results import read_results
from labrig.series import DilutionSeries, Line, fit_series, write_csv


def series(
    sessions: Annotated[list[Path], typer.Argument(help="Session or results folders.")],
    concentration: Annotated[
        Path | None, typer.Option(help="File with the concentration of every session.")
    ] = None,
    heights: Annotated[
        bool, typer.Option("--heights", help="One liquid filled to different heights.")
    ] = False,
    height_std_mm: Annotated[
        float | None,
        typer.Option(help="How well all heights are known, mm; else what each session says."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("series"),
    as_json: AsJson = False,
) -> None:
    """Fit sigma_t, sigma_s and g of several sessions against concentration, or compare heights."""
    if heights == (concentration is not None):
        msg = "give either --concentration FILE, for dilutions, or --heights, for fillings."
        raise AnalysisRefusedError(msg)
    results = [read_results(path) for path in sessions]
    if concentration is None:
        _say_fillings(compare_fillings(results, height_std_mm=height_std_mm), out, as_json)
        return
    _say_dilutions(fit_series(results, labrig.load_series(concentration)), out, as_json)


def _say_dilutions(found: DilutionSeries, out: Path, as_json: bool) -> None:
    """Draw, write and print how the parameters follow the concentration."""
    from labrig.reporting.figures_inversion import series_figure  # noqa: PLC0415 - takes a second

    figure = series_figure(found)
    files = _keep(out, "series", lambda table: write_csv(found, table), figure)
    if as_json:
        say_json(
            {
                "sessions": list(found.sessions),
                "concentration": found.concentration.tolist(),
                "unit": found.concentration_unit,
                "lines": {line.name: _told(line) for line in found.lines},
                "notes": list(found.notes),
                **files,
            }
        )
        return
    shown = Table(title=f"against concentration in {found.concentration_unit}")
    for heading in ("parameter", "at zero", "slope", "chi^2", "P(straight)"):
        shown.add_column(heading, justify="left" if heading == "parameter" else "right")
    for line in found.lines:
        stds = [math.sqrt(line.covariance[k, k]) for k in range(2)]
        shown.add_row(
            line.name,
            f"{line.intercept:.4g} ± {stds[0]:.2g}",
            f"{line.slope:.4g} ± {stds[1]:.2g}",
            f"{line.chi2:.3g}",
            f"{line.p_straight:.2g}",
        )
    _say_all(shown, found.notes, files)


def _told(line: Line) -> dict[str, object]:
    finite = {
        name: value if math.isfinite(value) else None
        for name, value in (
            ("chi2", line.chi2),
            ("p_straight", line.p_straight),
            ("bend", line.bend),
            ("bend_std", line.bend_std),
        )
    }
    return {
        "value": line.value.tolist(),
        "std": line.std.tolist(),
        "intercept": line.intercept,
        "slope": line.slope,
        "covariance": line.covariance.tolist(),
        **finite,
        "straight": line.straight,
    }


def _say_fillings(found: Fillings, out: Path, as_json: bool) -> None:
    """Draw, write and print what fillings to different heights say."""
    from labrig.reporting.figures_slab import fillings_figure  # noqa: PLC0415 - takes a second

    files = _keep(
        out, "heights", lambda table: write_fillings(found, table), fillings_figure(found)
    )
    if as_json:
        say_json(
            {
                "sessions": list(found.sessions),
                "height_mm": found.height_mm.tolist(),
                "height_std_mm": found.height_std_mm.tolist(),
                "parameters": {
                    one.name: {
                        "layer": one.layer.tolist(),
                        "layer_std": one.layer_std.tolist(),
                        "plane": [v if math.isfinite(v) else None for v in one.plane],
                        "mean": one.mean,
                        "p_same": one.p_same,
                        "plane_ratio": one.plane_ratio if math.isfinite(one.plane_ratio) else None,
                    }
                    for one in found.found
                },
                "notes": list(found.notes),
                **files,
            }
        )
        return
    stds = ", ".join(f"{std:g}" for std in sorted(set(found.height_std_mm.tolist())))
    shown = Table(title=f"one liquid at different heights, known to {stds} mm")
    shown.add_column("parameter")
    for height in found.height_mm:
        shown.add_column(f"layer of {height:g} mm", justify="right")
    for height in found.height_mm:
        shown.add_column(f"plane, {height:g} mm", justify="right")
    for heading in ("P(same)", "plane's ratio"):
        shown.add_column(heading, justify="right")
    for one in found.found:
        shown.add_row(
            one.name,
            *(f"{v:.4g} ± {s:.1g}" for v, s in zip(one.layer, one.layer_std, strict=True)),
            *(f"{v:.4g}" if math.isfinite(v) else "—" for v in one.plane),
            f"{one.p_same:.2g}",
            f"{one.plane_ratio:.2f}" if math.isfinite(one.plane_ratio) else "—",
        )
    _say_all(shown, found.notes, files)


def _keep(
    out: Path, name: str, write: Callable[[Path], None], figure: Any
) -> dict[Literal["csv", "figure"], str]:
    """Write a table and its figure; return where they are."""
    from labrig.reporting.drawing import save  # noqa: PLC0415 - matplotlib takes a second to load

    out.mkdir(parents=True, exist_ok=True)
    write(out / f"{name}.csv")
    save(figure, out / name)
    return {"csv": str(out / f"{name}.csv"), "figure": str(out / f"{name}.png")}


def _say_all(
    shown: Table, notes: tuple[str, ...], files: dict[Literal["csv", "figure"], str]
) -> None:
    out_console.print(shown)
    for note in notes:
        say(f"note: {note}")
    say(f"table   {files['csv']}")
    say(f"figure  {files['figure']}")
