"""Opens the devices a rig file names, and closes them in reverse: light off first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera.protocol import Camera, CameraCapabilities, TriggerMode
from drivers.camera.simulated import Sensor, SimulatedCamera
from drivers.errors import DriverError
from drivers.projector.protocol import Image, PatternHandle, Projector, ProjectorCapabilities
from drivers.projector.simulated import SimulatedProjector
from drivers.simulation.clock import VirtualClock
from drivers.simulation.faults import Fault, FaultScript
from drivers.simulation.lamp import Lamp
from drivers.simulation.world import World
from drivers.trigger.protocol import Trigger, TriggerSettings
from drivers.trigger.simulated import SimulatedTrigger
from drivers.trigger.software import SoftwareTrigger
from drivers.waiting import Clock, MonotonicClock
from labrig.disk import Disk
from labrig.errors import RunError
from labrig.models.latency import LatencyRecord
from labrig.models.plan import Plan
from labrig.models.rig import Rig, SimulatedTriggerConfig
from labrig.models.scene import Scene
from labrig.plan import stripes_of
from labrig.scene.picture import Picture, Truth
from labrig.scene.response import tank_response
from labrig.simulated_disk import SimulatedDisk

TRIGGER_MODES: dict[str, TriggerMode] = {
    "software": "software",
    "simulated": "external",
    "free-run": "free-run",
}


@dataclass
class OpenRig:
    """A rig whose devices are open. A context manager: leaving it turns the light off."""

    config: Rig
    scene: Scene
    camera: Camera
    projector: Projector
    trigger: Trigger
    camera_can: CameraCapabilities
    projector_can: ProjectorCapabilities
    picture: Picture
    latency: LatencyRecord | None
    disk: Disk
    _world: World

    @property
    def clock(self) -> Clock:
        """The one clock of all devices."""
        return self._world.clock

    @property
    def trigger_mode(self) -> TriggerMode:
        """How the camera is made to expose."""
        return TRIGGER_MODES[self.config.trigger.driver]

    @property
    def black_level_dn(self) -> float:
        """Counts of the camera without light."""
        return self.config.camera.black_level_dn

    def variance_dn2(self, counts_dn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the variance of counts by the camera's gain and read noise, DN^2."""
        c = self.config.camera
        light_dn = np.maximum(counts_dn - c.black_level_dn, 0.0)
        noise_dn2 = (c.gain_dn_per_e * c.read_noise_e) ** 2 + 1.0 / 12.0
        return np.asarray(c.gain_dn_per_e * light_dn + noise_dn2)

    def now_s(self) -> float:
        """Return the devices' monotonic time, s."""
        return self._world.clock.now_s()

    def cover(self, *, covered: bool) -> None:
        """Put the cap on the lens, or take it off: on a real rig this asks the operator."""
        if self._world.covered != covered:
            self._world.covered = covered

    def notice(self, shot: str, step: str) -> None:
        """Let the simulated world know what is being done; real devices need not."""
        self._world.faults.notice(shot, step)

    def truth(self) -> Truth:
        """Return what the simulated light is really made of."""
        return self.picture.truth(self.config.projector.black_level)

    def snapshot(self) -> dict[str, Any]:
        """Return identities and settings of all devices, read back."""
        devices: dict[str, Camera | Projector | Trigger] = {
            "camera": self.camera,
            "projector": self.projector,
            "trigger": self.trigger,
        }
        return {
            name: {**device.identity, "settings": device.snapshot()}
            for name, device in devices.items()
        }

    def arm(self, images: list[Image]) -> tuple[PatternHandle, ...]:
        """Load the patterns, set the trigger, arm the camera."""
        handles = self.projector.load(images)
        if isinstance(self.config.trigger, SimulatedTriggerConfig):
            wanted = TriggerSettings(
                pulse_s=self.config.trigger.pulse_s, delay_s=self.config.trigger.delay_s
            )
            self.trigger.configure(wanted)
        self.camera.arm(self.trigger_mode)
        return handles

    def reopen(self) -> None:
        """Close and open every device again; each must be the one it was.

        Raises
        ------
        DriverError, RunError
            If one does not come back, or another one came.
        """
        before = [d.identity for d in (self.camera, self.projector, self.trigger)]
        self.close()
        self.camera_can = self.camera.open()
        self.projector_can = self.projector.open()
        self.trigger.open()
        after = [d.identity for d in (self.camera, self.projector, self.trigger)]
        for old, new in zip(before, after, strict=True):
            if old != new:
                msg = f"{old} was lost and {new} came back; connect the device that was there."
                raise RunError(msg)

    def close(self) -> None:
        """Turn the light off, then close everything; closing never raises."""
        for device in (self.projector, self.trigger, self.camera):
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
    latency: LatencyRecord | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> OpenRig:
    """Open a simulated rig that looks at a scene, ready for a plan.

    Parameters
    ----------
    latency : the projector's latency as it was last measured; else the rig file's own numbers
    progress : follows the Monte Carlo, which runs the first time a scene is seen

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
    return connect(rig, scene, picture, latency)


def connect(
    rig: Rig, scene: Scene, picture: Picture, latency: LatencyRecord | None = None
) -> OpenRig:
    """Open the devices of a simulated rig that sees a picture."""
    world = _world(rig, picture)
    camera = SimulatedCamera(_sensor(rig), world, seed=rig.camera.seed)
    projector = SimulatedProjector(
        projector_capabilities(rig, latency),
        world,
        latency_s=rig.projector.latency_s,
        jitter_s=rig.projector.jitter_s,
        seed=rig.camera.seed,
    )
    trigger: Trigger = SoftwareTrigger(camera)
    if isinstance(rig.trigger, SimulatedTriggerConfig):
        trigger = SimulatedTrigger(world, latency_s=rig.trigger.latency_s)
    devices = (projector, trigger, camera)
    try:
        camera_can, projector_can = camera.open(), projector.open()
        trigger.open()
    except DriverError:
        for device in devices:
            device.close()
        raise
    return OpenRig(
        config=rig,
        scene=scene,
        camera=camera,
        projector=projector,
        trigger=trigger,
        camera_can=camera_can,
        projector_can=projector_can,
        picture=picture,
        latency=latency,
        disk=SimulatedDisk(world.faults),
        _world=world,
    )


def projector_capabilities(rig: Rig, latency: LatencyRecord | None) -> ProjectorCapabilities:
    """Return what the projector can do: its latency as measured, else as the rig file says."""
    p = rig.projector
    period_s = 1.0 / p.refresh_hz
    bounds, settle_s = (p.latency_s, p.latency_s + p.jitter_s + period_s), p.settle_s
    if latency is not None:
        bounds, settle_s = (latency.earliest_s, latency.latest_s), latency.settle_s
    return ProjectorCapabilities(
        rows=p.rows,
        cols=p.cols,
        refresh_hz=p.refresh_hz,
        latency_s=bounds,
        settle_s=settle_s,
        calibrated=None if latency is None else latency.date,
        lamp_control=True,
    )


def _world(rig: Rig, picture: Picture) -> World:
    simulation = rig.simulation
    return World(
        light=picture.light,
        projector_black=rig.projector.black_level,
        clock=VirtualClock() if simulation.clock == "virtual" else MonotonicClock(),
        lamp=Lamp(**simulation.lamp.model_dump()),
        fade_s=rig.projector.fade_s,
        faults=FaultScript(Fault(**fault.model_dump()) for fault in simulation.faults),
    )


def _sensor(rig: Rig) -> Sensor:
    c = rig.camera
    figures = c.model_dump(include=set(Sensor.__dataclass_fields__))
    return Sensor(**figures, reports_exposure=c.exposure_report == "per-frame")
