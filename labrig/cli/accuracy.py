"""Commands that tell what accuracy is reached, and at what cost."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import labrig
from labrig.accuracy.costs import Costs, Run, write_csv
from labrig.accuracy.scene import cost_of_realism
from labrig.cli.say import AsJson, bars, out_console, say, say_json
from labrig.errors import RunError
from labrig.folders import config_folder

if TYPE_CHECKING:
    from labrig.accuracy.capture import CaptureCosts, Priced

app = typer.Typer(help="What accuracy is reached, and what it costs.", rich_markup_mode=None)
WITHIN = 1.3  # times its noise that a witness may differ: the noise itself is known to 18 %


@app.command()
def solver(
    scene: Annotated[Path, typer.Argument(help="Scene file.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("accuracy"),
    orders: Annotated[int, typer.Option(help="Bounces, three or more.", min=3, max=20)] = 5,
    as_json: AsJson = False,
) -> None:
    """Measure error and CPU seconds of every method and resolution on a scene."""
    from labrig.accuracy.solver import cost_of_accuracy  # noqa: PLC0415 - and the solver with it

    wanted = labrig.load_scene(scene)
    _make(out)
    with bars() as follow:
        costs = cost_of_accuracy(wanted, orders=orders, progress=follow)
    table, stem = out / "solver.csv", out / "solver"
    write_csv(costs, table)
    from labrig.reporting.drawing import save  # noqa: PLC0415 - matplotlib takes a second to load
    from labrig.reporting.figures import cost_figure  # noqa: PLC0415 - matplotlib takes a second to load

    save(cost_figure(costs), stem)
    if as_json:
        say_json(
            {
                **asdict(costs),
                "verdicts": [asdict(verdict) for verdict in costs.verdicts()],
                "csv": str(table),
                "figure": str(stem.with_suffix(".png")),
            }
        )
        return
    _say_runs([run for run in costs.runs if run.on_front or run.tolerance is not None])
    _say_truth(costs)
    for verdict in costs.verdicts():
        beside = "no setting tried meets it"
        if verdict.cheapest is not None:
            beside = (
                f"{verdict.ratio:.2f} times the cheapest that does ({verdict.cheapest.setting})"
            )
        say(f"tolerance {verdict.tolerance:g}: {verdict.outcome}; {beside}")
    for note in costs.notes:
        say(f"note: {note}")
    say(f"table   {table}")
    say(f"figure  {stem.with_suffix('.png')}")


@app.command()
def capture(
    plan: Annotated[Path, typer.Argument(help="Plan file.")],
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[Path, typer.Option(help="Scene file: what the sample may be.")],
    want: Annotated[
        list[str] | None, typer.Option(help="Wished uncertainty: sigma_t=0.5%, g=0.005, ...")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("accuracy"),
    as_json: AsJson = False,
) -> None:
    """Predict the uncertainty of a plan's answer, and what a better one would cost."""
    from labrig.accuracy import capture as accuracy_capture  # noqa: PLC0415 - and the solver with it

    wanted = dict(accuracy_capture.parse_wish(text) for text in want or [])
    with bars() as follow:
        costs = accuracy_capture.cost_of_capture(
            labrig.load_plan(plan),
            labrig.load_rig(rig),
            labrig.load_scene(scene),
            wanted,
            progress=follow,
        )
    _make(out)
    table, stem = out / "capture.csv", out / "capture"
    accuracy_capture.write_csv(costs, table)
    from labrig.reporting.drawing import save  # noqa: PLC0415 - matplotlib takes a second to load
    from labrig.reporting.figures_inversion import capture_cost_figure  # noqa: PLC0415

    save(capture_cost_figure(costs), stem)
    if as_json:
        plans = [_told(one) for one in costs.plans]
        cheapest = None if costs.cheapest is None else _told(costs.cheapest)
        files = {"csv": str(table), "figure": str(stem.with_suffix(".png"))}
        say_json({"plans": plans, "wanted": wanted, "cheapest": cheapest, **files})
        return
    _say_plans(costs)
    if wanted and costs.cheapest is None:
        say("no plan tried reaches what is wanted; combine repeats with longer exposures.")
    elif costs.cheapest is not None:
        best = costs.cheapest
        say(f"cheapest that reaches it: {best.kind}, {best.setting}, {best.seconds:.1f} s")
    say(f"table   {table}")
    say(f"figure  {stem.with_suffix('.png')}")


