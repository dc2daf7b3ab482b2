"""Draws results: pure functions from a result to a matplotlib figure, after the paper's Figs. 10-13.

The only door to matplotlib. Figures are made without pyplot, so nothing stays open and no window
system is needed.
"""

from __future__ import annotations

import base64
import functools
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from labrig import views
from labrig.results import Result
from labrig.views import DecayView, Picture

Array = NDArray[np.float64]
Draw = Callable[[Result], Figure]

DPI = 160
WIDTH_IN = 9.6
DISPLAY_PX = 640  # the longer side of a picture in a figure; more is not seen

# Okabe and Ito's colours, told apart by every kind of colour vision
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, INK, GREY = "#CC79A7", "#56B4E9", "#1b1f24", "#8b929a"
ORDERS = (
    (BLUE, "-", "o"),
    (ORANGE, (0, (6, 1.5)), "s"),
    (GREEN, (0, (4, 1.2, 1, 1.2)), "^"),
    (RED, (0, (3, 1.2)), "D"),
    (PURPLE, (0, (5, 1, 1, 1, 1, 1)), "v"),
    (SKY, (0, (1.2, 1)), "P"),
)
BAD = "#dfe3e7"  # where a picture holds nothing

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#6b727a",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#4a5159",
    "ytick.color": "#4a5159",
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.7,
    "figure.dpi": DPI,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


def _styled(draw: Draw) -> Draw:
    @functools.wraps(draw)
    def inside(result: Result) -> Figure:
        with rc_context(STYLE):
            return draw(result)

    return inside


@_styled
def separation_figure(result: Result) -> Figure:
    """Draw a captured picture, single and multiple scattering on one scale (Fig. 10)."""
    names = {
        "captured": "(a) captured, one shift",
        "single": "(b) single scattering",
        "multiple": "(c) multiple scattering",
    }
    pictures = [views.picture(result, name).reduced(DISPLAY_PX) for name in names]
    norm = Normalize(0.0, max(_brightest(picture.values) for picture in pictures))
    figure, panels = _row_of_pictures(pictures[0], bars=1)
    for panel, picture, title in zip(panels, pictures, names.values(), strict=True):
        image = _show(panel, picture, norm, "cividis")
        panel.set_title(title)
    panels[0].set_ylabel(f"y ({pictures[0].unit})")
    figure.colorbar(image, ax=panels, label="light (counts/s)", pad=0.015, aspect=24, extend="max")
    return figure


@_styled
def closure_figure(result: Result) -> Figure:
    """Draw where and how far single and multiple scattering miss the white picture."""
    gap = views.picture(result, "closure")
    percent = 100.0 * gap.values[np.isfinite(gap.values)].astype(np.float64)
    figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
    where, spread = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    where.set_title("(a) where")
    spread.set(title="(b) how much", xlabel="(single + multiple) / white − 1 (%)", ylabel="pixels")
    if percent.size == 0:
        where.text(0.5, 0.5, "no pixel is bright enough", ha="center", transform=where.transAxes)
        return figure
    part = gap.around(np.isfinite(gap.values)).reduced(DISPLAY_PX)
    shown = Picture(values=100.0 * part.values, y=part.y, x=part.x, unit=part.unit)
    image = _show(where, shown, _symmetric(shown.values), "RdBu_r")
    where.set_ylabel(f"y ({part.unit})")
    figure.colorbar(image, ax=where, label="closure (%)", extend="both", pad=0.02, shrink=0.9)
    _histogram(spread, percent)
    return figure


@_styled
def attenuation_figure(result: Result) -> Figure:
    """Draw light against depth with its exponential, unseparated and single (Fig. 11)."""
    decays = {
        title: views.decay(result, name, of=of)
        for title, name, of in (
            ("without separation", "white", "unseparated"),
            ("single scattering", "single", None),
        )
        if f"{name}_profile" in result.fields
    }
    figure = Figure(figsize=(WIDTH_IN if len(decays) > 1 else 5.8, 4.7), layout="constrained")
    panels = figure.subplots(
        2, len(decays), squeeze=False, sharex=True, sharey="row", height_ratios=(3.2, 1)
    )
    for column, (title, decay) in enumerate(decays.items()):
        letter = f"({'ab'[column]}) " if len(decays) > 1 else ""
        panels[0, column].set_title(letter + title)
        _draw_decay(panels[0, column], decay)
        _draw_misfit(panels[1, column], decay)
    panels[0, 0].set_ylabel("light (counts/s)")
    panels[1, 0].set_ylabel("residual (%)")
    _limit(panels[0, 0], panels[1, 0], list(decays.values()))
    return figure


