"""From a scene's words to what the camera sees: the effects decided on, and nothing else."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drivers.simulation.lamp import Lamp
from drivers.simulation.sensor import Sensor
from labrig.models.plan import Plan
from labrig.models.rig import Rig, SimulatedCameraConfig
from labrig.models.scene import Scene
from labrig.scene.answer import Answer
from labrig.scene.decide import Decision, decide, situation_of
from labrig.scene.filled import layered
from labrig.scene.parts import Parts
from labrig.scene.picture import Picture

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """A scene made ready: its picture, what was decided, and what the transport took.

    ``transport_s`` are CPU seconds, of reading if the answer was kept.
    """

    picture: Picture
    decisions: tuple[Decision, ...]
    transport_s: float

    def summary(self) -> dict[str, Any]:
        """Return what a session says of its light."""
        answer, scene = self.picture.answer, self.picture.parts.scene
        return {
            "transport": "none" if answer is None else answer.method,
            "bounces": 1 if answer is None else answer.n_bounces,
            "tolerance": scene.tolerance,
            "used": [d.name for d in self.decisions if d.used],
            "left_out": {d.name: d.why for d in self.decisions if not d.used},
        }


def see(
    scene: Scene,
    rig: Rig,
    plan: Plan,
    *,
    force: tuple[str, ...] = (),
    progress: Progress | None = None,
) -> Seen:
    """Return what a rig's camera sees of a scene under the images of a plan.

    Raises
    ------
    labrig.errors.LabrigError, analysis.errors.AnalysisError
        If scene, rig and plan do not fit one another, or the light has no end.
    """
    scene = layered(scene, rig, plan)
    about = situation_of(scene, rig, plan)
    decisions = tuple(decide(about, force))
    parts = assemble(scene, rig, decisions)
    begun_s = time.process_time()
    answer = solve(parts, about.periods_px, progress)
    took_s = time.process_time() - begun_s
    picture = Picture(parts, answer, periods_px=about.periods_px)
    return Seen(picture=picture, decisions=decisions, transport_s=took_s)


def assemble(scene: Scene, rig: Rig, decisions: Sequence[Decision]) -> Parts:
    """Return the world made of the effects that are used; without any it is dark."""
    sensor = None
    if isinstance(rig.camera, SimulatedCameraConfig):
        sensor = counting(sensor_of(rig.camera))
    parts = Parts(scene=scene, rig=rig, sensor=sensor)
    for decision in decisions:
        if decision.used:
            parts = decision.effect.onto(parts)
    return parts


def solve(
    parts: Parts,
    periods_px: tuple[int, ...],
    progress: Progress | None = None,
    *,
    anew: bool = False,
) -> Answer | None:
    """Return the multiple scattering of a world; None, and nothing loaded, if it has none.

    ``anew`` computes it although it may be kept from before.
    """
    if not parts.multiple:
        return None
    from labrig.scene.transport import answer_of  # noqa: PLC0415 - only if there is any

    return answer_of(
        parts, periods_px, tolerance=parts.scene.tolerance, progress=progress, anew=anew
    )


def counting(sensor: Sensor) -> Sensor:
    """Return a sensor that counts electrons, and nothing else."""
    return replace(
        sensor,
        shot_noise=False,
        read_noise_e=0.0,
        quantised=False,
        saturates=False,
        hot_pixels=0,
        row_time_s=0.0,
        response="linear",
        blooming=0.0,
    )


def sensor_of(camera: SimulatedCameraConfig) -> Sensor:
    """Return the sensor of a simulated camera, with all that its entry says."""
    figures = camera.model_dump(include=set(Sensor.__dataclass_fields__))
    return Sensor(**figures, reports_exposure=camera.exposure_report == "per-frame")


def lamp_of(rig: Rig) -> Lamp:
    """Return the lamp of a rig."""
    return Lamp(**rig.simulation.lamp.model_dump())
