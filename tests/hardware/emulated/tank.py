"""The light of a scattering tank for an emulated camera, from what the X server really shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulated.gige_camera import Scene
from emulated.x_server import FrameBuffer
from labrig.config import load
from labrig.models.plan import Plan
from labrig.models.rig import Rig, SimulatedCameraConfig
from labrig.models.scene import Scene as TankScene
from labrig.scene import pipeline


def describe(rig: Path, scene: Path, plan: Path, screen: Path, place: Any, cap: Path) -> str:
    """Return the argument of `tank_scene`; ``place`` is x, width, height of the output."""
    files = {"rig": rig, "scene": scene, "plan": plan, "screen": screen, "cap": cap}
    return json.dumps({**{key: str(path) for key, path in files.items()}, "place": place})


def sensor_of(rig: Rig) -> SimulatedCameraConfig:
    """Return the simulated camera that has the sensor of a rig's real one."""
    kept = set(SimulatedCameraConfig.model_fields) & set(type(rig.camera).model_fields) - {"driver"}
    told = {name: getattr(rig.camera, name) for name in kept}
    return SimulatedCameraConfig(driver="simulated", **told)


def tank_scene(argument: str) -> Scene:
    """Return what a camera sees of the tank, with the noise of its sensor."""
    told = json.loads(argument)
    rig, scene = load(Path(told["rig"]), Rig), load(Path(told["scene"]), TankScene)
    plan = load(Path(told["plan"]), Plan)
    picture = pipeline.see(scene, rig.model_copy(update={"camera": sensor_of(rig)}), plan).picture
    screen, cap = FrameBuffer(Path(told["screen"])), Path(told["cap"])
    x, width, height = told["place"]
    rng = np.random.default_rng(7)
    camera = rig.camera

    def see(exposure_s: float, rows: int, cols: int) -> NDArray[np.float64]:
        shown = screen.grab(x, width, height)
        assert (shown == shown[..., :1]).all(), "the projector shows colours"
        image = np.ascontiguousarray(shown[..., 0])
        light = picture.light(image, rig.projector.black_level) * exposure_s
        if cap.exists():
            light = np.zeros_like(light)
        electrons = rng.poisson(light) + camera.read_noise_e * rng.standard_normal(light.shape)
        counts = camera.black_level_dn + camera.gain_dn_per_e * electrons
        assert counts.shape == (rows, cols)
        return np.asarray(counts / camera.white_level_dn)

    return see
