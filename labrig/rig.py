"""Opens the devices a rig file names, and closes them in reverse: light off first."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from drivers.camera.protocol import Camera, CameraCapabilities
from drivers.camera.simulated import Sensor, SimulatedCamera
from drivers.errors import DriverError
from drivers.projector.protocol import Projector, ProjectorCapabilities
from drivers.projector.simulated import SimulatedProjector
from drivers.simulation.world import World
from drivers.waiting import Clock
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import stripes_of
from labrig.scene.picture import Picture, Truth
from labrig.scene.response import tank_response


@dataclass
class OpenRig:
    """A rig whose devices are open. A context manager: leaving it turns the light off."""

    config: Rig
    scene: Scene
    camera: Camera
    projector: Projector
    camera_can: CameraCapabilities
    projector_can: ProjectorCapabilities
    picture: Picture
    _world: World

    def now_s(self) -> float:
        """Return the devices' monotonic time, s."""
        return self._world.clock.now_s()

    @property
    def clock(self) -> Clock:
        """The one clock of all devices."""
        return self._world.clock

    def cover(self, *, covered: bool) -> None:
        """Put the cap on the lens, or take it off: on a real rig this asks the operator."""
        self._world.covered = covered

    def truth(self) -> Truth:
        """Return what the simulated light is really made of."""
        return self.picture.truth(self.config.projector.black_level)

    def snapshot(self) -> dict[str, Any]:
        """Return identities and settings of all devices, read back."""
        return {
            "camera": {**self.camera.identity, "settings": self.camera.snapshot()},
            "projector": {**self.projector.identity, "settings": self.projector.snapshot()},
        }

    def close(self) -> None:
        """Turn the light off, then close everything; one failing device does not stop the rest."""
        for device in (self.projector, self.camera):
            with suppress(DriverError):
                device.close()

    def __enter__(self) -> OpenRig:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_rig(
    rig: Rig,
    scene: Scene,
    plan: Plan,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> OpenRig:
    """Open a simulated rig that looks at a scene, ready for a plan.

    ``progress`` follows the Monte Carlo, which runs the first time a scene is seen.

    Raises
    ------
    RunError, PlanError, DriverError
        If scene, rig and plan do not fit one another.
    """
    stripes = stripes_of(plan)
    response = tank_response(
        scene, period_mm=stripes.period_px * rig.projection.mm_per_px, progress=progress
    )
    picture = Picture(scene, rig, response, period_px=stripes.period_px)
    world = World(light=picture.light, projector_black=rig.projector.black_level)
    camera = SimulatedCamera(
        Sensor(
            rows=rig.camera.rows,
            cols=rig.camera.cols,
            bits=rig.camera.bits,
            black_level_dn=rig.camera.black_level_dn,
            white_level_dn=rig.camera.white_level_dn,
            gain_dn_per_e=rig.camera.gain_dn_per_e,
            read_noise_e=rig.camera.read_noise_e,
            readout_s=rig.camera.readout_s,
        ),
        world,
        seed=rig.camera.seed,
    )
    projector = SimulatedProjector(
        ProjectorCapabilities(
            rows=rig.projector.rows,
            cols=rig.projector.cols,
            refresh_hz=rig.projector.refresh_hz,
            latency_s=(
                rig.projector.latency_s,
                rig.projector.latency_s + 1.0 / rig.projector.refresh_hz,
            ),
            settle_s=rig.projector.settle_s,
            lamp_control=True,
        ),
        world,
        latency_s=rig.projector.latency_s,
    )
    return OpenRig(
        config=rig,
        scene=scene,
        camera=camera,
        projector=projector,
        camera_can=camera.open(),
        projector_can=projector.open(),
        picture=picture,
        _world=world,
    )
