"""Draws calibration records: curves with what they leave, and maps."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calibration.record import Record
from labrig.reporting.drawing import BAD, BLUE, GREEN, INK, ORANGE, RED, STYLE, WIDTH_IN

Array = NDArray[np.float64]
Draw = Callable[[Record], Figure]

DISPLAY_PX = 500


def _styled(draw: Draw) -> Draw:
    @functools.wraps(draw)
    def inside(record: Record) -> Figure:
        with rc_context(STYLE):
            return draw(record)

    return inside


def _values(record: Record, name: str) -> Array:
    return np.asarray(record.arrays[name].values, dtype=np.float64)


def _figure(n: int, height: float = 3.9) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH_IN if n > 1 else 6.2, height), layout="constrained")
    return figure, list(figure.subplots(1, n, squeeze=False)[0])


@_styled
def transfer_figure(record: Record) -> Figure:
    """Draw variance against mean with the gain's line, and the departure from linearity."""
    figure, (curve, line) = _figure(2)
    t, mean, variance = (_values(record, name) for name in ("exposure", "mean", "variance"))
    fitted = _values(record, "fitted").astype(bool)
    off = 100.0 * _values(record, "deviation")
    whole = np.isfinite(off)
    gain = record.quantities["gain_dn_per_e"]
    curve.plot(
        [0.0, mean.max()],
        [0.0, gain.value * mean.max()],
        color=RED,
        lw=1.2,
        label=f"K = {gain.value:.5f} DN/e⁻",
    )
    for chosen, colour, face, label in (
        (fitted, BLUE, BLUE, "fitted"),
        (whole & ~fitted, BLUE, "none", "above 70 % of saturation"),
        (~whole, ORANGE, "none", "clipped, left out"),
    ):
        if chosen.any():
            curve.plot(
                mean[chosen], variance[chosen], "o", color=colour, mfc=face, ms=5, label=label
            )
    curve.set(
        title="(a) photon transfer",
        xlabel="mean less dark (DN)",
        ylabel="temporal variance less dark (DN²)",
    )
    curve.legend(loc="upper left")
    line.axhline(0.0, color=RED, lw=1.2)
    line.plot(1e3 * t[fitted], off[fitted], "o", color=BLUE, ms=5, label="fitted")
    rest = whole & ~fitted
    line.plot(1e3 * t[rest], off[rest], "o", color=BLUE, mfc="none", ms=5)
    offset = 1e6 * record.quantities["shutter_offset_s"].value
    line.set(
        title="(b) departure from R (t + t₀)",
        xlabel="exposure (ms)",
        ylabel="departure (%)",
        xscale="log",
    )
    line.text(0.03, 0.05, f"t₀ = {offset:.2f} µs", transform=line.transAxes)
    return figure


@_styled
def response_figure(record: Record) -> Figure:
    """Draw how far ramp or pairs are off a line, and the response fitted if there is one."""
    fitted = "linear" in record.arrays
    figure, panels = _figure(2 if fitted else 1)
    panels[0].axhline(0.0, color=RED, lw=1.2)
    if "exposure" in record.arrays:
        t, off = _values(record, "exposure"), 100.0 * _values(record, "deviation")
        panels[0].plot(1e3 * t, off, "o", color=BLUE, ms=5)
        title, label = "Departure from proportional counts", "exposure (ms)"
    else:
        period = _values(record, "pair_period")
        panels[0].plot(period, 100.0 * _values(record, "pair_closure"), "o", color=INK, mfc="none")
        after = 100.0 * _values(record, "pair_closure_fitted")
        panels[0].plot(period, after, "o", color=BLUE, ms=5)
        panels[0].legend(["light adds", "counts", "other half's response"], loc="best")
        title, label = "Pattern and inverse over white and black", "period (projector px)"
    panels[0].set(title=title, xlabel=label, ylabel="departure (%)", xscale="log")
    if fitted:
        count, linear = _values(record, "count"), _values(record, "linear")
        panels[1].plot(count, count, "--", color=INK, lw=1.0, label="linear")
        panels[1].plot(count, linear, color=BLUE, label="fitted")
        panels[1].set(
            title="Response",
            xlabel="counts of the camera (DN)",
            ylabel="linear counts (DN)",
            xlim=(0, count[-1]),
            ylim=(0, linear[-1]),
        )
        panels[1].legend(loc="upper left")
    return figure