@_styled
def bounces_figure(result: Result) -> Figure:
    """Draw the light of every bounce against depth, and the order of their peaks (Fig. 12)."""
    depth, orders = views.along_beam(result)
    total = orders.sum(axis=0)
    figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
    light, shape = figure.subplots(1, 2, sharex=True, width_ratios=(1.1, 1.0))
    for number, (order, (colour, dashes, marker)) in enumerate(
        zip(orders, ORDERS, strict=False), start=1
    ):
        at, top = views.peak(depth, order)
        line = {"color": colour, "linestyle": dashes}
        dot = {"marker": marker, "markersize": 7, "markeredgecolor": "white", "clip_on": False}
        light.plot(depth, _positive(order), **line)
        light.plot(at, top, color=colour, zorder=4, **dot)
        shape.vlines(at, 0.0, 1.0, color=colour, linewidth=0.7, alpha=0.6)
        shape.plot(depth, order / top, **line)
        shape.plot(at, 1.0, **line, **dot, zorder=4, label=f"bounce {number}, peak {at:.1f}")
    light.plot(depth, _positive(total), color=INK, linewidth=1.1, label="sum of all bounces")
    _draw_white(light, result)
    brightest = float(np.nanmax(total))
    deepest = depth[np.nan_to_num(total) > 4e-3 * brightest][-1]
    light.set(xlim=(0.0, deepest), yscale="log", ylim=(2e-3 * brightest, 1.6 * brightest))
    light.set(title="(a) light of each bounce", ylabel="light (counts/s)")
    shape.set(title="(b) each relative to its peak", ylabel="light / its peak", ylim=(0.0, 1.05))
    for panel in (light, shape):
        panel.set_xlabel(f"depth along the beam ({views.length_unit(result)})")
    figure.legend(loc="outside lower center", ncols=4, handlelength=3.2)
    return figure


@_styled
def light_field_figure(result: Result) -> Figure:
    """Draw bounces 2 to 5 as pictures with their directions as polar glyphs (Fig. 13)."""
    shown = [int(k) for k in result.fields["scattered_bounce"].values if k <= 5]
    pictures = [views.bounce_picture(result, k) for k in shown]
    lit = views.lit_part(pictures)
    parts = [picture.around(lit) for picture in pictures]
    n_cols = min(2, len(shown))
    n_rows = math.ceil(len(shown) / n_cols)
    height = n_rows * (0.38 * WIDTH_IN * min(parts[0].aspect, 1.6) + 0.4) + 0.8
    figure = Figure(figsize=(WIDTH_IN * n_cols / 2, height), layout="compressed")
    panels = figure.subplots(n_rows, n_cols, sharex=True, sharey=True, squeeze=False).flat
    left, right, bottom, top = parts[0].extent
    pitch = min(right - left, bottom - top) / 6.0
    for panel, k, part in zip(panels, shown, parts, strict=False):
        image = _show(panel, part, Normalize(0.0, _brightest(part.values)), "cividis")
        image.set_interpolation("bilinear")
        figure.colorbar(image, ax=panel, label="counts/s", pad=0.02, aspect=28, extend="max")
        panel.set_title(f"bounce {k}  ·  mean cosine to the beam {views.mean_cosine(result, k):.2f}")
        panel.set_ylabel(f"y ({part.unit})")
        panel.label_outer()
        _draw_glyphs(panel, *views.glyphs(result, k, part, pitch))
    for panel in panels[len(shown) :]:
        panel.remove()
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=1.2
    )
    return figure


