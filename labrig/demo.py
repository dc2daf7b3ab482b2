"""The main job from end to end on the simulated rig, with the truth beside the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import labrig
from labrig.folders import config_folder

if TYPE_CHECKING:
    from labrig.scene.picture import Truth

Counted = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovered:
    """One parameter: what the scene was made with, and what the analysis found.

    ``plane`` is what a plane's model makes of a layer's light; None where a plane was the model.
    """

    truth: float
    value: float
    std: float | None
    plane: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """What a demonstration recovered, by the parameters' names in run.json, and where it lies.

    ``verification`` is the bounces' figure beside their truth, and how far each is off; None
    where that was not asked for.
    """

    parameters: dict[str, Recovered]
    session: Path
    report: Path
    verification: tuple[Path, dict[int, float]] | None = None


def run(
    out: Path,
    *,
    scene: Path | None = None,
    verify: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> Demo:
    """Capture a scene on the simulated rig, analyse it, and report it with its truth.

    Parameters
    ----------
    out : folder for session and report
    scene : scene file; else the paper's diluted milk in a layer of 5 mm
    verify : also draw each recovered bounce beside the one that the simulated light is made of
    progress : called with (what, done, all)
    """
    from labrig.models.analysis import STAGES  # noqa: PLC0415 - loads the solver

    folder = config_folder()
    milk = labrig.load_scene(scene or folder / "scenes" / "milk-in-a-layer.yaml")
    plan = labrig.load_plan(folder / "plans" / "six-shifts.yaml")

    def follow(what: str) -> Callable[[int, int], None]:
        return lambda done, total: progress(what, done, total) if progress else None

    with labrig.open_rig(
        folder / "rigs" / "simulated.yaml", milk, plan, progress=follow("light")
    ) as rig:
        session = labrig.capture(plan, rig, out, progress=follow("capture"))
        truth, gain_dn_per_e = (
            (rig.truth(), rig.config.camera.gain_dn_per_e) if verify else (None, None)
        )
    result = labrig.analyse(
        session,
        folder / "analyses" / "default.yaml",
        progress=lambda stage: follow("analyse")(STAGES.index(stage), len(STAGES)),
    )
    follow("analyse")(len(STAGES), len(STAGES))
    page = labrig.report(result)
    plane = result.run["alternatives"].get("flatland", {})
    parameters = {
        name: Recovered(
            truth=true,
            value=result.run[name]["value"],
            std=_whole_std(result.run[name]),
            plane=plane[name]["value"] if name in plane else None,
        )
        for name, true in result.run["truth"].items()
    }
    drawn = _verify(result, truth, gain_dn_per_e) if truth is not None else None
    return Demo(parameters=parameters, session=session, report=page, verification=drawn)


def _whole_std(found: Mapping[str, Any]) -> float | None:
    """Return what noise and model error together leave of a parameter."""
    if found["std"] is None:
        return None
    return math.hypot(float(found["std"]), float(found.get("model_std") or 0.0))


def _verify(
    result: labrig.Result, truth: Truth, gain_dn_per_e: float | None
) -> tuple[Path, dict[int, float]]:
    """Draw the bounces beside their truth; return the figure, and how far each is off."""
    from labrig.reporting.drawing import save  # noqa: PLC0415 - matplotlib takes a second to load
    from labrig.reporting.figures_orders import verification_figure  # noqa: PLC0415
    from labrig.verification import verify_bounces  # noqa: PLC0415

    found = verify_bounces(result, truth, gain_dn_per_e=gain_dn_per_e or 1.0)
    stem = result.path / "figures" / "verification"
    save(verification_figure(found), stem)
    return stem.with_suffix(".png"), {one.bounce: one.rms_relative for one in found.orders}
