"""A rig of 64 x 64 pixels that sees each projector column at once: whole runs in milliseconds."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from labrig.acquisition.capturing import prepare, prepare_resume
from labrig.acquisition.run_state import TAKES, Command, Event, State
from labrig.acquisition.runner import Finish, Runner
from labrig.config import parse
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.rig import OpenRig, connect
from labrig.session import Session

SIZE = 64
PEAK_E_PER_S = 60_000.0
RIG: dict[str, Any] = {
    "schema": "labrig-rig/1",
    "name": "toy",
    "camera": {
        "driver": "simulated",
        "rows": SIZE,
        "cols": SIZE,
        "bits": 12,
        "black_level_dn": 16,
        "white_level_dn": 4095,
        "gain_dn_per_e": 0.28,
        "read_noise_e": 10.9,
        "readout_s": 0.02,
    },
    "projector": {"driver": "simulated", "rows": 4, "cols": SIZE, "black_level": 0.01},
    "geometry": {"mm_per_px": 0.5, "region_px": [0, 0, SIZE, SIZE]},
    "projection": {"mm_per_px": 0.5, "origin_mm": 0.0},
}
PLAN: dict[str, Any] = {
    "schema": "labrig-plan/1",
    "name": "toy",
    "exposures": {"bracket_s": [0.05, 0.1]},
    "sets": [
        {"id": "stripes", "pattern": {"kind": "stripes", "period_px": 16, "shifts": 4}},
        {"id": "white", "pattern": {"kind": "uniform"}},
        {"id": "dark", "pattern": {"kind": "lamp-off"}, "shutter": "covered"},
    ],
}
SCENE = {
    "schema": "labrig-scene/1",
    "medium": {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.1, "g": 0.0},
    "tank": {"depth_mm": 32, "width_mm": 32},
    "beam": {"from_mm": 4, "to_mm": 28},
}


def light(image, black_level):
    """Electrons/s: every camera column sees its projector column, and 300 of ambient light."""
    seen = np.full((SIZE, SIZE), 300.0)
    if image is not None:
        level = black_level + (1.0 - black_level) * image[0] / 255.0
        seen = seen + PEAK_E_PER_S * level[None, :]
    return seen


def merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Return a mapping with changes laid over it, one level deep."""
    return {
        **base,
        **{
            key: {**base.get(key, {}), **value} if isinstance(value, dict) else value
            for key, value in changes.items()
        },
    }


def plan_of(**changes: Any) -> Plan:
    return parse(merged(PLAN, changes), Plan, source="plan")


def rig_of(*faults: dict[str, Any], **changes: Any) -> OpenRig:
    """Open the toy rig; faults are those of the rig file."""
    simulation = {**changes.pop("simulation", {}), "faults": list(faults)}
    config = parse(merged(RIG, {**changes, "simulation": simulation}), Rig, source="rig")
    scene = parse(SCENE, Scene, source="scene")
    return connect(config, scene, SimpleNamespace(light=light), changes.get("latency"))


def run(
    runner: Runner, *answers: Command, events: list[Event] | None = None
) -> tuple[Finish, Session | None]:
    """Run to the end; each pause is answered by the next command, then by abort."""
    left = list(answers)

    def hear(event: Event) -> None:
        if events is not None:
            events.append(event)
        if event.kind == "state" and event.status.state is State.PAUSED:
            answer = left.pop(0) if left else Command.ABORT
            runner.post(answer)
            if State.PAUSED not in TAKES[answer]:
                runner.post(Command.ABORT)

    runner.subscribe(hear)
    runner.post(Command.START)
    finish = runner.run()
    try:
        return finish, Session.open(runner.path)
    except AssertionError:
        return finish, None


def capture(
    out: Path, *faults: dict[str, Any], answers: tuple[Command, ...] = (), **changes: Any
) -> tuple[Finish, Session | None]:
    """Capture the toy plan with faults, and return how it ended."""
    plan = plan_of(**changes.pop("plan", {}))
    with rig_of(*faults, **changes) as rig:
        return run(prepare(plan, rig, out), *answers)


def resume(path: Path, *faults: dict[str, Any], **changes: Any) -> tuple[Finish, Session | None]:
    """Resume a toy session."""
    with rig_of(*faults, **changes) as rig:
        return run(prepare_resume(path, rig))


def pixels(session: Session) -> dict[str, np.ndarray]:
    """Return all frames of a session."""
    return {shot["id"]: session.read(shot["id"]) for shot in session.shots}


def read_all(path: Path) -> None:
    """Open a session and read every frame it claims to have."""
    session = Session.open(path)
    for shot in session.frames:
        session.read(shot)
