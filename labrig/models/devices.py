"""Real devices of a rig file: which driver, which device, and what the driver cannot ask it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from labrig.models.base import Model, NonNegative, Positive
from labrig.models.setup import CameraConfig


class RealCameraConfig(CameraConfig):
    """What every real camera's entry says; ``device`` is a name that survives a replug."""

    device: str
    rows: int = Field(ge=16, le=10000, description="of the picture as captured, px")
    cols: int = Field(ge=16, le=10000)
    pixel_format: str | None = Field(None, description="the deepest grey one if left out")
    readout_s: NonNegative = Field(0.2, description="end of an exposure to arrival, at most")
    row_time_s: NonNegative = Field(0.0, description="of a rolling shutter; 0 is a global one")
    exposure_latency_frames: int = Field(3, ge=0, le=50, description="frames with the old exposure")
    uncertainty_s: NonNegative = Field(0.005, description="of its time stamps")
    queue_depth: int = Field(4, ge=2, le=64)


class V4l2CameraConfig(RealCameraConfig):
    """A camera of the kernel's video subsystem."""

    driver: Literal["v4l2"]
    controls: dict[str, int] = Field(default_factory=dict, description="by name, such as gain: 0")
    timestamp: Literal["start", "end"] | None = Field(None, description="as declared if left out")
    allow_uncalibrated: bool = Field(False, description="take MJPEG, not proportional to light")


class GenicamCameraConfig(RealCameraConfig):
    """A USB3 Vision or GigE Vision camera, by Aravis; ``device`` is its serial number."""

    driver: Literal["genicam"]
    trigger_line: str = "Line1"


class PluginCameraConfig(RealCameraConfig):
    """A camera of a third party, registered as an entry point of ``labrig.cameras``."""

    driver: Literal["plugin"]
    name: str
    settings: dict[str, Any] = Field(default_factory=dict)


class RealProjectorConfig(Model):
    """What every real projector's entry says."""

    rows: int = Field(ge=1, le=10000)
    cols: int = Field(ge=1, le=10000)
    refresh_hz: Positive = 60.0
    latency_s: NonNegative = Field(0.0, description="least time from request to light")
    jitter_s: NonNegative = Field(0.1, description="the latency's largest excess")
    settle_s: NonNegative = 0.05
    black_level: float = Field(0.0, ge=0.0, lt=1.0, description="light of black, share of white")


class ScreenProjectorConfig(RealProjectorConfig):
    """A projector on an output of this machine's X server, by the output's name."""

    driver: Literal["screen"]
    output: str
    display: str = Field("", description="DISPLAY of the environment if left out")
    compositor: Literal["refused", "accepted"] = "refused"
    after: Literal["black", "desktop"] = Field("black", description="what remains when all ends")


class PluginProjectorConfig(RealProjectorConfig):
    """A projector of a third party, registered as an entry point of ``labrig.projectors``."""

    driver: Literal["plugin"]
    name: str
    settings: dict[str, Any] = Field(default_factory=dict)


class RealTriggerConfig(Model):
    """What every trigger box's entry says."""

    pulse_s: Positive = 1e-3
    delay_s: NonNegative = 0.0
    source: Literal["host", "projector-sync"] = "host"
    watchdog_s: float = Field(5.0, ge=0.1, le=600.0)


class SerialTriggerConfig(RealTriggerConfig):
    """A trigger box on a serial port, best named in /dev/serial/by-id."""

    driver: Literal["serial"]
    port: str
    baud: int = 115200


class UsbTriggerConfig(RealTriggerConfig):
    """A trigger box on USB."""

    driver: Literal["usb"]
    serial: str | None = None
    vendor_id: int = 0x1209
    product_id: int = 0x0001


class PluginTriggerConfig(RealTriggerConfig):
    """A trigger box of a third party, registered as an entry point of ``labrig.triggers``."""

    driver: Literal["plugin"]
    name: str
    settings: dict[str, Any] = Field(default_factory=dict)
