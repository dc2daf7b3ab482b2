"""Draws what the fit of stripes and white light says, what it costs, and series of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from labrig.accuracy.capture import NAMES, CaptureCosts, Priced
from labrig.reporting import views
from labrig.reporting.drawing import (
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
)
from labrig.results import Result
from labrig.series import DilutionSeries, Line

SYMBOLS = {"sigma_t": "σₜ", "sigma_s": "σₛ", "g": "g"}
KINDS = {
    "more repeats": (BLUE, "o"),
    "other shifts": (ORANGE, "s"),
    "longer exposures": (GREEN, "^"),
    "more exposures": (PURPLE, "D"),
    "fewer exposures": (SKY, "v"),
}


def stripes_figure(result: Result) -> Figure:
    """Draw stripes and white light against depth with the one model that explains both."""
    with rc_context(STYLE):
        unit = views.length_unit(result)
        depth, periods = (result.fields[n].values for n in ("wave_depth", "period"))
        figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
        top, rest = figure.subplots(2, 2, sharex=True, height_ratios=(3.0, 1.0))
        looks = [(colour, marker) for colour, _, marker in ORDERS]
        for k, (period, look) in enumerate(zip(periods, looks, strict=False)):
            name = f"stripes of {period:.3g} {unit}"
            _wave(
                top[0],
                rest[0],
                depth,
                [_row(result, "stripe_wave", n, k) for n in _SUFFIX],
                look[0],
                name,
            )
        share = result.fields["single_share"].values
        first = _row(result, "stripe_wave", "_fit", 0)
        top[0].plot(depth, first * share[0], "--", color=INK, lw=1.2, label="scattered once")
        waves = result.fields["wavenumber"].values
        for k, (q, look) in enumerate(zip(waves, looks, strict=False)):
            name = (
                "white light, sum over rows"
                if k == 0
                else f"its wave of {2 * math.pi / q:.3g} {unit}"
            )
            _wave(
                top[1],
                rest[1],
                depth,
                [_row(result, "white_wave", n, k) for n in _SUFFIX],
                look[0],
                name,
                of=_row(result, "white_wave", "_fit", 0),
            )
        ends = [
            np.nanmax(np.where(np.isfinite(_row(result, n, "_fit", 0)), depth, np.nan))
            for n in ("stripe_wave", "white_wave")
        ]
        for panel in (*top, *rest):
            panel.set_xlim(0.0, 1.05 * max(ends))
        lowest = np.nanmin(first * share[0])
        top[0].set(yscale="log", ylim=(0.5 * lowest, 2.0 * np.nanmax(first)))
        top[0].yaxis.set_major_formatter(FuncFormatter(views.power_of_ten))
        top[0].yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        top[0].set(title="(a) what keeps the stripes", ylabel=f"light (counts/s {unit})")
        top[1].set(title="(b) white light by waves along the face")
        power = math.floor(math.log10(np.nanmax(_row(result, "white_wave", "_fit", 0))))
        top[1].yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v / 10.0**power:g}"))
        top[1].set_ylabel(f"light ({views.power_of_ten(10.0**power)} counts/s {unit})")
        rest[0].set_ylabel("off the model (%)")
        for panel in rest:
            panel.axhline(0.0, color=INK, lw=0.8)
            panel.set(ylim=(-2.0, 2.0), xlabel=f"depth ({unit})")
        for panel in top:
            panel.legend(loc="best")
        return figure


def identifiability_figure(result: Result) -> Figure:
    """Draw the profile likelihood of g, and how the parameters' errors go together."""
    g, above = (result.fields[n].values for n in ("profile_g", "profile_chi2"))
    quality = result.run["quality"]["stripe_aware"]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.7), layout="constrained")
        curve, together = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        bend = np.polyfit(g - g.mean(), above, 2)
        fine = np.linspace(g[0], g[-1], 200)
        parabola = np.polyval(bend, fine - g.mean())
        curve.plot(fine, parabola, color="#9aa1a9", lw=1.2, label="parabola")
        curve.plot(g, above, "o", color=BLUE, ms=6, label="all but g fitted anew")
        for stds in (1, 2, 3):
            curve.axhline(stds**2, color=INK, lw=0.7, ls=(0, (3, 3)))
            text = f" {stds} std"
            curve.text(1.0, stds**2, text, va="center", transform=curve.get_yaxis_transform())
        curve.set(title="(a) profile likelihood of g", xlabel="g", ylabel="χ² above its least")
        curve.set_ylim(-0.4, 1.35 * float(above.max()))
        curve.locator_params(axis="x", nbins=6)
        curve.legend(loc="upper center")
        _correlations(together, np.array(quality["correlation"] or np.full((3, 3), np.nan)))
        together.set_title(f"(b) correlation; condition number {quality['condition']:.1f}")
        return figure


def _correlations(panel: Axes, correlation: views.Array) -> None:
    panel.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    names = list(SYMBOLS.values())
    panel.set(xticks=range(3), yticks=range(3), xticklabels=names, yticklabels=names)
    panel.spines[["top", "right"]].set_visible(True)
    for (row, column), value in np.ndenumerate(correlation):
        colour = "white" if abs(value) > 0.6 else INK
        text = f"{value:+.2f}".replace("-", "−")
        panel.text(column, row, text, ha="center", va="center", color=colour)


