"""Rigs: devices, and where they look and shine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from drivers.simulation.faults import FaultKind
from labrig.models.base import Model, NonNegative, Positive
from labrig.models.devices import (
    GenicamCameraConfig,
    PluginCameraConfig,
    PluginProjectorConfig,
    PluginTriggerConfig,
    ScreenProjectorConfig,
    SerialTriggerConfig,
    UsbTriggerConfig,
    V4l2CameraConfig,
)
from labrig.models.setup import CameraConfig, GeometryConfig, LayerConfig, ProjectionConfig


class SimulatedCameraConfig(CameraConfig):
    """A camera of the simulated world."""

    driver: Literal["simulated"]
    rows: int = Field(960, ge=16, le=10000)
    cols: int = Field(1280, ge=16, le=10000)
    gain_dn_per_e: Positive
    read_noise_e: Positive
    readout_s: NonNegative = 0.02
    seed: int = 1
    queue_depth: int = Field(4, ge=1, le=1000)
    exposure_latency_frames: int = Field(0, ge=0, le=20, description="frames with the old exposure")
    row_time_s: NonNegative = Field(0.0, description="of a rolling shutter; 0 is a global one")
    timestamp_source: Literal["start", "end", "arrival", "none"] = "start"
    uncertainty_s: NonNegative = Field(0.0, description="of its time stamps")
    exposure_report: Literal["per-frame", "none"] = "per-frame"
    hot_pixels: int = Field(0, ge=0, le=1_000_000)
    hot_e_per_s: NonNegative = 0.0
    noise: Literal["exact", "quick"] = Field(
        "exact", description="quick: shot noise as a normal one, at a camera's rate"
    )


class ReplayCameraConfig(CameraConfig):
    """A recorded session as a camera, before a simulated projector; the camera was this one."""

    driver: Literal["replay"]
    session: Path = Field(description="its folder")
    rows: int = Field(ge=16, le=10000)
    cols: int = Field(ge=16, le=10000)
    readout_s: NonNegative = 0.0
    row_time_s: NonNegative = 0.0
    exposure_latency_frames: int = Field(0, ge=0, le=50)


class SimulatedProjectorConfig(Model):
    """A projector of the simulated world."""

    driver: Literal["simulated"]
    rows: int = Field(720, ge=1, le=10000)
    cols: int = Field(1280, ge=1, le=10000)
    refresh_hz: Positive = 60.0
    latency_s: NonNegative = 0.03
    jitter_s: NonNegative = Field(0.0, description="the latency's largest excess")
    settle_s: NonNegative = 0.02
    fade_s: NonNegative = Field(0.0, description="time constant of a change of light")
    black_level: float = Field(0.0, ge=0.0, lt=1.0, description="light of black, share of white")


class SoftwareTriggerConfig(Model):
    """The camera exposes on the computer's word."""

    driver: Literal["software"]


class NoTriggerConfig(Model):
    """The camera exposes by itself, without end; frames are told by their time stamps."""

    driver: Literal["free-run"]


class SimulatedTriggerConfig(Model):
    """A trigger box of the simulated world."""

    driver: Literal["simulated"]
    latency_s: NonNegative = 1e-4
    pulse_s: Positive = 1e-3
    delay_s: NonNegative = 0.0


TriggerConfig = Annotated[
    SoftwareTriggerConfig
    | NoTriggerConfig
    | SimulatedTriggerConfig
    | SerialTriggerConfig
    | UsbTriggerConfig
    | PluginTriggerConfig,
    Field(discriminator="driver"),
]


CameraEntry = Annotated[
    SimulatedCameraConfig
    | ReplayCameraConfig
    | V4l2CameraConfig
    | GenicamCameraConfig
    | PluginCameraConfig,
    Field(discriminator="driver"),
]
ProjectorEntry = Annotated[
    SimulatedProjectorConfig | ScreenProjectorConfig | PluginProjectorConfig,
    Field(discriminator="driver"),
]


class LampConfig(Model):
    """Brightness of the simulated projector over time, as shares of the nominal one."""

    cold_share: float = Field(0.0, ge=0.0, lt=1.0, description="missing when the lamp is lit")
    warmup_s: Positive = 60.0
    drift_per_h: float = Field(0.0, gt=-1.0, lt=1.0)
    flicker: float = Field(0.0, ge=0.0, lt=1.0)
    flicker_hz: Positive = 100.0


class FaultConfig(Model):
    """One scripted fault of the simulated world."""

    kind: FaultKind
    shot: str | None = Field(None, description="id of a shot; any if left out")
    step: str | None = Field(None, description="show, settle, configure, ...; any if left out")
    times: int = Field(1, ge=1)
    seconds: NonNegative = 0.0
    factor: Positive = 2.0


class SimulationConfig(Model):
    """The simulated world beside its devices."""

    clock: Literal["virtual", "real"] = "virtual"
    lamp: LampConfig = LampConfig()
    faults: tuple[FaultConfig, ...] = ()


class Rig(Model):
    """A rig: its devices, and where they look and shine."""

    schema_: Literal["labrig-rig/1"] = Field(alias="schema")
    name: str
    camera: CameraEntry
    projector: ProjectorEntry
    geometry: GeometryConfig
    projection: ProjectionConfig
    tank: LayerConfig | None = Field(
        None, description="how high the liquid stands, for scenes that do not say it"
    )
    trigger: TriggerConfig = SoftwareTriggerConfig(driver="software")
    simulation: SimulationConfig = SimulationConfig()
