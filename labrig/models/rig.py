"""Rigs: devices, and where they look and shine."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from labrig.models.base import Model, NonNegative, Positive
from labrig.models.setup import CameraConfig, GeometryConfig, ProjectionConfig


class SimulatedCameraConfig(CameraConfig):
    """A camera of the simulated world."""

    driver: Literal["simulated"]
    rows: int = Field(960, ge=16, le=10000)
    cols: int = Field(1280, ge=16, le=10000)
    gain_dn_per_e: Positive
    read_noise_e: Positive
    readout_s: NonNegative = 0.02
    seed: int = 1


class SimulatedProjectorConfig(Model):
    """A projector of the simulated world."""

    driver: Literal["simulated"]
    rows: int = Field(720, ge=1, le=10000)
    cols: int = Field(1280, ge=1, le=10000)
    refresh_hz: Positive = 60.0
    latency_s: NonNegative = 0.03
    settle_s: NonNegative = 0.02
    black_level: float = Field(0.0, ge=0.0, lt=1.0, description="light of black, share of white")


class Rig(Model):
    """A rig: its devices, and where they look and shine."""

    schema_: Literal["labrig-rig/1"] = Field(alias="schema")
    name: str
    camera: SimulatedCameraConfig
    projector: SimulatedProjectorConfig
    geometry: GeometryConfig
    projection: ProjectionConfig
