"""What figures and report show of a result, as arrays and text; nothing is drawn here."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from labrig.results import Result

Array = NDArray[np.float64]

BEAM_MARGIN = 0.05  # share of the beam left out at each edge, as in the measured profiles
LIT_SHARE = 0.08  # pictures on the solver's nodes are shown where they are as bright as this
GLYPH_REACH = 0.48  # of the distance between sampling points
FINER = 8  # points of a curve per node
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


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


def modelled_multiple(result: Result) -> Array:
    """Return the light of bounces two and up in camera units, (n_y, n_x) (Eq. 10)."""
    scattered = result.fields["bounce"].values >= 2
    total = result.fields["fluence"].values[scattered].sum(axis=0)
    return np.asarray(scale_c(result) * total)


def scale_c(result: Result) -> float:
    """Return the factor c that turns fluence into camera units."""
    return float(result.attributes["scale_c"])


def decay(result: Result, name: str, *, of: str | None) -> DecayView:
    """Return the light of a profile, ``single`` or ``white``, and its exponential.

    Parameters
    ----------
    of : the alternative whose extinction this is; None for the chosen one
    """
    depth, value, std, fit = (
        result.fields[f"{name}_{what}"].values
        for what in ("depth", "profile", "profile_std", "profile_fit")
    )
    unit, run = length_unit(result), result.run
    found = (run if of is None else run.get("alternatives", {}).get(of, {})).get(
        f"sigma_t_per_{unit}"
    )
    quality = run.get("quality", {}).get("attenuation" if of is None else f"attenuation_{of}", {})
    whole = (float(depth[0]), float(depth[-1]))
    low, high = quality.get("depth_range", whole)
    return DecayView(
        depth=depth,
        value=value,
        std=std,
        fit=fit,
        fitted=(float(low), float(high)),
        sigma_t="" if found is None else with_std(found["value"], found["std"]),
        rms_relative=quality.get("rms_relative"),
        unit=unit,
    )


def along_beam(result: Result) -> tuple[Array, Array]:
    """Return depths (n,), and the light of every bounce (K, n) averaged across the beam.

    Depth and rows are those of the measured profiles: a slanted beam is followed, its depth is
    the path, and ends where the beam leaves the tank. A cubic spline joins the solver's nodes.
    """
    y, x = (result.fields[axis].values for axis in ("y", "x"))
    start, end, angle = (
        float(result.attributes[name]) for name in ("beam_from", "beam_to", "beam_angle_rad")
    )
    entry = y[:, None] - x[None, :] * math.tan(angle)
    margin = BEAM_MARGIN * (end - start)
    inside = (entry > start + margin) & (entry < end - margin)
    if not inside[:, 0].any():  # a beam narrower than a node: its nearest row
        inside = np.abs(entry - 0.5 * (start + end)) <= 0.5 * (y[1] - y[0])
    rows = inside.sum(axis=0)
    held = int(np.argmin(rows > 0)) if (rows == 0).any() else rows.size
    total = np.where(inside, result.fields["fluence"].values, 0.0).sum(axis=1)
    depth = x[:held] / math.cos(angle)
    fine = np.linspace(depth[0], depth[-1], FINER * (held - 1) + 1)
    spline = make_interp_spline(depth, total[:, :held] / rows[:held], k=min(3, held - 1), axis=1)
    return fine, scale_c(result) * np.asarray(spline(fine))


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


def lit_part(pictures: list[Picture]) -> NDArray[np.bool_]:
    """Return where any of the pictures is bright enough to be worth a look, (rows, cols)."""
    return np.any([p.values > LIT_SHARE * p.values.max() for p in pictures], axis=0)


def glyphs(result: Result, bounce: int, part: Picture, pitch: float) -> tuple[Array, list[Array]]:
    """Return sampling points (n, 2) as x, y on a coarse grid in a part, and the glyph of each.

    Points without light have no glyph and are left out.
    """
    theta, light = result.fields["theta"].values, _radiance(result, bounce)
    left, right, bottom, top = part.extent
    middle = 0.5 * (float(result.attributes["beam_from"]) + float(result.attributes["beam_to"]))
    rows = _coarse(middle, pitch, top, bottom, result.fields["y"].values)
    cols = _coarse(left + 0.5 * pitch, pitch, left, right, result.fields["x"].values)
    points, outlines = [], []
    for row in rows:
        for col in cols:
            radiance = light[row, col].astype(np.float64)
            if not radiance.max() > 0.0:
                continue
            at = (float(result.fields["x"].values[col]), float(result.fields["y"].values[row]))
            points.append(at)
            outlines.append(glyph(theta, radiance, at, GLYPH_REACH * pitch))
    return np.array(points).reshape(-1, 2), outlines


def with_std(value: float, std: float | None) -> str:
    """Return ``value ± std`` with the digits that the standard deviation deserves.

    Two digits of the std where it begins with 1 or 2, else one; four significant digits of the
    value and a dash where it is unknown.
    """
    size = max(abs(value), std or 0.0)
    power = math.floor(math.log10(size)) if size > 0.0 else 0
    if not -4 <= power < 6:
        scaled = with_std(value / 10.0**power, None if std is None else std / 10.0**power)
        return f"({scaled})·10{str(power).translate(RAISED)}"
    if not std or not math.isfinite(std):
        return f"{value:.4g} ± —".replace("-", "−")
    first = math.floor(math.log10(std))
    decimals = max(0, -first + (1 if std / 10.0**first < 2.95 else 0))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}".replace("-", "−")


def _radiance(result: Result, bounce: int) -> NDArray[np.float32]:
    place = int(np.flatnonzero(result.fields["scattered_bounce"].values == bounce)[0])
    return np.asarray(result.fields["light_field"].values[place])


def _coarse(start: float, pitch: float, low: float, high: float, nodes: Array) -> list[int]:
    """Return the nodes nearest to ``start + n pitch``, a glyph's radius off the edges."""
    first = math.ceil((low + 0.5 * pitch - start) / pitch - 1e-6)
    last = math.floor((high - 0.5 * pitch - start) / pitch + 1e-6)
    return [int(np.abs(nodes - (start + n * pitch)).argmin()) for n in range(first, last + 1)]
