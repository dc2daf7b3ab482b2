"""The frozen, validated models of configuration files: rigs, plans, scenes, analyses, imports.

`labrig.config` reads YAML into them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import UNRESOLVED
from calibration.model import CameraModel

Role = Literal["stripes", "white", "black", "ambient", "dark", "flat"]
MAX_SHIFTS = 1000
Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]


def _check_shift(role: str, shift: int | None, shifts: int | None) -> None:
    """Refuse stripes without shift and shifts, and anything else with them."""
    if role != "stripes":
        if shift is not None or shifts is not None:
            msg = f"only role stripes has shift and shifts, not {role}"
            raise ValueError(msg)
    elif shift is None or shifts is None:
        msg = "role stripes needs shift and shifts"
        raise ValueError(msg)
    elif shift >= shifts:
        msg = f"shift {shift} is not below shifts {shifts}"
        raise ValueError(msg)


class Model(BaseModel):
    """Frozen; refuses unknown keys, NaN and truth values."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )

    @model_validator(mode="before")
    @classmethod
    def _no_truth_values(cls, content: Any) -> Any:
        """Refuse yes, no, on and off, which YAML 1.1 reads as truth and pydantic as one or zero."""
        if not isinstance(content, dict):
            return content
        for mapping in (content, *(v for v in content.values() if isinstance(v, dict))):
            for key, value in mapping.items():
                if isinstance(value, bool):
                    msg = f"{key} is {str(value).lower()}, a number or a word was expected"
                    raise ValueError(msg)  # noqa: TRY004 - pydantic explains only value errors
        return content


# --- what any session tells the analysis -------------------------------------------------------


class CameraConfig(Model):
    """What is known about the camera that took the pictures."""

    bits: int = Field(ge=1, le=16)
    black_level_dn: NonNegative
    white_level_dn: Positive
    gain_dn_per_e: Positive | None = Field(None, description="system gain; unknown if left out")
    read_noise_e: Positive | None = Field(None, description="unknown if left out")
    response: Literal["linear"] = "linear"

    @model_validator(mode="after")
    def _levels_fit(self) -> CameraConfig:
        self.record()
        return self

    def record(self) -> CameraModel:
        """Return the calibration's record of this camera."""
        return CameraModel(
            bits=self.bits,
            black_level_dn=self.black_level_dn,
            white_level_dn=self.white_level_dn,
            gain_dn_per_e=self.gain_dn_per_e,
            read_noise_e=self.read_noise_e,
            response=self.response,
        )


class GeometryConfig(Model):
    """Where the sample lies in the picture."""

    mm_per_px: Positive | None = Field(None, description="without it lengths are px and say so")
    region_px: tuple[int, int, int, int] | None = Field(
        None,
        description="x, y, width, height; begins at the entry face; else the whole picture",
    )
    lit_side: Literal["left", "right", "top", "bottom"] = "left"

    @model_validator(mode="after")
    def _region_has_area(self) -> GeometryConfig:
        if self.region_px is not None and (min(self.region_px) < 0 or min(self.region_px[2:]) < 2):
            msg = f"region_px {list(self.region_px)} is not x, y >= 0 and width, height >= 2"
            raise ValueError(msg)
        return self


class TankConfig(Model):
    """Depth from the lit face and width along it."""

    depth_mm: Positive
    width_mm: Positive

    def record(self) -> Tank:
        """Return the analysis' record of this tank."""
        return Tank(depth_mm=self.depth_mm, width_mm=self.width_mm)


class BeamConfig(Model):
    """The lit part of the face, and the direction of the light inside the medium."""

    from_mm: float
    to_mm: float
    angle_deg: float = 0.0

    @model_validator(mode="after")
    def _is_a_beam(self) -> BeamConfig:
        self.record()
        return self

    def record(self) -> Beam:
        """Return the analysis' record of this beam."""
        return Beam(from_mm=self.from_mm, to_mm=self.to_mm, angle_deg=self.angle_deg)


class StripesConfig(Model):
    """The stripes that were shown, in projector px."""

    period_px: Positive = 12
    duty: float = Field(0.5, gt=0.0, lt=1.0)
    profile: Literal["square", "sinusoid"] = "square"
    low: float = Field(0.0, ge=0.0, lt=1.0, description="light of a dark stripe, share of white")
    high: float = Field(1.0, gt=0.0, le=1.0, description="light of a lit stripe, share of white")

    @model_validator(mode="after")
    def _low_is_darker(self) -> StripesConfig:
        if self.low >= self.high:
            msg = f"low = {self.low} must be darker than high = {self.high}"
            raise ValueError(msg)
        return self