@_styled
def dark_figure(record: Record) -> Figure:
    """Draw the dark level of every pixel, and the dark current where it is known."""
    shown = {"offset": "dark level (DN)", "current": "dark current (DN/s)"}
    names = [name for name in shown if name in record.arrays]
    figure, panels = _figure(2)
    _map(
        panels[0],
        _values(record, names[-1]),
        shown[names[-1]],
        f"(a) {shown[names[-1]].split(' (', maxsplit=1)[0]}",
    )
    _histogram(panels[1], _values(record, "offset"), "dark level (DN)", "(b) dark level")
    return figure


@_styled
def flat_figure(record: Record) -> Figure:
    """Draw the relative response of every pixel, and how it is spread."""
    figure, panels = _figure(2)
    relative = _values(record, "relative")
    _map(panels[0], relative, "relative response", "(a) response")
    _histogram(panels[1], relative, "relative response", "(b) spread of the pixels")
    return figure


@_styled
def geometry_figure(record: Record) -> Figure:
    """Draw the corners in the picture with what the plane leaves of them, and the residuals."""
    figure, (where, rest) = _figure(2)
    corners, left = _values(record, "corner_px"), _values(record, "residual_mm")
    rows, cols = record.settings["shape"]
    where.quiver(*corners.T, *left.T, angles="xy", color=RED, width=0.004)
    where.plot(*corners.T, "o", color=BLUE, ms=3)
    where.set(
        title="(a) corners; arrows show direction of residuals",
        xlim=(0, cols),
        ylim=(rows, 0),
        aspect="equal",
        xlabel="column (px)",
        ylabel="row (px)",
    )
    micron = 1e3 * left
    reach = 1.15 * float(np.abs(micron).max())
    rest.axhline(0.0, color="#9aa1a8", lw=0.8)
    rest.axvline(0.0, color="#9aa1a8", lw=0.8)
    rest.plot(*micron.T, "o", color=BLUE, ms=4)
    rest.set(
        title="(b) residual in the plane",
        xlabel="x (µm)",
        ylabel="y (µm)",
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
    )
    return figure


@_styled
def map_figure(record: Record) -> Figure:
    """Draw where the projector's columns and rows fall in the camera's picture."""
    names = [name for name in ("map_x", "map_y") if name in record.arrays]
    figure, panels = _figure(len(names))
    for panel, name in zip(panels, names, strict=True):
        axis = name[-1]
        _map(
            panel,
            _values(record, name),
            f"projector {axis} (px)",
            f"projector {axis}",
            colours="viridis",
        )
    return figure


@_styled
def contrast_figure(record: Record) -> Figure:
    """Draw the contrast of stripes against their period, and c1 against depth."""
    axes = [axis for axis in ("x", "y") if f"contrast_{axis}" in record.arrays]
    both = [bool(axes), "c1" in record.arrays]
    figure, panels = _figure(sum(both))
    if axes:
        _draw_transfer(panels[0], record, axes)
    if both[1]:
        _draw_c1(panels[-1], record)
    return figure


def _draw_transfer(panel: Axes, record: Record, axes: list[str]) -> None:
    for axis, colour in zip(axes, (BLUE, GREEN), strict=False):
        period, measured = (_values(record, f"{n}_{axis}") for n in ("period", "contrast"))
        level, reach, exponent = (
            record.quantities[f"contrast_{axis}_{name}"].value
            for name in ("level", "reach_px", "exponent")
        )
        fine = np.geomspace(period[0] / 1.5, period[-1] * 1.5, 200)
        panel.plot(fine, level * np.exp(-((reach / fine) ** exponent)), color=colour, lw=1.2)
        panel.plot(period, measured, "o", color=colour, ms=5, label=f"stripes along {axis}")
    panel.set(
        title="Contrast against period",
        xlabel="period (projector px)",
        ylabel="contrast, one if sharp",
        xscale="log",
        ylim=(0.0, 1.05),
    )
    panel.legend(loc="lower right")


