"""Draws results: pure functions from a result to a figure, after Figs. 10 to 13 of the paper."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from labrig.accuracy.costs import Costs, Run
from labrig.reporting import views
from labrig.reporting.drawing import (
    BAD,
    BLUE,
    GREEN,
    INK,
    ORANGE,
    ORDERS,
    PURPLE,
    RED,
    SKY,
    STYLE,
    WIDTH_IN,
    bar,
    logarithmic,
    show,
    side_by_side,
)
from labrig.reporting.views import Array, DecayView, Picture
from labrig.results import Result

Draw = Callable[[Result], Figure]

DISPLAY_PX = 640  # the longer side of a picture in a figure; more is not seen
CLOSURE_PX = 160  # averaged further: a bias shows only below the noise of a pixel

METHODS = {  # of the cost of accuracy: colour, marker and its size
    "exhaustive without self cell": (PURPLE, "v", 6.5),
    "exhaustive with self cell": (ORANGE, "^", 6.5),
    "montecarlo": (GREEN, "s", 6.0),
    "ordinates": (SKY, "o", 4.5),
    "ordinates, order 2 apart": (BLUE, "o", 4.5),
    "ordinates, order 2 finer": (BLUE, "s", 3.5),
}
CROSS = "#ff7a66"  # a red that is bright enough for the dark end of cividis
FAINTEST = 1e-6  # of all the light: bounces below are not drawn


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
    # the square root shows the weak light beside the beam, which a linear scale swallows
    top = max(views.brightest(picture.values) for picture in pictures)
    norm = PowerNorm(0.5, 0.0, top, clip=True)
    figure, panels = side_by_side(pictures[0], 3, bars=(False, False, True))
    for panel, picture, title in zip(panels, pictures, names.values(), strict=True):
        image = show(panel, picture, norm)
        panel.set_title(title)
    bar(figure, panels[-1], image, "counts/s, square-root scale", ticks=views.root_ticks(top))
    return figure


@_styled
def closure_figure(result: Result) -> Figure:
    """Draw where and how far single and multiple scattering miss the white picture."""
    gap = views.picture(result, "closure")
    percent = 100.0 * gap.values[np.isfinite(gap.values)].astype(np.float64)
    part = gap.around(np.isfinite(gap.values)).reduced(CLOSURE_PX)
    width = min(2.9 / part.aspect, 3.4)
    figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
    where, spread = figure.subplots(1, 2, width_ratios=(width, WIDTH_IN - 2.5 - width))
    where.set(title="(a) where", xlabel=f"depth x ({part.unit})", ylabel=f"y ({part.unit})")
    spread.set(title="(b) how much", xlabel="(single + multiple) / white − 1 (%)", ylabel="pixels")
    if percent.size == 0:
        where.text(0.5, 0.5, "no pixel is bright enough", ha="center", transform=where.transAxes)
        return figure
    shown = Picture(values=100.0 * part.values, y=part.y, x=part.x, unit=part.unit)
    image = show(where, shown)
    figure.colorbar(image, ax=where, label="closure (%)", extend="both", pad=0.02, shrink=0.9)
    _histogram(spread, percent)
    return figure


@_styled
def attenuation_figure(result: Result) -> Figure:
    """Draw light against depth with its exponential, unseparated and single (Fig. 11)."""
    decays = views.decays(result)
    n = len(decays)
    figure = Figure(figsize=(WIDTH_IN if n > 1 else 5.8, 4.7), layout="constrained")
    panels = figure.subplots(2, n, squeeze=False, sharex=True, sharey="row", height_ratios=(3.2, 1))
    for column, decay in enumerate(decays):
        letter = f"({'ab'[column]}) " if n > 1 else ""
        panels[0, column].set_title(letter + decay.title)
        _draw_decay(panels[0, column], decay)
        _draw_misfit(panels[1, column], decay)
    panels[0, 0].set_ylabel("light (counts/s)")
    panels[1, 0].set_ylabel("residual (%)")
    _limit(panels[0, 0], panels[1, 0], decays)
    return figure


@_styled
def bounces_figure(result: Result) -> Figure:
    """Draw the light of every bounce against depth, and the order of their peaks (Fig. 12)."""
    depth, orders = views.along_beam(result)
    unit, total = views.length_unit(result), orders.sum(axis=0)
    brightest = float(total.max())
    figure = Figure(figsize=(WIDTH_IN, 4.7), layout="constrained")
    light, shape = figure.subplots(1, 2, sharex=True, width_ratios=(1.1, 1.0))
    lowest = 2e-3 * brightest
    for number, (order, look) in enumerate(zip(orders, ORDERS, strict=False), start=1):
        if order.max() > FAINTEST * brightest:
            _draw_order(light, shape, depth, order, look, f"bounce {number}, peak {{:.1f}} {unit}")
            lowest = min(lowest, 0.4 * float(order.max()))
    light.plot(depth, views.positive(total), color=INK, linewidth=1.1, label="sum of all bounces")
    _draw_white(light, result)
    light.set_xlim(0.0, depth[total >= 4e-3 * brightest][-1])
    logarithmic(light, lowest, 1.6 * brightest)
    light.set(title="(a) light of each bounce", ylabel="light (counts/s)")
    shape.set(title="(b) each relative to its peak", ylabel="light / its peak", ylim=(0.0, 1.05))
    for panel in (light, shape):
        panel.set_xlabel(f"depth along the beam ({unit})")
    keys = [key for panel in (shape, light) for key in panel.get_legend_handles_labels()[0]]
    figure.legend(handles=keys, loc="outside lower center", ncols=4, handlelength=3.2)
    return figure


@_styled
def light_field_figure(result: Result) -> Figure:
    """Draw bounces 2 to 5 as pictures with their directions as polar glyphs (Fig. 13)."""
    shown = [int(k) for k in result.fields["scattered_bounce"].values if k <= 5]
    pictures = [views.bounce_picture(result, k) for k in shown]
    lit = views.lit_part(pictures, squarish=True)
    parts = [picture.around(lit) for picture in pictures]
    left, right, bottom, top = parts[0].extent
    pitch = min(right - left, bottom - top) / 5.0
    figure, panels = side_by_side(parts[0], len(shown), bars=(True, True), foot_in=0.32)
    for panel, k, part in zip(panels, shown, parts, strict=True):
        image = show(panel, part, Normalize(0.0, views.brightest(part.values)))
        image.set_interpolation("bilinear")
        bar(figure, panel, image, "light (counts/s)", ticks=MaxNLocator(5))
        panel.set_title(f"bounce {k}: mean cosine to the beam {views.mean_cosine(result, k):.2f}")
        _draw_glyphs(panel, *views.glyphs(result, k, part, pitch))
        panel.set(xlim=(left, right), ylim=(bottom, top))
    keys = panels[0].get_legend_handles_labels()
    figure.legend(*keys, loc="lower center", ncols=2, columnspacing=3.0)
    return figure


@_styled
def residual_figure(result: Result) -> Figure:
    """Draw multiple scattering as measured, as the bounces explain it, and the rest (Eq. 10)."""
    return _explained(
        result,
        ("multiple", "residual"),
        ("(a) multiple, measured", "(b) multiple, Eq. 10", "(c) residual, (a) − (b)"),
    )


@_styled
def remainder_figure(result: Result) -> Figure:
    """Draw white light as measured, as all bounces of the medium found explain it, and the rest."""
    return _explained(
        result,
        ("lit", "remainder"),
        ("(a) white light, measured", "(b) all bounces", "(c) remainder, (a) − (b)"),
    )


def _explained(result: Result, names: tuple[str, str], titles: tuple[str, str, str]) -> Figure:
    light, left = (result.fields[name].values for name in names)
    model = np.where(np.isfinite(left), light - left, 0.0)
    pictures = [views.on_nodes(result, values) for values in (light, model, left)]
    lit = views.lit_part(pictures[:2])
    measured, explained, rest = (picture.around(lit) for picture in pictures)
    top = max(views.brightest(picture.values) for picture in (measured, explained))
    norm = Normalize(0.0, top)
    figure, panels = side_by_side(measured, 3, bars=(False, True, True))
    show(panels[0], measured, norm)
    bar(figure, panels[1], show(panels[1], explained, norm), "light (counts/s)")
    bar(figure, panels[2], show(panels[2], rest), "light (counts/s)", extend="both")
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title)
    return figure


def cost_figure(costs: Costs) -> Figure:
    """Draw error against CPU seconds of every method, the front, and the automatic choices."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 5.6), layout="constrained")
        panel = figure.subplots()
        panel.grid(color="#e8ebee", linewidth=0.8)
        for method, (colour, marker, size) in METHODS.items():
            points = [run for run in costs.runs if run.method == method]
            _draw_runs(panel, points, marker, ms=size, color=colour, mec="white", mew=0.5)
        front = [run for run in costs.runs if run.on_front]
        _draw_runs(panel, front, "-", color=INK, lw=1.2, zorder=1.5, label="Pareto front")
        chosen = [run for run in costs.runs if run.tolerance is not None]
        looks = {"ms": 17, "color": RED, "mec": "white", "mew": 1.0, "zorder": 5}
        _draw_runs(panel, chosen, "*", **looks, label="automatic choice")
        for tolerance in [run.tolerance for run in chosen if run.tolerance is not None]:
            panel.axhline(tolerance, color=RED, lw=0.9, linestyle=(0, (4, 3)), zorder=1)
            text = f" asked {views.power_of_ten(tolerance)}"
            across = panel.get_yaxis_transform()
            panel.text(0.0, 1.08 * tolerance, text, color=RED, transform=across)
        errors, times = ([getattr(run, name) for run in costs.runs] for name in ("error", "cpu_s"))
        logarithmic(panel, 0.5 * min(*errors, costs.truth_error), 1.6 * max(errors))
        known: dict[str, Any] = {
            "color": BAD,
            "lw": 0,
            "zorder": 0,
            "label": "below what the truth is known to",
        }
        panel.axhspan(0.1 * min(errors), costs.truth_error, **known)
        panel.set(xscale="log", xlim=(0.6 * min(times), 2.2 * max(times)))
        panel.xaxis.set_major_formatter(FuncFormatter(views.power_of_ten))
        panel.set_title(f"what accuracy costs: {costs.scene}, orders 2 to {costs.orders}")
        panel.set(xlabel="CPU seconds", ylabel="relative rms error of the worst order")
        figure.legend(loc="outside lower center", ncols=4)
        return figure


