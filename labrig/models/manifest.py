"""Import manifests: existing pictures that are to become a session."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from labrig.models.base import MAX_SHIFTS, Model, Positive, Role, check_code, check_shift
from labrig.models.setup import Setup


class ImportFrame(Model):
    """One existing image file."""

    file: str = Field(min_length=1)
    role: Role
    exposure_s: Positive
    shift: int | None = Field(None, ge=0)
    shifts: int | None = Field(None, ge=2, le=MAX_SHIFTS)
    axis: Literal["x", "y"] | None = None
    bit: int | None = Field(None, ge=0, le=15, description="of a Grey code, 0 the finest")
    polarity: Literal["plain", "inverse"] | None = None
    level: float | None = Field(None, ge=0.0, le=1.0, description="of a ramp, share of white")

    @model_validator(mode="after")
    def _only_stripes_have_shifts(self) -> ImportFrame:
        try:
            check_shift(self.role, self.shift, self.shifts)
            check_code(self.role, (self.axis, self.bit, self.polarity), self.level)
        except ValueError as error:
            msg = f"{self.file}: {error}"
            raise ValueError(msg) from error
        return self


class ImportManifest(Setup):
    """Existing pictures that are to become a session."""

    schema_: Literal["labrig-import/1"] = Field(alias="schema")
    name: str = "import"
    calibration: dict[str, str] = Field(
        default_factory=dict, description="record folders by kind, relative to the manifest"
    )
    frames: tuple[ImportFrame, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _beam_enters(self) -> ImportManifest:
        if self.beam is not None and self.tank is not None:
            self.beam.record().entering(self.tank.record())
        return self
