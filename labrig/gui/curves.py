"""Curves as pixels: scales, round ticks, dashes; pure functions and records."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labrig.gui.images import Rgb, fill, outline, outlines
from labrig.gui.palette import Look, rgb

Array = NDArray[np.float64]
CLOSE_PX = 2.0
MARKS = 12  # along a curve at most
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One line: points (n,), its look, its name in the legend; ``std`` draws a band.

    ``points`` draws open markers alone, ``faint`` a line that stays behind.
    """

    x: Array
    y: Array
    look: Look
    name: str = ""
    std: Array | None = None
    points: bool = False
    width: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """What a pane of curves shows; ranges None are those of the curves.

    ``shade`` is a span of x that is laid over; ``marks`` are numbers on x drawn as lines.
    """

    curves: tuple[Curve, ...] = ()
    x_label: str = ""
    y_label: str = ""
    title: str = ""
    log: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    shade: tuple[float, float] | None = None
    notes: tuple[str, ...] = field(default=())
    legend: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Where the curves lie in the pane, px, and which values its edges have."""

    left: int
    top: int
    right: int
    bottom: int
    x: tuple[float, float]
    y: tuple[float, float]
    log: bool

    def at(self, x: Array, y: Array) -> Array:
        """Return points (n, 2) in the pane of values; NaN where there is no place for them."""
        low, high = self.y
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.log:
                share = (np.log10(np.where(y > 0.0, y, np.nan)) - math.log10(low)) / (
                    math.log10(high) - math.log10(low)
                )
            else:
                share = (y - low) / (high - low)
        across = (x - self.x[0]) / (self.x[1] - self.x[0])
        return np.stack(
            [
                self.left + across * (self.right - self.left),
                self.bottom - share * (self.bottom - self.top),
            ],
            axis=1,
        )

    def values(self, x: float, y: float) -> tuple[float, float]:
        """Return the values at a place in the pane."""
        across = (x - self.left) / max(self.right - self.left, 1)
        up = (self.bottom - y) / max(self.bottom - self.top, 1)
        low, high = self.y
        of_y = low * (high / low) ** up if self.log else low + up * (high - low)
        return self.x[0] + across * (self.x[1] - self.x[0]), of_y


def ranges(chart: Chart) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges that a chart shows."""
    x_range, y_range = chart.x_range, chart.y_range
    xs = [c.x for c in chart.curves if c.x.size]
    if x_range is None:
        low = min((float(x.min()) for x in xs), default=0.0)
        high = max((float(x.max()) for x in xs), default=1.0)
        x_range = (low, high if high > low else low + 1.0)
    if y_range is None:
        shown = [c.y[(c.x >= x_range[0]) & (c.x <= x_range[1])] for c in chart.curves if c.x.size]
        values = np.concatenate([*shown, np.empty(0)])
        values = values[np.isfinite(values) & ((values > 0.0) | (not chart.log))]
        if not values.size:
            y_range = (0.1, 1.0) if chart.log else (0.0, 1.0)
        elif chart.log:
            top = float(values.max())
            y_range = (max(0.5 * float(values.min()), 1e-4 * top), 2.0 * top)
        else:
            low, high = min(0.0, float(values.min())), float(values.max())
            y_range = (low, high + 0.06 * (high - low) if high > low else low + 1.0)
    return x_range, y_range


def ticks(low: float, high: float, n: int) -> list[float]:
    """Return about n round numbers inside a range."""
    if not high > low:
        return [low]
    raw = (high - low) / max(n, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1.0, 2.0, 2.5, 5.0, 10.0) if s * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def log_ticks(low: float, high: float) -> tuple[list[float], list[float]]:
    """Return the powers of ten inside a range, and the twos to nines between them."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    tens = [10.0**p for p in powers if low <= 10.0**p <= high]
    between = [m * 10.0**p for p in powers for m in range(2, 10) if low <= m * 10.0**p <= high]
    return tens, between


def tick_text(value: float, step: float) -> str:
    """Return a tick's number with the digits its step needs."""
    if value == 0.0:
        return "0"
    if abs(value) >= 1e5 or abs(step) < 1e-4:
        power = math.floor(math.log10(abs(value)))
        lead = f"{value / 10.0**power:.3g}"
        return f"{lead}·10{str(power).translate(_RAISED)}".replace("-", "−")
    decimals = max(0, -math.floor(math.log10(abs(step)) + 1e-9))
    text = (
        f"{value:.{decimals + 1}f}"
        if abs(step * 10**decimals % 1) > 1e-6
        else (f"{value:.{decimals}f}")
    )
    return text.replace("-", "−")


def power_text(value: float) -> str:
    """Return a power of ten."""
    return f"10{str(round(math.log10(value))).translate(_RAISED)}"


