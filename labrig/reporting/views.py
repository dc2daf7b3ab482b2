"""What figures and report show of a result, as arrays and text; nothing is drawn here."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from labrig.results import Result

Array = NDArray[np.float64]

UNKNOWN = "—"
BEAM_MARGIN = 0.05  # share of the beam left out at each edge, as in the measured profiles
LIT_SHARE = 0.08  # pictures on the solver's nodes are shown where they are as bright as this
GLYPH_REACH = 0.47  # of the distance between sampling points
LINES = 32  # lines across the beam that are averaged
FINER = 8  # points of a curve per node
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture (rows, cols) and where it lies: rows along y, columns into the depth x."""

    values: Array
    y: Array
    x: Array
    unit: str

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge; y grows downwards as in the camera's picture."""
        half_x, half_y = (float(a[1] - a[0]) / 2 if a.size > 1 else 0.5 for a in (self.x, self.y))
        left, right = float(self.x[0]) - half_x, float(self.x[-1]) + half_x
        return left, right, float(self.y[-1]) + half_y, float(self.y[0]) - half_y

    @property
    def aspect(self) -> float:
        """Height over width."""
        left, right, bottom, top = self.extent
        return (bottom - top) / (right - left)

    def reduced(self, limit_px: int) -> Picture:
        """Return the means of square blocks, NaN left out, so that no side exceeds the limit."""
        step = math.ceil(max(self.values.shape) / limit_px)
        if step <= 1 or min(self.values.shape) < step:
            return self
        rows, cols = (n // step for n in self.values.shape)
        cut = self.values[: rows * step, : cols * step].reshape(rows, step, cols, step)
        finite = np.isfinite(cut)
        with np.errstate(invalid="ignore"):
            mean = np.where(finite, cut, 0.0).sum(axis=(1, 3)) / finite.sum(axis=(1, 3))
        return Picture(
            values=mean,
            y=self.y[: rows * step].reshape(rows, step).mean(axis=1),
            x=self.x[: cols * step].reshape(cols, step).mean(axis=1),
            unit=self.unit,
        )

    def around(self, wanted: NDArray[np.bool_]) -> Picture:
        """Return the smallest part that holds all wanted pixels; everything if none is."""
        rows, cols = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
        if not rows.size:
            return self
        y, x = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        return Picture(values=self.values[y, x], y=self.y[y], x=self.x[x], unit=self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecayView:
    """Light against depth with its exponential; ``fit`` is NaN where there is none.

    Attributes
    ----------
    fitted : first and last depth of the fit; of all depths if there is none
    sigma_t : as text, empty if there is no fit
    rms_relative : rms residual as a share of the fit, None if there is no fit
    """

    title: str
    depth: Array
    value: Array
    std: Array
    fit: Array
    fitted: tuple[float, float]
    sigma_t: str
    rms_relative: float | None
    unit: str

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Depths that were fitted."""
        low, high = self.fitted
        return np.asarray((self.depth >= low) & (self.depth <= high))

    @property
    def misfit_percent(self) -> Array:
        """Measured less fitted as a share of the fit."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * (self.value / self.fit - 1.0))


def length_unit(result: Result) -> str:
    """Return "mm", or "px" where the scale of the pictures is unknown."""
    return str(result.attributes.get("length_unit", result.run.get("length_unit", "px")))


def picture(result: Result, name: str) -> Picture:
    """Return a picture in full resolution, whether the run stopped after separation or not."""
    field = result.fields.get(f"{name}_image") or result.fields[name]
    return Picture(
        values=field.values,
        y=result.fields[field.dims[0]].values,
        x=result.fields[field.dims[1]].values,
        unit=length_unit(result),
    )


def on_nodes(result: Result, values: Array) -> Picture:
    """Return an array of the solver's nodes, (n_y, n_x), as a picture."""
    y, x = (result.fields[axis].values for axis in ("y", "x"))
    return Picture(values=values, y=y, x=x, unit=length_unit(result))


def bounce_picture(result: Result, bounce: int) -> Picture:
    """Return the light of one bounce in camera units, c phi_k."""
    place = int(np.flatnonzero(result.fields["bounce"].values == bounce)[0])
    return on_nodes(result, scale_c(result) * result.fields["fluence"].values[place])


def scale_c(result: Result) -> float:
    """Return the factor c that turns fluence into camera units."""
    return float(result.attributes["scale_c"])


def decays(result: Result) -> list[DecayView]:
    """Return the light against depth that was measured, with its exponential (Fig. 11)."""
    return [
        _decay(result, name, title, of)
        for name, title, of in (
            ("white", "without separation", "unseparated"),
            ("single", "single scattering", "separated"),
        )
        if f"{name}_profile" in result.fields
    ]


def along_beam(result: Result) -> tuple[Array, Array]:
    """Return depths (n,), and the light of every bounce (K, n) averaged across the beam, counts/s.

    As `followed` does.
    """
    y, x = (result.fields[axis].values for axis in ("y", "x"))
    start, end, angle = (
        float(result.attributes[name]) for name in ("beam_from", "beam_to", "beam_angle_rad")
    )
    fluence = result.fields["fluence"].values
    depth, light = followed(fluence, x=x, y=y, rows=(start, end), angle_rad=angle)
    return depth, scale_c(result) * light


def followed(
    fluence: Array, *, x: Array, y: Array, rows: tuple[float, float], angle_rad: float
) -> tuple[Array, Array]:
    """Return depths (n,), and the light (K, n) of fields (K, n_y, n_x) averaged across a beam.

    Depth and rows are those of the measured profiles: a slanted beam is followed, its depth is
    the path, and ends where the beam leaves the tank. A cubic spline joins the solver's nodes.

    Parameters
    ----------
    rows : where the beam enters, from and to
    """
    start, end = rows
    margin = BEAM_MARGIN * (end - start)
    entry = np.linspace(start + margin, end - margin, LINES)[:, None]
    row = (entry + x * math.tan(angle_rad) - y[0]) / (y[1] - y[0])  # (lines, n_x), in nodes
    inside = (row >= 0.0) & (row <= y.size - 1)
    below = np.clip(row.astype(np.int64), 0, y.size - 2)
    share = np.clip(row - below, 0.0, 1.0)
    column = np.arange(x.size)
    line = (1.0 - share) * fluence[:, below, column] + share * fluence[:, below + 1, column]
    held = int(inside.any(axis=0).cumprod().sum())
    total = np.where(inside, line, 0.0).sum(axis=1)[:, :held] / inside.sum(axis=0)[:held]
    depth = x[:held] / math.cos(angle_rad)
    fine = np.linspace(depth[0], depth[-1], FINER * (held - 1) + 1)
    spline = make_interp_spline(depth, total, k=min(3, held - 1), axis=1)
    return fine, np.asarray(spline(fine))


def glyph(theta: Array, radiance: Array, centre: tuple[float, float], radius: float) -> Array:
    """Return the outline (n_theta, 2) whose distance from ``centre`` follows the radiance.

    The brightest direction reaches ``radius``; theta runs from +x towards increasing y.
    """
    reach = radius * np.maximum(radiance, 0.0) / radiance.max()
    x, y = centre
    return np.stack([x + reach * np.cos(theta), y + reach * np.sin(theta)], axis=1)


def mean_cosine(result: Result, bounce: int) -> float:
    """Return the mean cosine between the beam and the light of a bounce; zero: no direction."""
    light = _radiance(result, bounce).sum(axis=(0, 1), dtype=np.float64)
    to_beam = result.fields["theta"].values - float(result.attributes["beam_angle_rad"])
    return float((light * np.cos(to_beam)).sum() / light.sum()) if light.sum() > 0.0 else 0.0


def lit_part(pictures: list[Picture], *, squarish: bool = False) -> NDArray[np.bool_]:
    """Return where any of the pictures is bright enough to be worth a look, (rows, cols).

    Parameters
    ----------
    squarish : go deeper until the part is nearly as wide as it is high
    """
    lit = np.any([p.values > LIT_SHARE * np.nanmax(p.values) for p in pictures], axis=0)
    if squarish and lit.any():
        part, x = pictures[0].around(lit), pictures[0].x
        _, _, bottom, top = part.extent
        lit[:, (x >= part.x[0]) & (x <= part.x[0] + 0.9 * (bottom - top))] |= lit.any(axis=1)[
            :, None
        ]
    return np.asarray(lit)


def glyphs(result: Result, bounce: int, part: Picture, pitch: float) -> tuple[Array, list[Array]]:
    """Return sampling points (n, 2) as x, y on a coarse grid in a part, and the glyph of each.

    Points without light have no glyph and are left out.
    """
    theta, light = result.fields["theta"].values, _radiance(result, bounce)
    x, y = result.fields["x"].values, result.fields["y"].values
    middle = 0.5 * (float(result.attributes["beam_from"]) + float(result.attributes["beam_to"]))
    left, right, bottom, top = part.extent
    rows = _coarse(y, middle, pitch, (top, bottom))
    cols = _coarse(x, left + 0.55 * pitch, pitch, (left, right))
    points, outlines = [], []
    for row in rows:
        for col in cols:
            radiance = light[row, col].astype(np.float64)
            if not radiance.max() > 0.0:
                continue
            at = (float(x[col]), float(y[row]))
            points.append(at)
            outlines.append(glyph(theta, radiance, at, GLYPH_REACH * pitch))
    return np.array(points).reshape(-1, 2), outlines


def with_std(value: float, std: float | None) -> str:
    """Return ``value ± std`` with the digits that the standard deviation deserves.

    Two digits of the std where it begins with 1 or 2, else one; four significant digits of the
    value and a dash where it is unknown.
    """
    std = std if std and math.isfinite(std) else None
    size = max(abs(value), std or 0.0)
    power = math.floor(math.log10(size)) if size > 0.0 else 0
    if not -4 <= power < 6:
        scaled = with_std(value / 10.0**power, None if std is None else std / 10.0**power)
        return f"({scaled})·10{str(power).translate(_RAISED)}"
    if std is None:
        return f"{value:.4g} ± —".replace("-", "−")
    first = math.floor(math.log10(std))
    decimals = max(0, -first + (1 if std / 10.0**first < 2.95 else 0))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}".replace("-", "−")


def positive(values: Array) -> Array:
    """Return values fit for a logarithmic axis: NaN in place of what is not positive."""
    with np.errstate(invalid="ignore"):
        return np.where(values > 0.0, values, np.nan)


def brightest(values: Array) -> float:
    """Return the top of a scale: the brightest but for one pixel in a thousand."""
    finite = values[np.isfinite(values)]
    top = float(np.percentile(finite, 99.9)) if finite.size else 0.0
    return top if top > 0.0 else 1.0


def reach(values: Array, share: float = 99.0) -> float:
    """Return the end of a symmetric scale that holds ``share`` percent of the values."""
    finite = np.abs(values[np.isfinite(values)])
    return (float(np.percentile(finite, share)) if finite.size else 0.0) or 1.0


def root_ticks(top: float) -> list[float]:
    """Return round values that a square-root scale spaces about evenly."""
    shares = [top * (n / 5.0) ** 2 for n in range(1, 6)]
    return [0.0, *(float(f"{share:.1g}") for share in shares)]


def power_of_ten(value: float, _position: int | None = None) -> str:
    """Return 1, 2 or 5 times a power of ten as plain text."""
    power = math.floor(math.log10(value) + 1e-9)
    lead = round(value / 10.0**power)
    return ("" if lead == 1 else f"{lead}·") + f"10{str(power).translate(_RAISED)}"


def _decay(result: Result, name: str, title: str, of: str) -> DecayView:
    """Return a profile and its fit; ``of`` names the alternative it belongs to."""
    depth, value, std, fit = (
        result.fields[f"{name}_{what}"].values
        for what in ("depth", "profile", "profile_std", "profile_fit")
    )
    unit, run = length_unit(result), result.run
    holder = run.get("alternatives", {}).get(of, {})
    found = holder.get(f"sigma_t_per_{unit}")
    key = "attenuation" if of == "separated" else f"attenuation_{of}"
    quality = run.get("quality", {}).get(key, {})
    low, high = quality.get("depth_range", (depth[0], depth[-1]))
    return DecayView(
        title=title,
        depth=depth,
        value=value,
        std=std,
        fit=fit,
        fitted=(float(low), float(high)),
        sigma_t="" if found is None else with_std(found["value"], found["std"]),
        rms_relative=quality.get("rms_relative"),
        unit=unit,
    )


def _radiance(result: Result, bounce: int) -> NDArray[np.float32]:
    place = int(np.flatnonzero(result.fields["scattered_bounce"].values == bounce)[0])
    return np.asarray(result.fields["light_field"].values[place])


def _coarse(nodes: Array, start: float, pitch: float, limits: tuple[float, float]) -> list[int]:
    """Return evenly spaced nodes through ``start``, most of a glyph's radius off the limits."""
    step = max(1, round(pitch / float(nodes[1] - nodes[0])))
    first = int(np.abs(nodes - start).argmin()) % step
    low, high = limits[0] + 0.45 * pitch, limits[1] - 0.45 * pitch
    return [n for n in range(first, nodes.size, step) if low <= nodes[n] <= high]
