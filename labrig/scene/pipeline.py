"""From a scene's words to what the camera sees."""

from __future__ import annotations

from collections.abc import Callable

from drivers.simulation.sensor import Sensor
from labrig.models.plan import Plan
from labrig.models.rig import Rig, SimulatedCameraConfig
from labrig.models.scene import Scene
from labrig.plan import kinds_of_stripes
from labrig.scene.parts import Parts
from labrig.scene.picture import Picture
from labrig.scene.transport import answer_of


def see(
    scene: Scene, rig: Rig, plan: Plan, *, progress: Callable[[int, int], None] | None = None
) -> Picture:
    """Return what a rig's camera sees of a scene under the images of a plan."""
    periods_px = tuple(stripes.period_px for stripes in kinds_of_stripes(plan))
    parts = Parts(
        scene=scene,
        rig=rig,
        sensor=sensor_of(rig.camera) if isinstance(rig.camera, SimulatedCameraConfig) else None,
        single=True,
        multiple=True,
        black_level=rig.projector.black_level,
        blur_px=rig.projection.blur_px,
        ambient_e_per_s=scene.light.ambient_e_per_s,
    )
    answer = answer_of(parts, periods_px, tolerance=5e-3, progress=progress)
    return Picture(parts, answer, periods_px=periods_px)


def sensor_of(camera: SimulatedCameraConfig) -> Sensor:
    """Return the sensor of a simulated camera."""
    figures = camera.model_dump(include=set(Sensor.__dataclass_fields__))
    return Sensor(**figures, reports_exposure=camera.exposure_report == "per-frame")