@_styled
def residual_figure(result: Result) -> Figure:
    """Draw multiple scattering as measured, as the bounces explain it, and the rest (Eq. 10)."""
    measured = views.on_nodes(result, result.fields["multiple"].values)
    model = views.on_nodes(result, views.modelled_multiple(result))
    rest = views.on_nodes(result, result.fields["residual"].values)
    norm = Normalize(0.0, max(_brightest(measured.values), _brightest(model.values)))
    figure, panels = _row_of_pictures(measured, bars=2)
    titles = ("(a) multiple, measured", "(b) multiple, model", "(c) residual")
    for panel, picture, title in zip(panels, (measured, model, rest), titles, strict=True):
        panel.set_title(title)
        if picture is rest:
            image = _show(panel, picture, _symmetric(picture.values), "RdBu_r")
            figure.colorbar(image, ax=panel, label="counts/s", pad=0.03, aspect=24, extend="both")
        else:
            shared = _show(panel, picture, norm, "cividis")
    panels[0].set_ylabel(f"y ({measured.unit})")
    figure.colorbar(shared, ax=panels[:2], label="light (counts/s)", pad=0.015, aspect=24)
    return figure


FIGURES: dict[str, tuple[Draw, str]] = {
    "separation": (separation_figure, "captured"),
    "closure": (closure_figure, "closure"),
    "attenuation": (attenuation_figure, "single_profile"),
    "bounces": (bounces_figure, "fluence"),
    "light-field": (light_field_figure, "light_field"),
    "residual": (residual_figure, "residual"),
}


def all_figures(result: Result) -> dict[str, Figure]:
    """Return the figures that a result has the fields for, by name, in the paper's order."""
    return {
        name: draw(result)
        for name, (draw, needed) in FIGURES.items()
        if needed in result.fields or f"{needed}_image" in result.fields
    }


def save(figure: Figure, stem: Path) -> None:
    """Write a figure as ``stem.png`` and ``stem.pdf``."""
    stem.with_name(f"{stem.name}.png").write_bytes(png_bytes(figure))
    with rc_context(STYLE):
        # without a date the same result gives the same file
        figure.savefig(stem.with_name(f"{stem.name}.pdf"), metadata={"CreationDate": None})


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG file's bytes."""
    buffer = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def png_base64(figure: Figure) -> str:
    """Return a figure's PNG as base64 text, for a page that holds its pictures."""
    return base64.b64encode(png_bytes(figure)).decode("ascii")


def _row_of_pictures(like: Picture, *, bars: int) -> tuple[Figure, Any]:
    """Return a figure with three panels side by side, high enough for their pictures."""
    height = (WIDTH_IN - 1.2 - 0.9 * bars) / 3.0 * like.aspect + 0.85
    figure = Figure(figsize=(WIDTH_IN, min(max(height, 2.0), 8.0)), layout="compressed")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    return figure, panels


def _show(panel: Axes, picture: Picture, norm: Normalize, colours: str) -> AxesImage:
    """Show a picture with the lit face left and rows running down, axes in its unit."""
    image = panel.imshow(picture.values, norm=norm, cmap=colours, extent=picture.extent)
    panel.set(xlabel=f"depth x ({picture.unit})", facecolor=BAD)
    panel.spines[["top", "right"]].set_visible(True)
    return image


def _brightest(values: Array) -> float:
    """Return the top of a scale: the brightest but for one pixel in a thousand."""
    finite = values[np.isfinite(values)]
    top = float(np.percentile(finite, 99.9)) if finite.size else 0.0
    return top if top > 0.0 else 1.0


def _symmetric(values: Array) -> Normalize:
    finite = np.abs(values[np.isfinite(values)])
    reach = float(np.percentile(finite, 99.0)) if finite.size else 0.0
    return Normalize(-(reach or 1.0), reach or 1.0)


def _positive(values: Array) -> Array:
    """Return values fit for a logarithmic axis: NaN in place of what is not positive."""
    with np.errstate(invalid="ignore"):
        return np.where(values > 0.0, values, np.nan)