def _draw_runs(panel: Axes, runs: list[Run], look: str, **looks: Any) -> None:
    if runs:
        looks = {"label": runs[0].method, **looks}
        panel.plot([run.cpu_s for run in runs], [run.error for run in runs], look, **looks)


def _histogram(panel: Axes, percent: Array) -> None:
    low, middle, high = (float(v) for v in np.percentile(percent, [16, 50, 84]))
    mean, reach = float(percent.mean()), views.reach(percent)
    counts, edges = np.histogram(percent, bins=80, range=(-reach, reach))
    panel.stairs(counts, edges, fill=True, color="#b4bac1")
    text = [f"{value:+.2g}".replace("-", "−") for value in (mean, middle, low, high)]
    panel.axvline(mean, 0.0, 0.8, color=RED, label=f"mean {text[0]} %")
    panel.axvline(middle, 0.0, 0.8, color=BLUE, dashes=(3, 2), label=f"median {text[1]} %")
    label = f"16–84 %: {text[2]} to {text[3]} %"
    panel.axvspan(low, high, 0.0, 0.8, color=SKY, alpha=0.3, linewidth=0, label=label)
    panel.set(xlim=(-reach, reach), ylim=(0.0, max(float(counts.max()), 1.0) / 0.77))
    panel.legend(loc="upper center", ncols=2, columnspacing=1.2, handlelength=1.4)


