"""Where the light enters a picture of the tank, and which way the beam goes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Entry face and beam axis in a picture whose lit side is left, in its own units.

    Attributes
    ----------
    face_x : where light begins, half of its rise
    axis_y : height of the beam's middle on the face
    angle_deg : of the axis, positive towards higher rows
    angle_std_deg : its standard deviation, from the scatter of the columns
    """

    face_x: float
    axis_y: float
    angle_deg: float
    angle_std_deg: float


def locate_entry(white: Array, pixel: float) -> Entry:
    """Find the face by the rise of light along the depth, the axis by the middles of the columns.

    Parameters
    ----------
    white : (rows, cols), white less black, lit side left, some dark liquid or wall before the face
    pixel : side of a pixel

    Raises
    ------
    CalibrationError
        If there is no beam that stands out.
    """
    picture = np.where(np.isfinite(white), white, 0.0)
    along = picture.sum(axis=0)
    peak = int(np.argmax(along))
    top = float(along[peak])
    across = picture[:, peak:].sum(axis=1)
    if not top > 0.0 or across.max() < 2.0 * max(float(np.median(across)), 0.0):
        msg = "no beam stands out in the white picture; light it, or mend the region."
        raise CalibrationError(msg)
    below = np.flatnonzero(along[: peak + 1] < 0.5 * top)
    face = 0.0
    if below.size:
        k = int(below[-1])
        face = k + 0.5 + (0.5 * top - along[k]) / (along[k + 1] - along[k])
    columns = np.flatnonzero((np.arange(along.size) > face + 1) & (along > 0.1 * top))
    if columns.size < 8:
        msg = f"the beam is seen in {columns.size} columns, 8 are needed to know its direction."
        raise CalibrationError(msg)
    rows = np.arange(picture.shape[0]) + 0.5
    light = np.clip(picture[:, columns] - 0.5 * picture[:, columns].max(axis=0), 0.0, None)
    middles = (rows[:, None] * light).sum(axis=0) / light.sum(axis=0)
    x = (columns + 0.5 - face).astype(np.float64)
    slope, at_face, std = _line(x, middles)
    return Entry(
        face_x=face * pixel,
        axis_y=at_face * pixel,
        angle_deg=math.degrees(math.atan(slope)),
        angle_std_deg=math.degrees(std / (1.0 + slope**2)),
    )


def _line(x: Array, y: Array) -> tuple[float, float, float]:
    rows = np.stack([x, np.ones_like(x)], axis=1)
    solution, *_ = np.linalg.lstsq(rows, y, rcond=None)
    rest = y - rows @ solution
    covariance = np.linalg.inv(rows.T @ rows) * float(rest @ rest) / max(x.size - 2, 1)
    return float(solution[0]), float(solution[1]), math.sqrt(covariance[0, 0])
