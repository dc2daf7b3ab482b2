"""A result as the window shows it: plain arrays and text, light to import and to send."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.reweighting import reweight

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """Where a picture lies: left, right, bottom and top edge; y grows downwards."""

    left: float
    right: float
    bottom: float
    top: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Decay:
    """Light against depth with its exponential; see `labrig.reporting.views.DecayView`."""

    title: str
    depth: Array
    value: Array
    std: Array
    fit: Array
    fitted: tuple[float, float]
    sigma_t: str
    rms_relative: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table: what, its value with standard deviation, the truth if known."""

    name: str
    value: str
    unit: str
    truth: str
    off: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounces:
    """Every bounce of a result, for its own sigma_s or another.

    Attributes
    ----------
    depth, curves : (n,), (K, n), light along the beam, counts/s
    pictures : (K, n_y, n_x) counts/s, on nodes ``x``, ``y``
    light_field : (K - 1, n_y, n_x, n_theta), bounces 2 .. K, per radian
    lit : first and last row, first and last column of the nodes that are worth a look
    error_estimate : (K,), stated relative error of each; None where it was not measured
    """

    sigma_s: float
    sigma_t: float
    g: float
    depth: Array
    curves: Array
    x: Array
    y: Array
    extent: Extent
    pictures: Image
    theta: Array
    light_field: Image
    beam_angle_rad: float
    beam_rows: tuple[float, float]
    lit: tuple[int, int, int, int]
    error_estimate: Array | None

    def weighted(self, sigma_s: float, *, light: bool = True) -> Bounces:
        """Return the bounces of another sigma_s (Eq. 11); without the light fields if so asked."""

        def of(values: NDArray[np.float64], first: int) -> NDArray[np.float64]:
            return reweight(values, first=first, sigma_s_per_mm=self.sigma_s, wanted_per_mm=sigma_s)

        field = self.light_field
        if light:
            field = reweight(field, first=2, sigma_s_per_mm=self.sigma_s, wanted_per_mm=sigma_s)
        return replace(
            self,
            curves=of(self.curves, 1),
            pictures=reweight(
                self.pictures, first=1, sigma_s_per_mm=self.sigma_s, wanted_per_mm=sigma_s
            ),
            light_field=field,
            sigma_s=sigma_s,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Everything the result tabs show of one run of the analysis.

    ``white_depth``, ``white`` are the measured light without separation, empty if there is none.
    """

    path: Path
    session: Path
    title: str
    unit: str
    rows: tuple[Row, ...]
    warnings: tuple[str, ...]
    quality: tuple[tuple[str, str], ...]
    seconds: dict[str, float]
    captured: Image
    single: Image
    multiple: Image
    extent: Extent
    decays: tuple[Decay, ...]
    white_depth: Array
    white: Array
    bounces: Bounces | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """What one set of live stripes says: values with standard deviations, and curves.

    Attributes
    ----------
    taken_s : when its oldest picture was taken
    depth, single : (n,), single light along the beam as it was separated, counts/s
    bounce_depth, bounces : (m,), (K, m), the first bounces of the medium found
    plan_std : of sigma_t after the whole plan; NaN while unknown
    holds : the fit of the next set may begin from it
    why : what stopped the fit, or must be said of it
    """

    unit: str
    taken_s: float
    sigma_t: tuple[float, float] | None = None
    sigma_s: tuple[float, float] | None = None
    g: tuple[float, float] | None = None
    depth: Array = field(default_factory=lambda: np.empty(0))
    single: Array = field(default_factory=lambda: np.empty(0))
    bounce_depth: Array = field(default_factory=lambda: np.empty(0))
    bounces: Array = field(default_factory=lambda: np.empty((0, 0)))
    plan_std: float = math.nan
    holds: bool = False
    why: str = ""
    cpu_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Price:
    """What the bounces to a tolerance would take, before it is paid."""

    tolerance: float
    engine: str
    grid: str
    seconds: float
    gigabytes: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Listed:
    """A session in the browser; ``state`` is the catalogue's, ``fitted`` if it has results."""

    path: Path
    name: str
    state: str
    saved: int
    planned: int
    created: str
    fitted: bool
