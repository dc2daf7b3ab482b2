"""Scenes: what a simulated camera looks at, and what a solver solves."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from analysis.medium import Medium
from labrig.models.base import Model, NonNegative, Positive
from labrig.models.effects import Effects, RefractionConfig
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
    tail: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="albedo^K at which bounces end; a fifth of the tolerance if left out",
    )


class Scene(Model):
    """What a simulated camera looks at."""

    schema_: Literal["labrig-scene/1"] = Field(alias="schema")
    name: str = "scene"
    medium: MediumConfig
    tank: TankConfig
    beam: BeamConfig
    light: LightConfig = LightConfig()
    transport: TransportConfig = TransportConfig()
    tolerance: float = Field(
        5e-3,
        gt=0.0,
        lt=1.0,
        description="relative rms of a lit picture; effects below are left out",
    )
    effects: Effects | None = Field(None, description="all that rig and scene speak of if left out")

    @model_validator(mode="after")
    def _beam_enters(self) -> Scene:
        bent = None if self.effects is None else self.effects.refraction
        if isinstance(bent, RefractionConfig) and self.beam.angle_deg:
            msg = (
                f"beam.angle_deg = {self.beam.angle_deg:g} is the direction inside, which "
                "effects.refraction works out; leave it at 0"
            )
            raise ValueError(msg)
        self.beam_inside().record().entering(self.tank.record())
        if self.tank.height_mm is not None and self.medium.phase != "hg-plane":
            msg = (
                f"medium.phase = {self.medium.phase} reads Eq. 2 in a plane; in a layer of known "
                "height it holds as it stands, on the sphere: leave phase out"
            )
            raise ValueError(msg)
        return self

    @property
    def tail(self) -> float:
        """Share of the light, albedo^K, that the last bounce K which is followed leaves."""
        given = self.transport.tail
        return self.tolerance / 5.0 if given is None else given

    def beam_inside(self) -> BeamConfig:
        """Return the beam as it is inside, by Snell's law where the scene names refraction."""
        bent = None if self.effects is None else self.effects.refraction
        if not isinstance(bent, RefractionConfig):
            return self.beam
        sine = math.sin(math.radians(bent.outside_deg)) / bent.index
        return self.beam.model_copy(update={"angle_deg": math.degrees(math.asin(sine))})
