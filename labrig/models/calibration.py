"""Calibration records as they stand in a file."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import ConfigDict, Field

from calibration.record import Kind
from labrig.models.base import Model, Positive


class QuantityFile(Model):
    """A number, null where it is unknown, its standard deviation and unit."""

    value: float | None
    std: float | None = None
    unit: str


class ConditionsFile(Model):
    """What the calibration depends on; null where nobody noted it."""

    camera: str | None = None
    lens: str | None = None
    gain: str | None = None
    mode: str | None = None
    bits: int | None = None
    roi: tuple[int, ...] | None = None
    projector: str | None = None
    projector_mode: str | None = None


class SourceFile(Model):
    """What a record was made from."""

    session: str
    path: str
    n_frames: int
    sha256: str = Field(description="of every frame's pixels with its role and exposure")


class RecordFile(Model):
    """A calibration record, ``record.yaml``."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_: Literal["labrig-calibration/1"] = Field(alias="schema")
    kind: Kind
    id: str
    created: datetime
    source: SourceFile
    conditions: ConditionsFile
    quantities: dict[str, QuantityFile]
    settings: dict[str, Any] = Field(default_factory=dict)
    notes: tuple[str, ...] = ()
    arrays_sha256: str | None = Field(None, description="of arrays.nc; null if there is none")
    software: dict[str, str] = Field(default_factory=dict)


class BoardFile(Model):
    """A ChArUco board as it was printed, ``board.yaml``."""

    schema_: Literal["labrig-board/1"] = Field(alias="schema")
    squares_x: int = Field(9, ge=3)
    squares_y: int = Field(7, ge=3, description="odd")
    square_mm: Positive = 10.0
    marker_mm: Positive = 7.0
    dictionary: str = "DICT_5X5_100"