def dashed(points: Array, dashes: tuple[float, ...]) -> list[Array]:
    """Return a line (n, 2) cut into dashes of given lengths, px; whole if there are none."""
    finite = np.isfinite(points).all(axis=1)
    runs = np.split(points, np.flatnonzero(np.diff(finite.astype(int))) + 1)
    lines = [_thinned(run) for run in runs if run.shape[0] > 1 and np.isfinite(run).all()]
    if not dashes:
        return lines
    found = []
    for line in lines:
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        if way[-1] <= 0.0:
            continue
        ends = np.cumsum(np.tile(dashes, int(way[-1] / sum(dashes)) + 1))
        cuts = np.minimum(np.concatenate([[0.0], ends]), way[-1])
        at = np.union1d(way, cuts)
        bent = np.stack([np.interp(at, way, line[:, k]) for k in (0, 1)], axis=1)
        place = np.searchsorted(at, cuts)
        pairs = zip(place[0:-1:2], place[1::2], strict=False)
        found += [bent[begin : end + 1] for begin, end in pairs if end > begin]
    return found


def _in_sight(at: Array, size: tuple[int, int]) -> Array:
    """Return points (n, 2), NaN where neither they nor a neighbour lie in a part (width, height).

    What is far outside would be cut into dashes that nobody sees.
    """
    with np.errstate(invalid="ignore"):
        inside = np.asarray(((at >= 0.0) & (at <= np.array(size))).all(axis=1))
    near = inside.copy()
    near[1:] |= inside[:-1]
    near[:-1] |= inside[1:]
    return np.where(near[:, None], at, np.nan)


def _thinned(line: Array) -> Array:
    """Return a line without points nearer than a pixel or two, which only roughen its edge."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    _, kept = np.unique(np.floor(way / CLOSE_PX), return_index=True)
    kept[-1] = line.shape[0] - 1
    return line[kept]


def draw(picture: Rgb, chart: Chart, frame: Frame, *, scale: float, ground: str) -> None:
    """Draw bands, curves and their markers into a picture, clipped to the frame."""
    part = picture[frame.top : frame.bottom + 1, frame.left : frame.right + 1]
    corner = np.array([frame.left, frame.top])
    if chart.shade is not None:
        x = frame.at(np.array(chart.shade), np.full(2, frame.y[1]))[:, 0] - frame.left
        low, high = (int(np.clip(v, 0, part.shape[1])) for v in x)
        tint = part[:, low:high].astype(np.float32)
        tone = np.array(rgb(chart.curves[0].look[0]) if chart.curves else (128, 128, 128))
        part[:, low:high] = (0.88 * tint + 0.12 * tone).astype(np.uint8)
    limit, size = 4.0 * max(part.shape), (part.shape[1], part.shape[0])
    for curve in chart.curves:
        colour, dashes, marker = curve.look
        at = np.clip(frame.at(curve.x, curve.y) - corner, -limit, limit)
        if curve.std is not None and np.isfinite(curve.std).any():
            _band(part, curve, frame, corner, limit)
        width = max(round(curve.width * scale), 1)
        if not curve.points:
            pieces = dashed(_in_sight(at, size), tuple(d * scale for d in dashes))
            outlines(part, pieces, colour, width=width)
        inside = np.flatnonzero(
            np.isfinite(at).all(axis=1)
            & (at >= 0.0).all(axis=1)
            & (at <= np.array(size)).all(axis=1)
        )
        if marker and inside.size:
            n = 40 if curve.points else MARKS
            spread = at[inside, 0]
            wanted = np.linspace(spread.min(), spread.max(), n)
            for k in np.unique(inside[np.searchsorted(spread, wanted).clip(0, inside.size - 1)]):
                _mark(part, at[k], marker, colour, ground, 3.4 * scale, hollow=curve.points)


def _band(part: Rgb, curve: Curve, frame: Frame, corner: Array, limit: float) -> None:
    std = curve.std if curve.std is not None else np.zeros_like(curve.y)
    floor = frame.y[0] if frame.log else -np.inf
    low = frame.at(curve.x, np.maximum(curve.y - std, floor)) - corner
    high = frame.at(curve.x, curve.y + std) - corner
    whole = np.concatenate([low, high[::-1]])
    whole = whole[np.isfinite(whole).all(axis=1)]
    if whole.shape[0] > 2:
        fill(part, np.clip(whole, -limit, limit), curve.look[0], 0.25)


def _mark(
    part: Rgb, at: Array, marker: str, colour: str, ground: str, radius: float, *, hollow: bool
) -> None:
    """Draw one marker: a polygon with as many corners as its letter asks for."""
    corners, turn = {
        "o": (24, 0.0),
        "s": (4, 0.25),
        "^": (3, -0.25 * 4 / 3),
        "D": (4, 0.0),
        "v": (3, 0.25 * 4 / 3),
        "P": (5, -0.25),
    }.get(marker, (24, 0.0))
    if marker in "^v":
        turn = -0.75 if marker == "^" else 0.75
    angles = 2.0 * np.pi * np.arange(corners) / corners + 0.5 * np.pi * turn * (
        1.0 if corners == 4 else 4.0 / 3.0 if corners == 3 else 1.0
    )
    size = radius * (1.25 if corners in (3, 4) else 1.0)
    shape = at + size * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    fill(part, shape, ground if hollow else colour, 1.0)
    outline(part, shape, colour if hollow else ground, width=1)
