"""Simulate a scene: its pictures, their truth, and what its effects do."""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.errors import RunError
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.results import Field, write_fields
from labrig.scene.explain import Progress, Told, explain, lit, lit_images
from labrig.scene.pipeline import Seen, see

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """What a rig's camera sees of a scene.

    Attributes
    ----------
    light : (rows, cols) electrons/s by image: ``white``, and the first stripes of each period as
        ``stripes-12px``
    told : of each effect; empty if it was not asked for
    seconds : CPU, of the transport and of the pictures
    """

    scene: Scene
    seen: Seen
    light: dict[str, Array]
    told: tuple[Told, ...]
    seconds: float


def simulate(
    scene: Scene,
    rig: Rig,
    plan: Plan,
    *,
    force: tuple[str, ...] = (),
    explained: bool = False,
    progress: Progress | None = None,
) -> Simulation:
    """Return the lit pictures of a plan, one of each kind of pattern, without noise.

    Parameters
    ----------
    force : names of effects that are used although the tolerance could do without them
    explained : whether to measure what each effect does; it takes several times as long
    progress : called with (what, done, all) while light and effects are worked on

    Raises
    ------
    labrig.errors.LabrigError, analysis.errors.AnalysisError
        If scene, rig and plan do not fit one another.
    """
    begun_s = time.process_time()
    follow = progress or (lambda _what, _done, _total: None)
    seen = see(
        scene,
        rig,
        plan,
        force=force,
        progress=lambda done, total: follow("light", done, total),
    )
    light = lit(seen.picture, lit_images(plan, rig))
    took_s = time.process_time() - begun_s
    told = tuple(explain(scene, rig, plan, seen, follow)) if explained else ()
    return Simulation(scene=scene, seen=seen, light=light, told=told, seconds=took_s)


def told_as_json(found: Simulation) -> dict[str, Any]:
    """Return a simulation in words and numbers, for scripts."""
    effects = []
    told = {t.decision.name: t for t in found.told}
    for decision in found.seen.decisions:
        entry: dict[str, Any] = {
            "name": decision.name,
            "asked": decision.asked,
            "used": decision.used,
            "bound": decision.bound if np.isfinite(decision.bound) else None,
            "why": decision.why,
            "cost": decision.effect.cost,
        }
        if decision.name in told:
            one = told[decision.name]
            entry |= {"seconds": one.seconds, "rms_percent": one.rms_percent}
        effects.append(entry)
    summary = found.seen.summary()
    return {
        "scene": found.scene.name,
        "tolerance": found.scene.tolerance,
        "transport": summary["transport"],
        "bounces": summary["bounces"],
        "transport_seconds": found.seen.transport_s,
        "noise_percent": 100.0 * found.seen.picture.noise(),
        "seconds": found.seconds,
        "effects": effects,
    }


def write_simulation(path: Path, found: Simulation) -> None:
    """Write light and truth as NetCDF, beside its place first and renamed into it when complete.

    Raises
    ------
    RunError
        If the place cannot be written.
    """
    picture = found.seen.picture
    truth, rate = picture.truth(picture.black_level), "electrons/s"
    fields = {
        name.replace("-", "_"): Field(
            dims=("row", "col"), values=light, unit=rate, meaning=f"seen under {name}, no noise"
        )
        for name, light in found.light.items()
    }
    in_tank = ("tank_row", "tank_col")
    fields["single"] = Field(
        dims=in_tank, values=truth.single, unit=rate, meaning="single scattering under white"
    )
    fields["multiple"] = Field(
        dims=in_tank, values=truth.multiple, unit=rate, meaning="multiple scattering under white"
    )
    if truth.bounces.size:
        orders = np.arange(2, truth.bounces.shape[0] + 2)
        fields["bounce"] = Field(dims=("bounce",), values=orders, unit="1", meaning="order k")
        fields["y"] = Field(dims=("y",), values=truth.y_mm, unit="mm", meaning="along the face")
        fields["x"] = Field(dims=("x",), values=truth.x_mm, unit="mm", meaning="depth")
        fields["bounces"] = Field(
            dims=("bounce", "y", "x"), values=truth.bounces, unit=rate, meaning="I_k under white"
        )
    summary = found.seen.summary()
    attributes = {"scene": found.scene.name, "transport": summary["transport"]}
    part = path.with_name(f".{path.name}.{secrets.token_hex(2)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_fields(part, fields, attributes)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        msg = f"{path}: cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error
