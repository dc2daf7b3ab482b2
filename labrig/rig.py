"""Opens the devices a rig file names, and closes them in reverse: light off first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera.protocol import Camera, CameraCapabilities, TriggerMode
from drivers.camera.simulated import SimulatedCamera
from drivers.projector.protocol import Image, PatternHandle, Projector, ProjectorCapabilities
from drivers.projector.simulated import SimulatedProjector
from drivers.simulation.clock import VirtualClock
from drivers.simulation.faults import Fault, FaultScript
from drivers.simulation.world import Light, World
from drivers.trigger.protocol import Trigger, TriggerSettings
from drivers.trigger.simulated import SimulatedTrigger
from drivers.trigger.software import SoftwareTrigger
from drivers.waiting import Clock, MonotonicClock
from labrig.errors import RunError
from labrig.models.devices import RealTriggerConfig
from labrig.models.latency import LatencyRecord
from labrig.models.plan import Plan
from labrig.models.rig import (
    ReplayCameraConfig,
    Rig,
    SimulatedCameraConfig,
    SimulatedProjectorConfig,
    SimulatedTriggerConfig,
    SoftwareTriggerConfig,
)
from labrig.models.scene import Scene
from labrig.real_devices import (
    RealWorld,
    ask_operator,
    make_camera,
    make_projector,
    make_trigger,
)
from labrig.replay import replay_camera
from labrig.scene.filled import layered, refuse_plan, tank_of
from labrig.scene.picture import Picture, Truth
from labrig.scene.pipeline import lamp_of, see, sensor_of
from labrig.session.disk import Disk
from labrig.session.simulated_disk import SimulatedDisk

TRIGGER_MODES: dict[str, TriggerMode] = {
    "software": "software",
    "simulated": "external",
    "serial": "external",
    "usb": "external",
    "plugin": "external",
    "free-run": "free-run",
}


@dataclass
class OpenRig:
    """A rig whose devices are open. A context manager: leaving it turns the light off."""

    config: Rig
    scene: Scene | None
    camera: Camera
    projector: Projector
    trigger: Trigger
    camera_can: CameraCapabilities
    projector_can: ProjectorCapabilities
    picture: Picture | None
    latency: LatencyRecord | None
    disk: Disk
    simulation: dict[str, Any] | None
    _world: World | RealWorld

    @property
    def simulated(self) -> bool:
        """Whether the devices are those of the simulated world."""
        return self.picture is not None

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
        if c.gain_dn_per_e is None or c.read_noise_e is None:
            msg = f"rig {self.config.name!r}: measure the camera's gain_dn_per_e and read_noise_e."
            raise RunError(msg)
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
        if self.picture is None:
            msg = f"rig {self.config.name!r} is real: what its light is made of is not known."
            raise RunError(msg)
        return self.picture.truth(self.picture.black_level)

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
        box = self.config.trigger
        if isinstance(box, RealTriggerConfig):
            wanted = TriggerSettings(pulse_s=box.pulse_s, delay_s=box.delay_s, source=box.source)
            self.trigger.configure(wanted)
        elif isinstance(box, SimulatedTriggerConfig):
            self.trigger.configure(TriggerSettings(pulse_s=box.pulse_s, delay_s=box.delay_s))
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
    scene: Scene | None,
    plan: Plan,
    *,
    latency: LatencyRecord | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> OpenRig:
    """Open a rig, ready for a plan.

    Parameters
    ----------
    scene : what a simulated rig looks at; a real one needs none, but takes tank and beam from it
    latency : the projector's latency as it was last measured; else the rig file's own numbers
    progress : follows the Monte Carlo, which runs the first time a scene is seen

    Raises
    ------
    RunError, PlanError, DriverError
        If scene, rig and plan do not fit one another.
    """
    if scene is None:
        refuse_plan(plan, rig, tank_of(rig))
    else:
        scene = layered(scene, rig, plan)
    if isinstance(rig.camera, ReplayCameraConfig):
        return _connect_replay(rig, rig.camera, scene, latency)
    if not isinstance(rig.camera, SimulatedCameraConfig):
        return _connect_real(rig, scene, latency)
    if scene is None:
        msg = f"rig {rig.name!r} is simulated and looks at a scene: give one with --scene."
        raise RunError(msg)
    seen = see(scene, rig, plan, progress=progress)
    return connect(rig, scene, seen.picture, latency, simulation=seen.summary())


def connect(
    rig: Rig,
    scene: Scene,
    picture: Picture,
    latency: LatencyRecord | None = None,
    *,
    simulation: dict[str, Any] | None = None,
) -> OpenRig:
    """Open the devices of a simulated rig that sees a picture.

    ``simulation`` says how the picture was made; without it lamp, leak and sensor are the rig's.
    """
    if not (
        isinstance(rig.camera, SimulatedCameraConfig)
        and isinstance(rig.projector, SimulatedProjectorConfig)
    ):
        msg = f"rig {rig.name!r} mixes simulated and real devices; they do not see one another."
        raise RunError(msg)
    world, sensor = _world(rig, rig.projector, picture.light), sensor_of(rig.camera)
    if simulation is not None:
        parts = picture.parts
        world.lamp, world.projector_black = parts.lamp, parts.black_level
        sensor = parts.sensor or sensor
    camera = SimulatedCamera(sensor, world, seed=rig.camera.seed)
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
    return replace(
        _opened(rig, scene, latency, (camera, projector, trigger), world),
        picture=picture,
        disk=SimulatedDisk(world.faults),
        simulation=simulation,
    )


def _connect_replay(
    rig: Rig, recorded: ReplayCameraConfig, scene: Scene | None, latency: LatencyRecord | None
) -> OpenRig:
    """Open a recording before a simulated projector."""
    if not isinstance(rig.projector, SimulatedProjectorConfig):
        msg = f"rig {rig.name!r}: a recording sees a simulated projector alone; name that one."
        raise RunError(msg)
    if not isinstance(rig.trigger, SoftwareTriggerConfig):
        msg = f"rig {rig.name!r}: a recording is triggered by software; leave the trigger out."
        raise RunError(msg)

    def unlit(image: NDArray[np.uint8] | None, black: float) -> NDArray[np.float64]:  # noqa: ARG001
        return np.zeros((recorded.rows, recorded.cols))

    world = _world(rig, rig.projector, unlit)
    camera = replay_camera(recorded, world)
    projector = SimulatedProjector(
        projector_capabilities(rig, latency),
        world,
        latency_s=rig.projector.latency_s,
        jitter_s=rig.projector.jitter_s,
        seed=0,
    )
    trigger = SoftwareTrigger(camera)
    return _opened(rig, scene, latency, (camera, projector, trigger), world)


def _connect_real(rig: Rig, scene: Scene | None, latency: LatencyRecord | None) -> OpenRig:
    """Open the real devices of a rig."""
    if isinstance(rig.camera, SimulatedCameraConfig | ReplayCameraConfig) or isinstance(
        rig.projector, SimulatedProjectorConfig
    ):
        msg = f"rig {rig.name!r} mixes simulated and real devices; they do not see one another."
        raise RunError(msg)
    world = RealWorld(ask_operator)
    camera, projector = make_camera(rig.camera), make_projector(rig.projector, latency)
    trigger: Trigger = SoftwareTrigger(camera)
    if isinstance(rig.trigger, RealTriggerConfig):
        trigger = make_trigger(rig.trigger)
    return _opened(rig, scene, latency, (camera, projector, trigger), world)


def _opened(
    rig: Rig,
    scene: Scene | None,
    latency: LatencyRecord | None,
    devices: tuple[Camera, Projector, Trigger],
    world: World | RealWorld,
) -> OpenRig:
    """Open all devices, or none: one that fails closes the others."""
    camera, projector, trigger = devices
    try:
        camera_can, projector_can = camera.open(), projector.open()
        trigger.open()
    except BaseException:
        for device in (projector, trigger, camera):
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
        picture=None,
        latency=latency,
        disk=Disk(),
        simulation=None,
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


def _world(rig: Rig, projector: SimulatedProjectorConfig, light: Light) -> World:
    simulation = rig.simulation
    return World(
        light=light,
        projector_black=rig.projector.black_level,
        clock=VirtualClock() if simulation.clock == "virtual" else MonotonicClock(),
        lamp=lamp_of(rig),
        fade_s=projector.fade_s,
        faults=FaultScript(Fault(**fault.model_dump()) for fault in simulation.faults),
    )