_SUFFIX = ("", "_std", "_fit")


def _row(result: Result, name: str, suffix: str, k: int) -> views.Array:
    return np.asarray(result.fields[f"{name}{suffix}"].values[k], dtype=np.float64)


def _wave(
    light: Axes,
    rest: Axes,
    depth: views.Array,
    wave: list[views.Array],
    colour: str,
    name: str,
    of: views.Array | None = None,
) -> None:
    value, std, fit = wave
    light.plot(depth, value, ".", ms=3.0, color=colour, alpha=0.6)
    light.plot(depth, fit, color=colour, label=name)
    scale = fit if of is None else of
    with np.errstate(invalid="ignore", divide="ignore"):
        off, band = 100.0 * (value - fit) / scale, 100.0 * std / np.abs(scale)
    rest.fill_between(depth, off - band, off + band, color=colour, alpha=0.2, lw=0)
    rest.plot(depth, off, color=colour, lw=1.0)


def capture_cost_figure(costs: CaptureCosts) -> Figure:
    """Draw each parameter's standard deviation against capture seconds, by what is changed."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.4), layout="constrained")
        panels = figure.subplots(1, len(NAMES))
        own = costs.plans[0]
        for panel, name in zip(panels, NAMES, strict=True):
            scale = 1.0 if name == "g" else 100.0
            panel.grid(color="#e8ebee", linewidth=0.8)
            for kind, (colour, marker) in KINDS.items():
                line = sorted(
                    [own, *(p for p in costs.plans if p.kind == kind)], key=lambda p: p.seconds
                )
                if len(line) > 1:
                    _points(panel, line, name, scale, color=colour, marker=marker, label=kind)
            _points(panel, [own], name, scale, color=INK, marker="*", ms=13, label="this plan")
            if costs.cheapest is not None:
                looks = {"mfc": "none", "mec": RED, "mew": 2.0, "ms": 15, "marker": "o"}
                _points(panel, [costs.cheapest], name, scale, ls="", label="cheapest", **looks)
            if name in costs.wanted:
                panel.axhline(scale * costs.wanted[name], color=RED, ls=(0, (4, 3)), lw=1.1)
                panel.text(
                    0.98,
                    scale * costs.wanted[name] * 1.04,
                    "asked",
                    color=RED,
                    ha="right",
                    transform=panel.get_yaxis_transform(),
                )
            unit = "" if name == "g" else " (%)"
            panel.set(xscale="log", yscale="log", xlabel="capture (s)")
            panel.set_title(f"std of {SYMBOLS[name]}{unit}")
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
                axis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        keys, names = panels[0].get_legend_handles_labels()
        figure.legend(keys, names, loc="outside lower center", ncols=4)
        return figure


def _points(panel: Axes, plans: list[Priced], name: str, scale: float, **given: Any) -> None:
    seen = [p for p in plans if math.isfinite(p.std[name])]
    looks: dict[str, Any] = {"lw": 1.2, "ms": 6, "mec": "white", "mew": 0.6, **given}
    panel.plot([p.seconds for p in seen], [scale * p.std[name] for p in seen], **looks)


def series_figure(series: DilutionSeries) -> Figure:
    """Draw each parameter against concentration with its line, and what the line leaves."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
        grid = figure.subplots(2, len(series.lines), sharex=True, height_ratios=(3.0, 1.0))
        for column, line in enumerate(series.lines):
            _draw_line(grid[0, column], grid[1, column], series, line)
        grid[1, 0].set_ylabel("residual (std)")
        return figure


def _draw_line(light: Axes, rest: Axes, series: DilutionSeries, line: Line) -> None:
    c = series.concentration
    fine = np.linspace(0.0, 1.05 * float(c.max()), 100)
    at = np.stack([np.ones_like(fine), fine])
    spread = np.sqrt(np.einsum("ix,ij,jx->x", at, line.covariance, at))
    name = next(n for n in NAMES if line.name.startswith(n))
    slope = views.with_std(line.slope, math.sqrt(line.covariance[1, 1]))
    light.fill_between(fine, line.at(fine) - spread, line.at(fine) + spread, color=SKY, alpha=0.4)
    light.plot(fine, line.at(fine), color=RED, label=f"slope {slope}")
    light.errorbar(c, line.value, line.std, fmt="o", color=BLUE, ms=5, capsize=3)
    unit = "" if line.unit == "1" else f" ({line.unit})"
    light.set_title(f"{SYMBOLS[name]}{unit}")
    if name == "g":
        light.set_ylim(line.value.min() - 0.1, line.value.max() + 0.1)
    light.legend(loc="upper left")
    rest.axhline(0.0, color=RED, lw=1.2, ls="--")
    rest.plot(c, (line.value - line.at(c)) / line.std, "o", color=BLUE, ms=5)
    reach = max(2.5, 1.2 * float(np.abs((line.value - line.at(c)) / line.std).max()))
    rest.set(ylim=(-reach, reach), xlabel=f"concentration ({series.concentration_unit})")
