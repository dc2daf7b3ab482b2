"""The command that measures a projector's latency."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import labrig
from labrig.acquisition.latency import N_FLIPS, measure_latency
from labrig.cli.say import AsJson, bars, one, say, say_json
from labrig.config import latency_file, save
from labrig.models.plan import Exposures, Plan, PlanSet, UniformPattern

_FLIPS = Plan(
    schema_="labrig-plan/1",
    name="latency",
    exposures=Exposures(bracket_s=(0.02,)),
    sets=(PlanSet(id="white", pattern=UniformPattern(kind="uniform")),),
)


def latency(
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[Path | None, typer.Option(help="Scene file, for a simulated rig.")] = None,
    flips: Annotated[int, typer.Option(min=10, help="Flips between black and white.")] = N_FLIPS,
    out: Annotated[Path | None, typer.Option("--out", help="Record; else beside the rig.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure when projected light has come and settled; kept beside the rig file."""
    with (
        bars() as follow,
        labrig.open_rig(rig, scene, _FLIPS, progress=one(follow, "light")) as opened,
    ):
        record = measure_latency(opened, flips=flips)
    file = out or latency_file(rig)
    save(file, record)
    if as_json:
        say_json({**record.model_dump(mode="json", by_alias=True), "file": str(file)})
        return
    bounds = f"{1e3 * record.earliest_s:.1f} .. {1e3 * record.latest_s:.1f} ms"
    say(f"light comes {bounds} after the request, jitter {1e3 * record.jitter_s:.2f} ms")
    say(f"and is steady {1e3 * record.settle_s:.1f} ms later; {record.flips} flips")
    say(str(file))
