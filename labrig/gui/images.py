"""From numbers to pixels on the screen: pure functions from arrays to (rows, cols, 3) uint8."""

from __future__ import annotations

from functools import cache
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.gui.palette import ZEBRA, rgb
from labrig.gui.viewport import Viewport

Rgb = NDArray[np.uint8]
Map = Literal["cividis", "grey"]
HATCH_PX = 4
SHIFT = 4  # fractional bits of coordinates that OpenCV draws to


@cache
def table(name: Map) -> Rgb:
    """Return the colours of 256 levels, (256, 3) red, green, blue."""
    levels = np.arange(256, dtype=np.uint8)
    if name == "grey":
        return np.repeat(levels[:, None], 3, axis=1)
    return np.ascontiguousarray(cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS)[:, 0, ::-1])


def levels(values: NDArray[Any], low: float, high: float, *, root: bool = False) -> Rgb:
    """Return values as levels 0 .. 255 of a range; NaN is 0. ``root`` scales by square roots."""
    span = max(high - low, 1e-30)
    if values.dtype == np.uint16 and not root and low >= 0.0:
        # saturates at both ends, and rounds
        shifted = values if low == 0.0 else cv2.subtract(values, float(low))
        return np.asarray(cv2.convertScaleAbs(shifted, alpha=255.0 / span))
    share = (values.astype(np.float32) - np.float32(low)) / np.float32(span)
    if root:
        share = np.sqrt(np.maximum(share, 0.0))
    np.nan_to_num(share, copy=False, nan=0.0, posinf=1.0, neginf=0.0)
    return np.asarray(np.clip(share, 0.0, 1.0) * 255.0 + 0.5, dtype=np.uint8)


def coloured(shown: Rgb, name: Map) -> Rgb:
    """Return levels (rows, cols) in the colours of a map."""
    return np.asarray(cv2.applyColorMap(shown, table(name)[:, None]))


def places(view: Viewport) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the picture's column of every pane's column and row of every row; -1 off it."""

    def along(n: int, begin: float, size: int) -> NDArray[np.int64]:
        found = np.floor(begin + (np.arange(n) + 0.5) / view.zoom).astype(np.int64)
        found[(found < 0) | (found >= size)] = -1
        return np.asarray(found)

    return along(view.width, view.left, view.cols), along(view.height, view.top, view.rows)


def seen(values: NDArray[Any], view: Viewport) -> tuple[NDArray[Any], slice, slice]:
    """Return the part of a picture that a pane shows, at its size, and the pane's rows and cols.

    Every pixel enlarged is a square of its own value; made smaller, areas are averaged.
    """
    cols, rows = places(view)
    x, y = np.flatnonzero(cols >= 0), np.flatnonzero(rows >= 0)
    if not (x.size and y.size):
        return np.empty((0, 0), values.dtype), slice(0, 0), slice(0, 0)
    across, down = slice(int(x[0]), int(x[-1]) + 1), slice(int(y[0]), int(y[-1]) + 1)
    cols, rows = cols[across], rows[down]
    if view.zoom >= 1.0:
        return values.take(rows, axis=0).take(cols, axis=1), down, across
    part = values[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    size = (cols.size, rows.size)
    return cv2.resize(part, size, interpolation=cv2.INTER_AREA), down, across


def paint(
    values: NDArray[Any],
    view: Viewport,
    *,
    low: float,
    high: float,
    colours: Map,
    ground: str,
    root: bool = False,
    white_level: int | None = None,
) -> Rgb:
    """Return what a pane shows of a picture, (height, width, 3).

    ``white_level`` hatches what the raw counts say is clipped; pixels between two of the pane's
    are then not seen, but none is hatched that is not clipped.
    """
    part, down, across = seen(values, view)
    if part.size == 0:
        return np.full((view.height, view.width, 3), rgb(ground), np.uint8)
    shown = coloured(levels(part, low, high, root=root), colours)
    border = (down.start, view.height - down.stop, across.start, view.width - across.stop)
    pane = cv2.copyMakeBorder(shown, *border, cv2.BORDER_CONSTANT, value=rgb(ground))
    if white_level is not None and values.max() >= white_level:
        i, j = np.nonzero(zebra_mask(values, view, white_level))
        stripe = ((i + j) // HATCH_PX) % 2
        pane[i, j] = np.array(ZEBRA, np.uint8)[stripe]
    return np.asarray(pane)


def zebra_mask(values: NDArray[Any], view: Viewport, white_level: int) -> NDArray[np.bool_]:
    """Return where in the pane a clipped pixel of the picture is shown, (height, width)."""
    cols, rows = places(view)
    shown = (
        (values >= white_level).take(np.maximum(rows, 0), axis=0).take(np.maximum(cols, 0), axis=1)
    )
    return np.asarray(shown & (rows >= 0)[:, None] & (cols >= 0)[None, :])


def stripes(line: NDArray[np.uint8] | None, width: int, height: int, period: int) -> Rgb:
    """Return a small picture of four periods of what the projector shows; red hatch if off."""
    picture = np.zeros((height, width, 3), np.uint8)
    if line is None:
        i, j = np.indices((height, width))
        picture[(i + j) % 8 == 0] = (96, 40, 40)
        return picture
    place = np.arange(height) * 4 * period // height
    shown = line[np.minimum(place, line.size - 1)]
    picture[:] = shown[:, None, None]
    return picture


def outline(
    picture: Rgb, points: NDArray[np.float64], colour: str, *, width: int, closed: bool = True
) -> None:
    """Draw a line through points (n, 2) as x, y into a picture, smooth to a sixteenth of a px."""
    fixed = np.rint(points * (1 << SHIFT)).astype(np.int32)
    cv2.polylines(picture, [fixed], closed, rgb(colour), width, cv2.LINE_AA, SHIFT)


def outlines(picture: Rgb, pieces: list[NDArray[np.float64]], colour: str, *, width: int) -> None:
    """Draw open lines, each through points (n, 2), as `outline` does."""
    fixed = [np.rint(points * (1 << SHIFT)).astype(np.int32) for points in pieces]
    cv2.polylines(picture, fixed, False, rgb(colour), width, cv2.LINE_AA, SHIFT)


def fill(picture: Rgb, points: NDArray[np.float64], colour: str, opacity: float) -> None:
    """Lay a colour over the inside of an outline (n, 2)."""
    low = np.maximum(np.floor(points.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(points.max(axis=0)).astype(int) + 2
    part = picture[low[1] : high[1], low[0] : high[0]]
    if part.size == 0:
        return
    over = part.copy()
    fixed = np.rint((points - low) * (1 << SHIFT)).astype(np.int32)
    cv2.fillPoly(over, [fixed], rgb(colour), cv2.LINE_AA, SHIFT)
    cv2.addWeighted(over, opacity, part, 1.0 - opacity, 0.0, dst=part)


def histogram_bars(
    counts: NDArray[np.int64], width: int, height: int, *, colour: str, ground: str, limit: str
) -> Rgb:
    """Return a histogram with a logarithmic height, the last column the clipped pixels' own."""
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = rgb(ground)
    if counts.size == 0 or counts.max() == 0:
        return picture
    column = np.minimum(np.arange(width) * counts.size // width, counts.size - 1)
    share = np.log1p(counts[column]) / np.log1p(counts.max())
    top = height - np.rint(share * (height - 3)).astype(np.int64)
    inside = np.arange(height)[:, None] >= top[None, :]
    picture[inside] = rgb(colour)
    picture[:, -max(2, width // 120) :] = rgb(limit)
    return picture
