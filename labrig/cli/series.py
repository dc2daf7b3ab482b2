"""The command that compares the sessions of a dilution series."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import labrig
from labrig.cli.say import AsJson, out_console, say, say_json
from labrig.results import read_results
from labrig.series import Line, fit_series, write_csv


def series(
    sessions: Annotated[list[Path], typer.Argument(help="Session or results folders.")],
    concentration: Annotated[
        Path, typer.Option(help="File with the concentration of every session.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("series"),
    as_json: AsJson = False,
) -> None:
    """Fit sigma_t, sigma_s and g of several sessions against their concentration."""
    found = fit_series([read_results(path) for path in sessions], labrig.load_series(concentration))
    out.mkdir(parents=True, exist_ok=True)
    table = out / "series.csv"
    write_csv(found, table)
    from labrig.figures import save  # noqa: PLC0415 - matplotlib takes a second to load
    from labrig.figures_inversion import series_figure  # noqa: PLC0415

    save(series_figure(found), out / "series")
    if as_json:
        say_json(
            {
                "sessions": list(found.sessions),
                "concentration": found.concentration.tolist(),
                "unit": found.concentration_unit,
                "lines": {line.name: _told(line) for line in found.lines},
                "notes": list(found.notes),
                "csv": str(table),
                "figure": str(out / "series.png"),
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
    out_console.print(shown)
    for note in found.notes:
        say(f"note: {note}")
    say(f"table   {table}")
    say(f"figure  {out / 'series.png'}")


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