def _make(out: Path) -> None:
    """Make the folder to write to, before anything is measured."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = (
            f"{out}: no folder can be made ({error.strerror or error}); name another place with "
            "--out."
        )
        raise RunError(msg) from error


def _told(one: Priced) -> dict[str, object]:
    std = {name: v if math.isfinite(v) else None for name, v in one.std.items()}
    return {**asdict(one), "std": std}


def _say_plans(costs: CaptureCosts) -> None:
    table = Table(title="predicted standard deviations (camera noise)")
    for heading in ("plan", "setting", "seconds", "sigma_t", "sigma_s", "g"):
        table.add_column(heading, justify="left" if heading in {"plan", "setting"} else "right")
    for one in costs.plans:
        stds = ("—", "—", "—")
        if not one.reason:
            percent = [f"{100.0 * one.std[name]:.2g} %" for name in ("sigma_t", "sigma_s")]
            stds = (percent[0], percent[1], f"{one.std['g']:.2g}")
        table.add_row(one.kind, one.setting, f"{one.seconds:.1f}", *stds)
    out_console.print(table)
    for one in costs.plans:
        if one.reason:
            say(f"note: {one.kind}, {one.setting}: {one.reason}")


def _say_runs(runs: list[Run]) -> None:
    table = Table(title="the Pareto front, and the automatic choices")
    for heading in ("method", "setting", "CPU s", "error", "order", "stated"):
        table.add_column(heading, justify="left" if heading in ("method", "setting") else "right")
    for run in runs:
        stated = "" if run.stated is None else f"{run.stated:.2g}"
        numbers = f"{run.cpu_s:.3g}", f"{run.error:.2g}", f"{run.worst_order}", stated
        table.add_row(run.method, run.setting, *numbers)
    out_console.print(table)


def _say_truth(costs: Costs) -> None:
    say(f"truth: order 2 in closed form, the others extrapolated, to {costs.truth_error:.1g}")
    for one in costs.witnesses:
        agrees = one.difference <= WITHIN * one.noise
        verdict = "within its noise" if agrees else "MORE than its noise"
        say(
            f"order {one.order}: the Monte Carlo differs by {one.difference:.2g} rms, its noise is "
            f"{one.noise:.2g}: {verdict}"
        )


@app.command(name="scene")
def scene_(
    scene: Annotated[Path, typer.Argument(help="Scene file.")],
    plan: Annotated[Path, typer.Option(help="Plan file, whose patterns are shown.")],
    rig: Annotated[
        Path | None, typer.Option(help="Rig file; else the simulated rig that comes along.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("accuracy"),
    as_json: AsJson = False,
) -> None:
    """Measure a picture's error and CPU seconds as a scene's effects are added one by one."""
    wanted, shown = labrig.load_scene(scene), labrig.load_plan(plan)
    apparatus = labrig.load_rig(rig or config_folder() / "rigs" / "simulated.yaml")
    _make(out)
    with bars() as follow:
        realism = cost_of_realism(wanted, apparatus, shown, follow)
    stem = out / "scene"
    from labrig.reporting.drawing import save  # noqa: PLC0415 - matplotlib takes a second to load
    from labrig.reporting.figures_scene import realism_figure  # noqa: PLC0415

    save(realism_figure(realism), stem)
    if as_json:
        say_json({**asdict(realism), "figure": str(stem.with_suffix(".png"))})
        return
    table = Table(title=f"{realism.scene}, tolerance {realism.tolerance:g}")
    for heading in ("added", "CPU s", "and once", "error"):
        table.add_column(heading, justify="left" if heading == "added" else "right")
    for step in realism.steps:
        once = f"{step.transport_s:.3g}" if step.transport_s else ""
        table.add_row(step.name, f"{step.seconds:.3g}", once, f"{step.error:.2g}")
    out_console.print(table)
    say(f"left out: at most {realism.left_out:.2g}")
    say(f"figure  {stem.with_suffix('.png')}")
