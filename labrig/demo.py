"""The main job from end to end on the simulated rig, with the truth beside the answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import labrig
from labrig.config import config_folder

Counted = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovered:
    """One parameter: what the scene was made with, and what the analysis found."""

    truth: float
    value: float
    std: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """What a demonstration recovered, by the parameters' names in run.json, and where it lies."""

    parameters: dict[str, Recovered]
    session: Path
    report: Path


def run(
    out: Path, *, scene: Path | None = None, progress: Callable[[str, int, int], None] | None = None
) -> Demo:
    """Capture a scene on the simulated rig, analyse it, and report it with its truth.

    Parameters
    ----------
    out : folder for session and report
    scene : scene file; else the paper's diluted milk
    progress : called with (what, done, all)
    """
    from labrig.models.analysis import STAGES  # noqa: PLC0415 - loads the solver

    folder = config_folder()
    milk = labrig.load_scene(scene or folder / "scenes" / "dilute-milk.yaml")
    plan = labrig.load_plan(folder / "plans" / "six-shifts.yaml")

    def follow(what: str) -> Callable[[int, int], None]:
        return lambda done, total: progress(what, done, total) if progress else None

    with labrig.open_rig(
        folder / "rigs" / "simulated.yaml", milk, plan, progress=follow("light")
    ) as rig:
        session = labrig.capture(plan, rig, out, progress=follow("capture"))
    result = labrig.analyse(
        session,
        folder / "analyses" / "default.yaml",
        progress=lambda stage: follow("analyse")(STAGES.index(stage), len(STAGES)),
    )
    follow("analyse")(len(STAGES), len(STAGES))
    page = labrig.report(result)
    parameters = {
        name: Recovered(truth=true, value=result.run[name]["value"], std=result.run[name]["std"])
        for name, true in result.run["truth"].items()
    }
    return Demo(parameters=parameters, session=session, report=page)