def _draw_decay(panel: Axes, decay: DecayView) -> None:
    depth, value = decay.depth, decay.value
    if decay.sigma_t:
        panel.axvspan(*decay.fitted, color=SKY, alpha=0.13, lw=0, label="fitted depths")
    below, above = (views.positive(value + sign * decay.std) for sign in (-1.0, 1.0))
    panel.fill_between(depth, below, above, color=BLUE, alpha=0.3, lw=0)
    name = "measured, ±1 std" if np.isfinite(decay.std).any() else "measured, std unknown"
    panel.plot(depth, views.positive(value), color=BLUE, label=name)
    text = "no exponential was fitted"
    if decay.sigma_t:
        panel.plot(depth, views.positive(decay.fit), "--", color=RED, lw=1.4, label="exponential")
        text = f"σₜ = {decay.sigma_t} {decay.unit}⁻¹"
        if decay.rms_relative is not None:
            text += f"\nrms residual {100.0 * decay.rms_relative:.2g} %"
    panel.legend(loc="upper right", title=text, title_fontsize=10, alignment="left")


def _draw_misfit(panel: Axes, decay: DecayView) -> None:
    misfit = np.where(decay.inside, decay.misfit_percent, np.nan)
    band = 100.0 * decay.std / np.where(decay.fit > 0.0, decay.fit, np.nan)
    panel.axhline(0.0, color=RED, linestyle="--", linewidth=1.2)
    panel.fill_between(decay.depth, misfit - band, misfit + band, color=BLUE, alpha=0.3, lw=0)
    panel.plot(decay.depth, misfit, color=BLUE, linewidth=1.2)
    panel.set_xlabel(f"depth along the beam ({decay.unit})")


