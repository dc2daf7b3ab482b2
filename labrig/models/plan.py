"""Capture plans, and the shots they are made of."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from labrig.models.base import (
    MAX_SHIFTS,
    Model,
    NonNegative,
    Positive,
    Role,
    check_code,
    check_shift,
)


class StripesPattern(Model):
    """Shifted stripes."""

    kind: Literal["stripes"]
    period_px: int = Field(12, ge=2)
    shifts: int = Field(6, ge=2, le=MAX_SHIFTS)
    axis: Literal["x", "y"] = "x"
    low: int = Field(0, ge=0, le=255)
    high: int = Field(255, ge=0, le=255)

    @model_validator(mode="after")
    def _shifts_are_whole_pixels(self) -> StripesPattern:
        if self.period_px % self.shifts:
            msg = (
                f"shifts = {self.shifts} does not divide period_px = {self.period_px}: stripes "
                "would shift by a fraction of a pixel; choose a divisor of the period"
            )
            raise ValueError(msg)
        if self.period_px % 2:
            msg = f"period_px = {self.period_px} is odd: lit and dark could not be equally wide"
            raise ValueError(msg)
        if self.low >= self.high:
            msg = f"low = {self.low} must be darker than high = {self.high}"
            raise ValueError(msg)
        return self


class UniformPattern(Model):
    """The whole picture white: the light that stripes are compared with."""

    kind: Literal["uniform"]
    level: Literal[255] = 255


class BlackPattern(Model):
    """The projector showing black; its leak remains."""

    kind: Literal["black"]


class OffPattern(Model):
    """The projector's lamp off or covered."""

    kind: Literal["lamp-off"]


Pattern = Annotated[
    StripesPattern | UniformPattern | BlackPattern | OffPattern, Field(discriminator="kind")
]


class PlanSet(Model):
    """One pattern, or one series of shifts, taken at every exposure."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    pattern: Pattern
    shutter: Literal["open", "covered"] = "open"
    repeats: int = Field(1, ge=1)
    every: int | None = Field(None, ge=1, description="repeat after so many shots, as a reference")

    @model_validator(mode="after")
    def _dark_frames_show_no_stripes(self) -> PlanSet:
        if self.shutter == "covered" and self.pattern.kind == "stripes":
            msg = "stripes behind a covered lens; a dark frame has kind black or lamp-off"
            raise ValueError(msg)
        return self

    @property
    def role(self) -> Role:
        """What the pictures serve for; it follows from pattern and shutter."""
        if self.shutter == "covered":
            return "dark"
        roles: dict[str, Role] = {
            "stripes": "stripes",
            "uniform": "white",
            "black": "black",
            "lamp-off": "ambient",
        }
        return roles[self.pattern.kind]


class AutoBracket(Model):
    """A bracket found from a probe: the shortest exposure clips nothing that matters."""

    target: float = Field(0.7, gt=0.0, lt=1.0, description="brightest counts, share of white level")
    clip: float = Field(0.001, gt=0.0, lt=0.5, description="share of pixels that may be brighter")
    steps: int = Field(3, ge=1, le=16)
    ratio: float = Field(4.0, gt=1.0, le=64.0)


class Exposures(Model):
    """The bracket, given or found."""

    bracket_s: tuple[Positive, ...] | None = Field(None, min_length=1)
    auto: AutoBracket | None = None
    gain_db: NonNegative = 0.0
    snap_to: Literal["nothing", "refresh"] = Field(
        "nothing", description="round exposures to whole periods of the projector"
    )

    @model_validator(mode="after")
    def _one_bracket_all_different(self) -> Exposures:
        if (self.bracket_s is None) == (self.auto is None):
            msg = "give either bracket_s or auto"
            raise ValueError(msg)
        if self.bracket_s is not None and len(set(self.bracket_s)) < len(self.bracket_s):
            msg = f"bracket_s {list(self.bracket_s)} names an exposure twice; use repeats instead"
            raise ValueError(msg)
        return self


class Timing(Model):
    """What is waited for."""

    settle_s: NonNegative | Literal["calibrated"] = "calibrated"
    discard_after_exposure_change: int | Literal["capability"] = "capability"
    warmup_s: NonNegative = 0.0


class Order(Model):
    """What changes least often; `labrig check` prints the price of both."""

    outer: Literal["exposure", "pattern"] = "exposure"


class Limits(Model):
    """Where a run stops and asks."""

    saturated_fraction: float = Field(0.001, ge=0.0, le=1.0, description="above it a warning")
    attempts_per_shot: int = Field(3, ge=1, le=100, description="for each cause of failure")
    failures_per_run: float = Field(0.05, ge=0.0, le=1.0, description="share of the shots")
    max_gap_in_group_s: Positive = 30.0
    on_failure: Literal["pause", "abort"] = "pause"
    shift_residual: Positive = Field(
        0.03, description="of the light, by which shifts may fail to add up"
    )
    shift_brightness: Positive = Field(
        0.1, description="by which shifts may be brighter or darker than half of white and black"
    )
    reference_drift: Positive = Field(0.02, description="of the white light; above: new segment")


class CalibrationAges(Model):
    """How old calibrations may be; unset is not checked."""

    projector_latency_max_age_h: Positive | None = None


class RigWishes(Model):
    """What a rig must have, as ``camera.global_shutter`` or ``projector.height >= 720``."""

    require: tuple[str, ...] = ()


class Plan(Model):
    """What to capture."""

    schema_: Literal["labrig-plan/1"] = Field(alias="schema")
    name: str = Field(min_length=1)
    exposures: Exposures
    sets: tuple[PlanSet, ...] = Field(min_length=1)
    rig: RigWishes = RigWishes()
    timing: Timing = Timing()
    order: Order = Order()
    limits: Limits = Limits()
    calibration: CalibrationAges = CalibrationAges()

    @model_validator(mode="after")
    def _ids_are_unique(self) -> Plan:
        ids = [s.id for s in self.sets]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            msg = f"set id {twice[0]!r} is given twice"
            raise ValueError(msg)
        return self


class Shot(Model):
    """One picture to be taken, or taken.

    ``shift`` k of ``shifts`` N: the stripes moved by k/N of their period; both None for the
    others. ``pattern`` is the digest of the projector image, None if the projector is off or the
    picture was made elsewhere. ``axis``, ``bit`` (0 the finest) and ``polarity`` name a picture of
    a Grey code, ``level`` (share of white) one of a ramp.
    """

    model_config = ConfigDict(strict=True)

    id: str
    set: str
    role: Role
    group: str
    exposure_s: Positive
    repeat: int = Field(0, ge=0)
    shift: int | None = Field(None, ge=0)
    shifts: int | None = Field(None, ge=2, le=MAX_SHIFTS)
    pattern: str | None = None
    shutter: Literal["open", "covered"] = "open"
    axis: Literal["x", "y"] | None = None
    bit: int | None = Field(None, ge=0, le=15)
    polarity: Literal["plain", "inverse"] | None = None
    level: float | None = Field(None, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _only_stripes_have_shifts(self) -> Shot:
        check_shift(self.role, self.shift, self.shifts)
        check_code(self.role, (self.axis, self.bit, self.polarity), self.level)
        return self