class ProjectionConfig(Model):
    """Where a projector pixel falls in the tank: its phase is then known in every picture."""

    mm_per_px: Positive
    origin_mm: float = Field(description="tank y of the projector's first pixel edge")
    blur_px: NonNegative = Field(0.0, description="standard deviation of its blur, projector px")


class Setup(Model):
    """All that a session must tell the analysis beside its frames."""

    camera: CameraConfig
    geometry: GeometryConfig = GeometryConfig()
    tank: TankConfig | None = Field(None, description="else the region")
    beam: BeamConfig | None = Field(None, description="else measured from the white frame")
    stripes: StripesConfig | None = None
    projection: ProjectionConfig | None = Field(None, description="where it is calibrated")


# --- rigs ---------------------------------------------------------------------------------------


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


# --- plans --------------------------------------------------------------------------------------


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


class Exposures(Model):
    """The bracket."""

    bracket_s: tuple[Positive, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _all_different(self) -> Exposures:
        if len(set(self.bracket_s)) < len(self.bracket_s):
            msg = f"bracket_s {list(self.bracket_s)} names an exposure twice; use repeats instead"
            raise ValueError(msg)
        return self


class Plan(Model):
    """What to capture."""

    schema_: Literal["labrig-plan/1"] = Field(alias="schema")
    name: str = Field(min_length=1)
    exposures: Exposures
    sets: tuple[PlanSet, ...] = Field(min_length=1)

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
    picture was made elsewhere.
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

    @model_validator(mode="after")
    def _only_stripes_have_shifts(self) -> Shot:
        _check_shift(self.role, self.shift, self.shifts)
        return self


# --- scenes -------------------------------------------------------------------------------------


class MediumConfig(Model):
    """The scattering liquid."""

    sigma_t_per_mm: float
    sigma_s_per_mm: float
    g: float
    phase: Literal["hg-plane", "hg-paper"] = "hg-plane"

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
        )


class LightConfig(Model):
    """How bright it all is at the camera."""

    peak_e_per_s: Positive = Field(1.0e5, description="single scattering at the entry face")
    ambient_e_per_s: NonNegative = 0.0


class TransportConfig(Model):
    """How the multiple scattering of a simulated scene is computed."""

    method: Literal["montecarlo"] = "montecarlo"
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
        self.beam.record().within(self.tank.record())
        return self


# --- analyses -----------------------------------------------------------------------------------


class Analysis(Model):
    """How a session is analysed."""

    schema_: Literal["labrig-analysis/1"] = Field(alias="schema")
    separation: Literal["auto", "extrema", "known-pattern", "harmonic"] = "auto"
    phase: Literal["hg-plane", "hg-paper"] = "hg-plane"
    cell_mm: Positive = Field(1.0, description="grid of the forward solver")
    n_theta: int = Field(64, ge=8, multiple_of=4)
    n_bounces: int = Field(12, ge=2, le=400)
    g_range: tuple[float, float] = Field((-0.5, 0.8))
    n_g: int = Field(9, ge=3, le=64, description="Chebyshev nodes in g")
    depth_range_mm: tuple[float, float] | None = Field(None, description="of Eq. 9; else chosen")

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Analysis:
        low, high = self.g_range
        if not -1.0 < low < high < 1.0:
            msg = f"g_range {[low, high]} is not -1 < low < high < 1"
            raise ValueError(msg)
        if max(-low, high) ** (self.n_theta // 2) > UNRESOLVED:
            msg = f"n_theta = {self.n_theta} angles cannot resolve g_range {[low, high]}; use more"
            raise ValueError(msg)
        if (
            self.depth_range_mm is not None
            and not 0 <= self.depth_range_mm[0] < (self.depth_range_mm[1])
        ):
            msg = f"depth_range_mm {list(self.depth_range_mm)} is not 0 <= from < to"
            raise ValueError(msg)
        return self


# --- imports ------------------------------------------------------------------------------------


class ImportFrame(Model):
    """One existing image file."""

    file: str = Field(min_length=1)
    role: Role
    exposure_s: Positive
    shift: int | None = Field(None, ge=0)
    shifts: int | None = Field(None, ge=2, le=MAX_SHIFTS)

    @model_validator(mode="after")
    def _only_stripes_have_shifts(self) -> ImportFrame:
        try:
            _check_shift(self.role, self.shift, self.shifts)
        except ValueError as error:
            msg = f"{self.file}: {error}"
            raise ValueError(msg) from error
        return self


class ImportManifest(Setup):
    """Existing pictures that are to become a session."""

    schema_: Literal["labrig-import/1"] = Field(alias="schema")
    name: str = "import"
    frames: tuple[ImportFrame, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _beam_enters(self) -> ImportManifest:
        if self.beam is not None and self.tank is not None:
            self.beam.record().within(self.tank.record())
        return self