def _draw_c1(panel: Axes, record: Record) -> None:
    depth, c1, fit = (_values(record, name) for name in ("c1_depth", "c1", "c1_fit"))
    panel.plot(depth, c1, ".", color=BLUE, ms=3, label="measured")
    panel.plot(depth, fit, color=RED, lw=1.4, label="ln c₁ quadratic in depth")
    panel.set(
        title="c₁ against depth",
        xlabel=f"depth ({record.arrays['c1_depth'].unit})",
        ylabel="c₁",
        ylim=(0.0, 1.15 * max(float(c1.max()), float(fit.max()))),
    )
    panel.legend(loc="lower left")


@_styled
def gamma_figure(record: Record) -> Figure:
    """Draw the projector's light against grey level."""
    figure, (panel,) = _figure(1)
    level, light = _values(record, "level"), _values(record, "light")
    fine = np.linspace(0.0, 1.0, 200)
    exponent = record.quantities["gamma"].value
    if np.isfinite(exponent):
        panel.plot(fine, fine**exponent, "--", color=INK, lw=1.0, label=f"power {exponent:.2f}")
    panel.plot(level, light, "o-", color=BLUE, ms=5, lw=1.2, label="measured, rising")
    panel.set(
        title="Gamma",
        xlabel="grey level (share of white)",
        ylabel="light (share of white)",
        xlim=(0, 1.02),
        ylim=(0, 1.05),
    )
    panel.legend(loc="upper left")
    return figure


@_styled
def leak_figure(record: Record) -> Figure:
    """Draw the light of black as a share of white."""
    figure, panels = _figure(2)
    leak = 100.0 * _values(record, "leak")
    _map(panels[0], leak, "light of black (% of white)", "(a) leak")
    _histogram(panels[1], leak[np.isfinite(leak)], "light of black (% of white)", "(b) spread")
    return figure


def _map(panel: Axes, values: Array, label: str, title: str, colours: str = "cividis") -> None:
    """Show a picture of pixels between its first and last percent, reduced to what is seen."""
    step = max(1, max(values.shape) // DISPLAY_PX)
    low, high = np.nanpercentile(values, [1.0, 99.0])
    norm = Normalize(low, high if high > low else low + 1.0)
    rows, cols = values.shape
    image = panel.imshow(
        values[::step, ::step], norm=norm, cmap=colours, extent=(0.0, cols, rows, 0.0)
    )
    panel.set_facecolor(BAD)
    panel.set(title=title, xlabel="column (px)", ylabel="row (px)")
    panel.locator_params(nbins=5)
    panel.figure.colorbar(image, ax=panel, label=label, extend="both", pad=0.02, shrink=0.8)


def _histogram(panel: Axes, values: Array, label: str, title: str) -> None:
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, [0.1, 99.9])
    room = 0.1 * (high - low) or 1.0
    counts, edges = np.histogram(finite, bins=80, range=(low - room, high + room))
    panel.stairs(counts, edges, fill=True, color="#b4bac1")
    panel.axvline(
        float(np.median(finite)), color=RED, lw=1.2, label=f"median {np.median(finite):.4g}"
    )
    panel.set(title=title, xlabel=label, ylabel="pixels")
    panel.legend(loc="upper right")


FIGURES: Mapping[str, tuple[Draw, tuple[str, ...]]] = {
    "photon-transfer": (transfer_figure, ("mean",)),
    "response": (response_figure, ("deviation", "pair_closure")),
    "dark": (dark_figure, ("offset",)),
    "flat": (flat_figure, ("relative",)),
    "geometry": (geometry_figure, ("corner_px",)),
    "map": (map_figure, ("map_x", "map_y")),
    "contrast": (contrast_figure, ("contrast_x", "contrast_y", "c1")),
    "gamma": (gamma_figure, ("level",)),
    "leak": (leak_figure, ("leak",)),
}


def all_figures(record: Record) -> dict[str, Figure]:
    """Return the figures that a record has the arrays for, by name."""
    return {
        name: draw(record)
        for name, (draw, needed) in FIGURES.items()
        if any(key in record.arrays for key in needed)
        and (name not in ("photon-transfer", "response", "flat") or name == record.kind)
    }
