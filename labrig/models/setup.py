"""What any session tells the analysis beside its frames: camera, geometry, tank, stripes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from pydantic import Field, model_validator

from analysis.medium import Beam, Slab, Tank
from calibration.model import CameraModel
from calibration.record import Conditions
from calibration.response import LINEAR, srgb_response
from labrig.models.base import Model, NonNegative, Positive


class CameraConfig(Model):
    """What is known about the camera that took the pictures."""

    bits: int = Field(ge=1, le=16)
    black_level_dn: NonNegative
    white_level_dn: Positive
    gain_dn_per_e: Positive | None = Field(None, description="system gain; unknown if left out")
    read_noise_e: Positive | None = Field(None, description="unknown if left out")
    response: Literal["linear", "srgb"] = "linear"

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
            response=LINEAR if self.response == "linear" else srgb_response(self.bits),
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


WATER = 1.33  # refractive index


class LayerConfig(Model):
    """How high the liquid stands, and what its surface does."""

    height_mm: float = Field(description="from the floor to the surface")
    surface_index: float = Field(
        WATER, description="of the liquid against what is above; 1 for a surface without reflection"
    )
    height_std_mm: NonNegative | None = Field(
        None, description="how well the height is known; what it does to the answer is stated"
    )
    index_std: NonNegative | None = Field(None, description="the same of the index")

    @model_validator(mode="after")
    def _is_a_layer(self) -> LayerConfig:
        Slab(depth_mm=1.0, height_mm=self.height_mm, surface_index=self.surface_index)
        return self


class TankConfig(Model):
    """Depth from the lit face, width along it, and the height of the liquid where it is known."""

    depth_mm: Positive
    width_mm: Positive
    height_mm: float | None = Field(
        None, description="of the liquid; without it light is taken to live in a plane"
    )
    surface_index: float | None = Field(
        None, description=f"of the liquid against what is above; {WATER} if left out"
    )
    height_std_mm: NonNegative | None = Field(
        None, description="how well the height is known; what it does to the answer is stated"
    )
    index_std: NonNegative | None = Field(None, description="the same of the index")

    @model_validator(mode="after")
    def _is_filled(self) -> TankConfig:
        for name in ("surface_index", "height_std_mm", "index_std"):
            if self.height_mm is None and getattr(self, name) is not None:
                msg = f"{name} says nothing without height_mm; give the liquid's height too"
                raise ValueError(msg)
        self.slab()
        return self

    def record(self) -> Tank:
        """Return the analysis' record of this tank."""
        return Tank(depth_mm=self.depth_mm, width_mm=self.width_mm)

    def slab(self) -> Slab | None:
        """Return the analysis' record of the layer of liquid; None where its height is unknown."""
        if self.height_mm is None:
            return None
        index = WATER if self.surface_index is None else self.surface_index
        return Slab(depth_mm=self.depth_mm, height_mm=self.height_mm, surface_index=index)


class BeamConfig(Model):
    """The lit part of the face, and the direction of the light inside the medium."""

    from_mm: float
    to_mm: float
    angle_deg: float = 0.0
    profile: tuple[tuple[float, float], ...] | None = Field(
        None, description="pairs [y_mm, irradiance] from from_mm to to_mm; else irradiance one"
    )

    @model_validator(mode="after")
    def _is_a_beam(self) -> BeamConfig:
        self.record()
        return self

    def record(self) -> Beam:
        """Return the analysis' record of this beam."""
        return Beam(
            from_mm=self.from_mm,
            to_mm=self.to_mm,
            angle_deg=self.angle_deg,
            profile=self.profile,
        )


class StripesConfig(Model):
    """The stripes that were shown, in projector px."""

    period_px: Positive = 12
    duty: float = Field(0.5, gt=0.0, lt=1.0)
    profile: Literal["square", "sinusoid"] = "square"
    axis: Literal["x", "y"] = Field("x", description="projector axis along which they vary")
    offset_px: float = Field(0.0, description="where a lit stripe of shift 0 begins")
    low: float = Field(0.0, ge=0.0, lt=1.0, description="light of a dark stripe, share of white")
    high: float = Field(1.0, gt=0.0, le=1.0, description="light of a lit stripe, share of white")
    levels: tuple[float, float] | None = Field(
        None, description="grey levels of both, shares of white, if not 0 and 1: gamma makes light"
    )

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


class ProjectorSizeConfig(Model):
    """Native size of the projector, px: what its Grey codes count to."""

    rows: int = Field(ge=1, le=10000)
    cols: int = Field(ge=1, le=10000)


class ConditionsConfig(Model):
    """What calibrations depend on and pictures do not say, as words; left out where unknown."""

    camera: str | None = Field(None, description="model and serial number")
    lens: str | None = Field(None, description="focal length, focus, aperture")
    gain: str | None = Field(None, description="the camera's gain setting")
    mode: str | None = Field(None, description="the camera's pixel format or readout mode")
    projector: str | None = Field(None, description="model and serial number")
    projector_mode: str | None = Field(None, description="resolution, refresh rate, picture mode")

    def record(self, bits: int | None, roi: tuple[int, ...] | None) -> Conditions:
        """Return the calibration's record of these conditions."""
        return Conditions(**self.model_dump(), bits=bits, roi=roi)


class Setup(Model):
    """All that a session must tell the analysis beside its frames."""

    camera: CameraConfig
    geometry: GeometryConfig = GeometryConfig()
    tank: TankConfig | None = Field(None, description="else the region")
    beam: BeamConfig | None = Field(None, description="else measured from the white frame")
    stripes: StripesConfig | None = None
    projection: ProjectionConfig | None = Field(None, description="where it is calibrated")
    projector: ProjectorSizeConfig | None = Field(None, description="needed by Grey codes")
    conditions: ConditionsConfig | None = Field(None, description="what calibrations depend on")

    @model_validator(mode="after")
    def _is_seen(self) -> Setup:
        if self.projection is not None:
            period_px = () if self.stripes is None else (self.stripes.period_px,)
            refuse_unseen(self.tank, self.beam, self.projection, self.geometry, period_px)
        return self


def refuse_unseen(
    tank: TankConfig | None,
    beam: BeamConfig | None,
    projection: ProjectionConfig,
    geometry: GeometryConfig,
    periods_px: Iterable[float],
) -> None:
    """Refuse stripes that the camera cannot tell apart, and layers that no model is made for.

    Raises
    ------
    ValueError
        With one line that says what to do.
    """
    for period_px in periods_px:
        period_mm = period_px * projection.mm_per_px
        if geometry.mm_per_px is not None and period_mm < 2.0 * geometry.mm_per_px:
            msg = (
                f"the stripes' period of {period_mm:.3g} mm is shorter than two camera pixels of "
                f"{geometry.mm_per_px:.3g} mm; show coarser stripes, or look from nearer"
            )
            raise ValueError(msg)
    if tank is None or tank.height_mm is None:
        return
    blur_mm = projection.blur_px * projection.mm_per_px
    if tank.height_mm <= blur_mm:
        msg = (
            f"tank.height_mm = {tank.height_mm:g} is thinner than the stripes' blur of "
            f"{blur_mm:.3g} mm; mend the height or projection.blur_px"
        )
        raise ValueError(msg)
    if beam is not None and beam.angle_deg:
        msg = (
            f"beam.angle_deg = {beam.angle_deg:g}: light enters a layer of known height straight; "
            "turn the projector, or leave tank.height_mm out"
        )
        raise ValueError(msg)
