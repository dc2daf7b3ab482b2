"""The command that says what a plan costs, and whether it could run."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

import labrig
from labrig.acquisition.estimate import Seconds, estimate
from labrig.acquisition.preflight import Verdict, check_all
from labrig.acquisition.probe import Probed, probe, resolve
from labrig.cli.say import AsJson, bars, one, out_console, say, say_json
from labrig.config import latency_beside
from labrig.exits import EXIT_BAD_INPUT
from labrig.plan import CapturePlan, expand


def check(
    plan: Annotated[Path, typer.Argument(help="Plan file.")],
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[
        Path | None, typer.Option(help="Scene file, to --probe a simulated rig.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    probing: Annotated[
        bool, typer.Option("--probe", help="Open the devices, take a test frame per bracket.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Say what a plan costs and whether it could run; the exit code is 2 if not."""
    wanted, config = labrig.load_plan(plan), labrig.load_rig(rig)
    probed: list[Probed] = []
    if probing:
        with (
            bars() as follow,
            labrig.open_rig(rig, scene, wanted, progress=one(follow, "light")) as opened,
        ):
            wanted = resolve(wanted, opened)
            bracket = wanted.exposures.bracket_s or ()
            probed = [probe(wanted, opened, exposure_s) for exposure_s in bracket]
    expanded = expand(wanted, config)
    latency = latency_beside(rig)
    verdicts = check_all(expanded, config, latency, out)
    cost = estimate(
        expanded, config, wait_s=None if latency is None else latency.latest_s + latency.settle_s
    )
    if as_json:
        say_json(
            {
                "plan_digest": expanded.digest,
                **asdict(cost),
                "total_s": cost.seconds.total,
                "bracket_s": sorted({shot.exposure_s for shot in expanded.shots}),
                "verdicts": [_verdict(v) for v in verdicts],
                "probe": [asdict(p) for p in probed],
            }
        )
    else:
        _print(expanded, cost.seconds, cost.other_order, cost.n_bytes, verdicts, probed)
    refused = any(not v.ok and v.fatal is not None for v in verdicts)
    return EXIT_BAD_INPUT if refused else 0


def _verdict(verdict: Verdict) -> dict[str, Any]:
    refuses = not verdict.ok and verdict.fatal is not None
    return {"name": verdict.name, "ok": verdict.ok, "refuses": refuses, "text": verdict.text}


def _print(
    expanded: CapturePlan,
    seconds: Seconds,
    other: Seconds,
    n_bytes: int,
    verdicts: list[Verdict],
    probed: list[Probed],
) -> None:
    groups = len({shot.group for shot in expanded.shots})
    say(f"{len(expanded.shots)} shots in {groups} groups, plan digest {expanded.digest[:16]}")
    outer = expanded.plan.order.outer
    table = Table()
    table.add_column("seconds for")
    for name in (str(outer), "pattern" if outer == "exposure" else "exposure"):
        table.add_column(f"{name} outermost", justify="right")
    rows = [*zip(asdict(seconds), asdict(seconds).values(), asdict(other).values(), strict=True)]
    for name, here, there in [*rows, ("all", seconds.total, other.total)]:
        table.add_row(name.replace("_", " "), f"{here:.1f}", f"{there:.1f}")
    out_console.print(table)
    say(f"{n_bytes / 1e6:.0f} MB")
    for p in probed:
        share = 100.0 * p.saturated_fraction
        say(f"probe {p.exposure_s:g} s: {p.bright_dn:.0f} DN, {share:.3g} % saturated")
    for verdict in verdicts:
        word = "ok" if verdict.ok else "refused" if verdict.fatal is not None else "note"
        say(f"{word:8}{verdict.text}")