def _limit(light: Axes, rest: Axes, decays: list[DecayView]) -> None:
    """Limit shared axes to the fitted depths and a little more, residuals symmetrically."""
    fitted = [decay for decay in decays if decay.sigma_t] or decays
    deepest = max(decay.fitted[1] for decay in fitted)
    light.set_xlim(0.0, min(1.3 * deepest, max(float(decay.depth[-1]) for decay in decays)))
    lit = np.concatenate([decay.value[decay.inside & (decay.value > 0.0)] for decay in fitted])
    logarithmic(light, *((0.4 * lit.min(), 2.0 * lit.max()) if lit.size else (0.1, 10.0)))
    misfits = np.concatenate([decay.misfit_percent[decay.inside] for decay in fitted])
    reach = 1.15 * views.reach(misfits, share=100.0)
    rest.set_ylim(-reach, reach)


def _draw_order(
    light: Axes, shape: Axes, depth: Array, order: Array, look: tuple[Any, ...], label: str
) -> None:
    """Draw one bounce and its peak, once in counts/s and once relative to the peak."""
    colour, dashes, marker = look
    at, top = float(depth[order.argmax()]), float(order.max())
    line = {"color": colour, "linestyle": dashes}
    dot = {"marker": marker, "markersize": 7.5, "markeredgecolor": "white", "clip_on": False}
    light.plot(depth, views.positive(order), **line)
    light.plot(at, top, color=colour, zorder=4, **dot)
    shape.vlines(at, 0.0, 1.0, color=colour, linewidth=0.7, alpha=0.6)
    shape.plot(depth, order / top, **line)
    shape.plot(at, 1.0, **line, **dot, zorder=4, label=label.format(at))


def _draw_white(panel: Axes, result: Result) -> None:
    """Draw the measured light without separation as points, few enough to be told apart."""
    if "white_profile" not in result.fields:
        return
    depth, value = (result.fields[name].values for name in ("white_depth", "white_profile"))
    chosen = slice(depth.size // 140, None, max(1, depth.size // 70))
    (points,) = panel.plot(depth[chosen], views.positive(value[chosen]), "o", color=INK)
    points.set(markersize=4.2, markerfacecolor="none", label="measured, white light")


def _draw_glyphs(panel: Axes, points: Array, outlines: list[Array]) -> None:
    label = "radiance by direction, relative to its maximum"
    dark, light = (PolyCollection(outlines, zorder=2) for _ in range(2))
    dark.set(facecolor="none", edgecolor=INK, linewidth=2.2, label=label)
    light.set(facecolor=(1, 1, 1, 0.16), edgecolor="white", linewidth=1.2)
    panel.add_collection(dark)
    panel.add_collection(light)
    x, y = points.T
    panel.scatter(x, y, 52, INK, marker="+", linewidths=3.0, zorder=3)
    panel.scatter(x, y, 42, CROSS, marker="+", linewidths=1.5, zorder=3, label="sampling point")
