"""A calibration as a frozen record, and whether it still holds under other conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["dark", "flat", "photon-transfer", "response", "geometry", "projector"]

# What a kind of record cannot live without; other differences are told and not fatal.
FATAL: Mapping[str, frozenset[str]] = {
    "dark": frozenset({"camera", "gain", "mode", "bits", "roi"}),
    "flat": frozenset({"camera", "lens", "mode", "roi"}),
    "photon-transfer": frozenset({"camera", "gain", "mode", "bits"}),
    "response": frozenset({"camera", "gain", "mode", "bits"}),
    "geometry": frozenset({"camera", "lens", "roi"}),
    "projector": frozenset({"camera", "lens", "roi", "projector", "projector_mode"}),
}
# What bears on a kind at all: a dark map does not know the projector.
OF_CAMERA = frozenset({"camera", "gain", "mode", "bits", "roi"})
HEEDED: Mapping[str, frozenset[str]] = {
    "dark": OF_CAMERA,
    "flat": OF_CAMERA | {"lens"},
    "photon-transfer": OF_CAMERA - {"roi"},
    "response": OF_CAMERA - {"roi"},
    "geometry": frozenset({"camera", "lens", "mode", "roi"}),
    "projector": frozenset({"camera", "lens", "mode", "roi", "projector", "projector_mode"}),
}
MAX_AGE: Mapping[str, timedelta] = {
    "dark": timedelta(hours=24),
    "flat": timedelta(days=30),
    "photon-transfer": timedelta(days=365),
    "response": timedelta(days=365),
    "geometry": timedelta(days=7),
    "projector": timedelta(days=7),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """What a calibration depends on; None where nobody noted it.

    Attributes
    ----------
    camera, lens : model and serial number; a note on focal length, focus and aperture
    gain, mode : the camera's gain setting and pixel format or readout mode, as it names them
    roi : rows, cols of the frames and, if known, row and column of their first pixel
    projector, projector_mode : model and serial number; resolution, refresh rate, picture mode
    """

    camera: str | None = None
    lens: str | None = None
    gain: str | None = None
    mode: str | None = None
    bits: int | None = None
    roi: tuple[int, ...] | None = None
    projector: str | None = None
    projector_mode: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A number with its unit and standard deviation, None where that is unknown."""

    value: float
    unit: str
    std: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedArray:
    """An array with its axes, unit and meaning."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A calibration: what was found, from what, when and under which conditions.

    Attributes
    ----------
    quantities, arrays : results by name
    settings : words and whole numbers that the results need to be understood
    inputs : SHA-256 of every frame's pixels together with its role and exposure
    notes : sentences: what to doubt
    """

    kind: Kind
    created: datetime
    conditions: Conditions
    inputs: str
    n_frames: int
    quantities: Mapping[str, Quantity]
    arrays: Mapping[str, NamedArray] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One way in which a record does not fit: ``fatal`` if it must not be used."""

    what: str
    recorded: str
    current: str
    fatal: bool

    @property
    def text(self) -> str:
        """The difference as words."""
        return f"{self.what} was {self.recorded} and is {self.current}"


def validity(record: Record, current: Conditions, now: datetime) -> tuple[Difference, ...]:
    """Compare a record with current conditions; an empty answer means that it holds.

    What was not noted on either side cannot be compared: it is told, and not fatal. Age never is.
    """
    found = []
    for name in sorted(HEEDED[record.kind]):
        before, after = getattr(record.conditions, name), getattr(current, name)
        if before == after:
            continue
        known = before is not None and after is not None
        found.append(
            Difference(
                what=name.replace("_", " "),
                recorded=_said(before),
                current=_said(after),
                fatal=known and name in FATAL[record.kind],
            )
        )
    age = now - record.created
    if age > MAX_AGE[record.kind]:
        found.append(
            Difference(
                what="age",
                recorded=f"to be at most {_span(MAX_AGE[record.kind])}",
                current=_span(age),
                fatal=False,
            )
        )
    return tuple(found)


def _said(value: object) -> str:
    if value is None:
        return "not noted"
    return " x ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _span(age: timedelta) -> str:
    hours = age.total_seconds() / 3600.0
    return f"{hours:.0f} h" if hours < 72.0 else f"{hours / 24.0:.0f} days"


def array(dims: tuple[str, ...], values: Any, unit: str, meaning: str) -> NamedArray:
    """Return an array with its axes, unit and meaning."""
    return NamedArray(dims=dims, values=np.asarray(values), unit=unit, meaning=meaning)
