"""Scenes: what a simulated camera looks at, and what a solver solves."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from analysis.medium import Medium
from labrig.models.base import Model, NonNegative, Positive
from labrig.models.setup import BeamConfig, TankConfig


class MediumConfig(Model):
    """The scattering liquid."""

    sigma_t_per_mm: float
    sigma_s_per_mm: float
    g: float
    phase: Literal["hg-plane", "hg-paper"] = "hg-plane"
    gain: Literal["refused", "allowed"] = Field(
        "refused", description="allowed lets sigma_s exceed sigma_t"
    )

    @model_validator(mode="after")
    def _is_physical(self) -> MediumConfig:
        self.record()
        return self

    def record(self) -> Medium:
        """Return the analysis' record of this medium."""
        return Medium(
            sigma_t_per_mm=self.sigma_t_per_mm,
            sigma_s_per_mm=self.sigma_s_per_mm,
            g=self.g,
            phase=self.phase,
            gain=self.gain,
        )


class LightConfig(Model):
    """How bright it all is at the camera."""

    peak_e_per_s: Positive = Field(1.0e5, description="single scattering at the entry face")
    ambient_e_per_s: NonNegative = 0.0


class TransportConfig(Model):
    """How the multiple scattering of a simulated scene is computed."""

    method: Literal["montecarlo", "ordinates"] = Field(
        "montecarlo", description="montecarlo is independent of the analysis, ordinates is not"
    )
    n_paths: int = Field(3_000_000, ge=1000)
    cell_mm: Positive = 0.5
    seed: int = 1
    tail: float = Field(1e-3, gt=0.0, lt=1.0, description="albedo^K at which bounces end")


class Scene(Model):
    """What a simulated camera looks at."""

    schema_: Literal["labrig-scene/1"] = Field(alias="schema")
    name: str = "scene"
    medium: MediumConfig
    tank: TankConfig
    beam: BeamConfig
    light: LightConfig = LightConfig()
    transport: TransportConfig = TransportConfig()

    @model_validator(mode="after")
    def _beam_enters(self) -> Scene:
        self.beam.record().entering(self.tank.record())
        return self
