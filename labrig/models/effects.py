"""Effects that a scene may name, and their parameters.

A parameter left out is the rig's own, where the rig has it.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from labrig.models.base import Model, NonNegative, Positive

Word = Literal["auto", "always", "never"]
"""auto: used where it matters at the scene's tolerance."""

INDEX = Field(1.33, ge=1.0, le=4.0, description="refractive index of the liquid")


class GammaConfig(Model):
    """Light of a grey level: (level / 255)^gamma."""

    gamma: float = Field(gt=0.1, le=10.0)


class LeakConfig(Model):
    """Light of a black pixel; the rig's projector.black_level if left out."""

    share: float | None = Field(None, ge=0.0, lt=1.0)


class BlurConfig(Model):
    """Standard deviation of a projector pixel; the rig's projection.blur_px if left out."""

    sigma_px: NonNegative | None = None


class DefocusConfig(Model):
    """Growth of the projector's blur with depth."""

    px_per_mm: NonNegative


class LampShapeConfig(Model):
    """Brightness lost from the middle of the beam to its edges, as a share."""

    falloff: float = Field(ge=0.0, lt=1.0)


class LampDriftConfig(Model):
    """Warming up and drifting; the rig's simulation.lamp if left out."""

    cold_share: float | None = Field(None, ge=0.0, lt=1.0)
    warmup_s: Positive | None = None
    drift_per_h: float | None = Field(None, gt=-1.0, lt=1.0)


class ColourWheelConfig(Model):
    """Flicker of the light; the rig's simulation.lamp if left out."""

    flicker: float | None = Field(None, ge=0.0, lt=1.0)
    flicker_hz: Positive | None = None


class RefractionConfig(Model):
    """The beam's direction outside; inside it follows from Snell's law, not from beam.angle_deg."""

    outside_deg: float = Field(gt=-90.0, lt=90.0)
    index: float = INDEX


class FresnelConfig(Model):
    """Light lost at the pane by which it enters."""

    index: float = INDEX
    glass_index: float = Field(1.52, ge=1.0, le=4.0)


class DivergenceConfig(Model):
    """The angle between the beam's edges and its middle, inside the medium."""

    half_angle_deg: float = Field(ge=0.0, lt=30.0)


class InternalReflectionConfig(Model):
    """Scattered light that the lit face sends back, as a bare surface to air does."""

    index: float = INDEX


class WallsConfig(Model):
    """What the walls, all but the lit face, give back as mirrors; black ones are none."""

    reflectance: float = Field(ge=0.0, lt=1.0)


class AmbientConfig(Model):
    """Light that is not the projector's; the scene's light.ambient_e_per_s if left out."""

    e_per_s: NonNegative | None = None


class ObliqueConfig(Model):
    """A camera that looks aslant, turned about the picture's vertical axis."""

    tilt_deg: float = Field(gt=-60.0, lt=60.0)
    distance_mm: Positive = 400.0


class DistortionConfig(Model):
    """Radial distortion: r (1 + k1 r^2), r counted in half diagonals of the sensor."""

    k1: float = Field(ge=-0.14, le=0.5, description="below -4/27 corners would fold over")


class LensBlurConfig(Model):
    """Standard deviation of the lens' Gaussian, camera px."""

    sigma_px: float = Field(ge=0.0, le=100.0)


class VignettingConfig(Model):
    """The fall of light as cos^4 of the angle to the axis, by the angle to the corners."""

    half_field_deg: float = Field(ge=0.0, lt=80.0)


class ResponseConfig(Model):
    """The camera's response; the rig's camera.response if left out."""

    curve: Literal["linear", "srgb"] | None = None


class BloomingConfig(Model):
    """Share of the charge above full well that spills into the column's next pixels."""

    share: float = Field(ge=0.0, le=1.0)


class HotPixelsConfig(Model):
    """Pixels with a current of their own; the rig's camera if left out."""

    number: int | None = Field(None, ge=0, le=1_000_000)
    e_per_s: NonNegative | None = None


class RollingShutterConfig(Model):
    """Delay from row to row; the rig's camera.row_time_s if left out."""

    row_time_s: NonNegative | None = None


class Effects(Model):
    """The effects of a scene, in any order; one that is not named does not happen."""

    gamma: GammaConfig | None = Field(None, alias="projector-gamma")
    leak: Word | LeakConfig | None = Field(None, alias="black-leak")
    blur: Word | BlurConfig | None = Field(None, alias="projector-blur")
    defocus: DefocusConfig | None = None
    lamp_shape: LampShapeConfig | None = Field(None, alias="lamp-shape")
    lamp_drift: Word | LampDriftConfig | None = Field(None, alias="lamp-drift")
    colour_wheel: Word | ColourWheelConfig | None = Field(None, alias="colour-wheel")
    refraction: RefractionConfig | None = None
    fresnel: Word | FresnelConfig | None = None
    divergence: DivergenceConfig | None = None
    single: Word | None = Field(None, alias="single-scattering")
    multiple: Word | None = Field(None, alias="multiple-scattering")
    anisotropy: Word | None = None
    internal_reflection: Word | InternalReflectionConfig | None = Field(
        None, alias="internal-reflection"
    )
    walls: WallsConfig | None = None
    ambient: Word | AmbientConfig | None = None
    oblique: ObliqueConfig | None = Field(None, alias="oblique-view")
    distortion: DistortionConfig | None = None
    lens_blur: LensBlurConfig | None = Field(None, alias="lens-blur")
    vignetting: VignettingConfig | None = None
    rolling_shutter: Word | RollingShutterConfig | None = Field(None, alias="rolling-shutter")
    hot_pixels: Word | HotPixelsConfig | None = Field(None, alias="hot-pixels")
    shot_noise: Word | None = Field(None, alias="shot-noise")
    read_noise: Word | None = Field(None, alias="read-noise")
    blooming: BloomingConfig | None = None
    response: Word | ResponseConfig | None = None
    saturation: Word | None = None
    quantisation: Word | None = None


AS_THE_RIG_SAYS = Effects(
    leak="always",
    blur="auto",
    lamp_drift="always",
    colour_wheel="always",
    single="always",
    multiple="auto",
    anisotropy="auto",
    ambient="always",
    rolling_shutter="always",
    hot_pixels="always",
    shot_noise="always",
    read_noise="always",
    response="always",
    saturation="always",
    quantisation="always",
)
"""What a scene that names no effects has: all that rig and scene speak of."""