def _histogram(panel: Axes, percent: Array) -> None:
    low, middle, high = np.percentile(percent, [16, 50, 84])
    mean = float(percent.mean())
    reach = max(abs(mean), *np.abs(np.percentile(percent, [0.5, 99.5])), 1e-9)
    panel.hist(percent, bins=np.linspace(-reach, reach, 81), color=GREY, alpha=0.55)
    panel.axvspan(low, high, color=SKY, alpha=0.25, lw=0, label=f"16–84 %: {low:+.2f} to {high:+.2f} %")
    panel.axvline(mean, color=RED, label=f"mean {mean:+.2f} %")
    panel.axvline(middle, color=BLUE, linestyle="--", label=f"median {middle:+.2f} %")
    panel.set(xlim=(-reach, reach))
    panel.legend(loc="upper left", fontsize=8.5)


def _draw_decay(panel: Axes, decay: DecayView) -> None:
    low, high = decay.fitted
    value, std = decay.value, decay.std
    if decay.sigma_t:
        panel.axvspan(low, high, color=SKY, alpha=0.13, lw=0, label="fitted depths")
    panel.fill_between(
        decay.depth, _positive(value - std), _positive(value + std), color=BLUE, alpha=0.3, lw=0
    )
    panel.plot(decay.depth, _positive(value), color=BLUE, label="measured, ±1 std")
    panel.set_yscale("log")
    text = "no exponential was fitted"
    if decay.sigma_t:
        panel.plot(decay.depth, _positive(decay.fit), "--", color=RED, lw=1.4, label="exponential")
        text = rf"$\sigma_t$ = {decay.sigma_t} {decay.unit}$^{{-1}}$"
        if decay.rms_relative is not None:
            text += f"\nrms residual {100.0 * decay.rms_relative:.2g} %"
    panel.legend(
        loc="upper right", title=text, title_fontsize=10, alignment="left", borderaxespad=0.2
    )


def _draw_misfit(panel: Axes, decay: DecayView) -> None:
    misfit = np.where(decay.inside, decay.misfit_percent, np.nan)
    band = 100.0 * decay.std / np.where(decay.fit > 0.0, decay.fit, np.nan)
    panel.axhline(0.0, color=RED, linestyle="--", linewidth=1.2)
    panel.fill_between(decay.depth, misfit - band, misfit + band, color=BLUE, alpha=0.3, lw=0)
    panel.plot(decay.depth, misfit, color=BLUE, linewidth=1.2)
    panel.set_xlabel(f"depth along the beam ({decay.unit})")


def _limit(light: Axes, rest: Axes, decays: list[DecayView]) -> None:
    """Limit shared axes to the fitted depths and a little more, residuals symmetrically."""
    deepest = max(decay.fitted[1] for decay in decays)
    light.set_xlim(0.0, min(1.3 * deepest, max(float(decay.depth[-1]) for decay in decays)))
    lit = np.concatenate([decay.value[decay.inside & (decay.value > 0.0)] for decay in decays])
    if lit.size:
        light.set_ylim(0.4 * lit.min(), 2.0 * lit.max())
    misfits = np.concatenate([decay.misfit_percent[decay.inside] for decay in decays])
    finite = np.abs(misfits[np.isfinite(misfits)])
    reach = 1.15 * float(finite.max()) if finite.size else 0.0
    rest.set_ylim(-(reach or 1.0), reach or 1.0)


def _draw_white(panel: Axes, result: Result) -> None:
    """Draw the measured light without separation as points, few enough to be told apart."""
    if "white_profile" not in result.fields:
        return
    depth, value = (result.fields[name].values for name in ("white_depth", "white_profile"))
    step = max(1, depth.size // 70)
    panel.plot(
        depth[::step],
        _positive(value[::step]),
        linestyle="none",
        marker="o",
        markersize=4.2,
        markerfacecolor="none",
        color=INK,
        label="measured, white light",
    )


def _draw_glyphs(panel: Axes, points: Array, outlines: list[Array]) -> None:
    for colour, width in ((INK, 2.2), ("white", 1.2)):
        panel.add_collection(
            PolyCollection(
                outlines,
                facecolors="none" if colour == INK else (1, 1, 1, 0.16),
                edgecolors=colour,
                linewidths=width,
                label="" if colour == INK else "radiance by direction / its maximum",
            )
        )
    x, y = points.T
    panel.scatter(x, y, marker="+", s=34, color=INK, linewidths=2.6, zorder=3)
    panel.scatter(
        x, y, marker="+", s=28, color="#ff7f6b", linewidths=1.4, zorder=3, label="sampling point"
    )
