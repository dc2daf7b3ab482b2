"""The beam in the picture, and light along it as a function of depth: s(d) of Eq. 9."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Beam

Array = NDArray[np.float64]
Picture = NDArray[np.floating[Any]]  # single precision will do

# Where some pixels are saturated, those left are the darker ones: a mean of them would be low.
WHOLE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthProfile:
    """Light averaged across the beam.

    Attributes
    ----------
    depth_mm : (n,), distance travelled inside the medium
    value, std : (n,), mean and its standard deviation; from the variance map, or from the scatter
        of the rows where that is unknown
    n_rows : (n,), pixels in each mean
    detected_share : (n,), share of these pixels whose light was detected
    rows : (n_rows, n) float32, the pixels themselves, NaN where one is not used; a slanted beam's
        are those of the picture
    """

    depth_mm: Array
    value: Array
    std: Array
    n_rows: NDArray[np.int64]
    detected_share: Array
    rows: NDArray[np.float32]


def depth_profile(
    picture: Picture,
    variance: Picture,
    pixel_mm: float,
    beam: Beam,
    *,
    margin_mm: float,
    detected: NDArray[np.bool_] | None = None,
) -> DepthProfile:
    """Average a picture (rows = y, cols = x) across the beam at every depth.

    Rows nearer than ``margin_mm`` to the beam's edges are left out. ``detected`` (rows, cols) is
    counted, not selected by: a mean of detected pixels alone would be high. A slanted beam is
    followed; its depth is the path x / cos(theta_0).

    Raises
    ------
    AnalysisError
        If no row is left, or no pixel in them is valid.
    """
    rows, cols = picture.shape
    x = (np.arange(cols) + 0.5) * pixel_mm
    y = (np.arange(rows) + 0.5) * pixel_mm
    angle = math.radians(beam.angle_deg)
    entry = y[:, None] - x[None, :] * math.tan(angle)
    inside = (entry > beam.from_mm + margin_mm) & (entry < beam.to_mm - margin_mm)
    if not inside[:, 0].any():
        msg = (
            f"no row of the picture lies in the beam {beam.from_mm:g} .. {beam.to_mm:g} less a "
            f"margin of {margin_mm:g} at each edge; the beam is too narrow for these stripes."
        )
        raise AnalysisError(msg)
    use = inside & np.isfinite(picture)
    n = use.sum(axis=0)
    keep = n >= np.maximum(2, WHOLE * inside.sum(axis=0))
    if keep.sum() < 4:
        msg = "fewer than four depths have valid pixels; the beam is saturated or out of view."
        raise AnalysisError(msg)
    counted = np.maximum(n, 1)
    mean = np.where(use, picture, 0.0).sum(axis=0, dtype=np.float64) / counted
    scatter = np.where(use, (picture - mean) ** 2, 0.0).sum(axis=0) / np.maximum(n - 1, 1)
    known = np.where(use, variance, 0.0).sum(axis=0, dtype=np.float64) / counted
    seen = use if detected is None else use & detected
    of_one = np.where(np.isfinite(known), known, scatter)
    return DepthProfile(
        depth_mm=x[keep] / math.cos(angle),
        value=mean[keep],
        std=np.sqrt(of_one / counted)[keep],
        n_rows=n[keep],
        detected_share=(seen.sum(axis=0) / counted)[keep],
        rows=np.where(use, picture, np.nan)[use.any(axis=1)][:, keep].astype(np.float32),
    )


def measure_beam(white: Array, pixel_mm: float) -> Beam:
    """Return the lit part of the face: where the white light near it exceeds half its maximum.

    Raises
    ------
    AnalysisError
        If nothing is lit.
    """
    n_near = max(1, white.shape[1] // 50)
    with np.errstate(invalid="ignore"):
        face = np.nanmean(np.where(np.isfinite(white[:, :n_near]), white[:, :n_near], np.nan), 1)
    face = np.nan_to_num(face, nan=0.0)
    lit = np.flatnonzero(face > 0.5 * np.quantile(face, 0.98))
    if lit.size == 0 or face.max() <= 0.0:
        msg = "the white picture is dark at the entry face; is region_px right, was the light on?"
        raise AnalysisError(msg)
    return Beam(from_mm=float(lit[0]) * pixel_mm, to_mm=float(lit[-1] + 1) * pixel_mm)
