"""Figures of layers: light against depth with what a layer and a plane leave, and heights."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from labrig.fillings import Fillings
from labrig.reporting import views
from labrig.reporting.drawing import INK, ORDERS, STYLE, WIDTH_IN
from labrig.results import Result

LEAST_PERCENT, MOST_PERCENT = 1.0, 20.0  # half the range of the residuals' axes


def layer_figure(result: Result) -> Figure:
    """Draw stripes and white light of a layer with its model, and the misfit of both models."""
    with rc_context(STYLE):
        unit = views.length_unit(result)
        depth, periods = (result.fields[n].values for n in ("layer_depth", "period"))
        figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
        top, rest = figure.subplots(2, 2, sharex=True, height_ratios=(2.0, 1.3))
        stripes = [result.fields[f"layer_stripes{n}"].values for n in ("", "_fit")]
        plane = result.fields.get("stripe_wave_fit")
        for k, (period, (colour, *_)) in enumerate(zip(periods, ORDERS, strict=False)):
            rows = [values[k] for values in stripes]
            of_plane = None if plane is None else plane.values[k]
            name = f"stripes of {period:.3g} {unit}"
            _draw(top[0], rest[0], depth, rows, of_plane, colour, name)
        white = [result.fields[f"layer_white{n}"].values for n in ("", "_fit")]
        waves = result.fields.get("white_wave_fit")
        of_plane = None if waves is None else waves.values[0]
        _draw(top[1], rest[1], depth, white, of_plane, ORDERS[0][0], "white light, sum over rows")
        _settle(top, rest, depth, [stripes[1], white[1]], unit)
        return figure


def _draw(
    light: Axes,
    rest: Axes,
    depth: np.ndarray,
    rows: list[np.ndarray],
    of_plane: np.ndarray | None,
    colour: str,
    name: str,
) -> None:
    measured, model = rows
    use = np.isfinite(model)
    light.plot(depth, measured, ".", color=colour, ms=3.0, label=name)
    light.plot(depth, model, "-", color=INK, lw=1.0)
    off = 100.0 * (measured / model - 1.0)
    rest.plot(depth[use], off[use], "-", color=colour, lw=1.4, label="layer")
    if of_plane is not None:
        with np.errstate(invalid="ignore"):
            off = 100.0 * (measured / of_plane - 1.0)
        rest.plot(depth, off, "--", color=colour, lw=1.2, label="plane")


def _settle(
    top: np.ndarray, rest: np.ndarray, depth: np.ndarray, models: list[np.ndarray], unit: str
) -> None:
    for panel, model in zip(top, models, strict=True):
        panel.set(yscale="log", ylim=(0.5 * np.nanmin(model), 2.0 * np.nanmax(model)))
        panel.yaxis.set_major_formatter(FuncFormatter(views.power_of_ten))
        panel.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        panel.legend(loc="upper right")
    top[0].set(title="(a) what keeps the stripes", ylabel=f"light (counts/s {unit})")
    top[1].set(title="(b) white light, summed over the rows")
    seen = [depth[np.isfinite(model if model.ndim == 1 else model[0])] for model in models]
    for panel in rest:
        worst = max(float(np.nanmax(np.abs(line.get_ydata()))) for line in panel.get_lines())
        half = min(max(1.15 * worst, LEAST_PERCENT), MOST_PERCENT)
        panel.set(ylim=(-half, half), xlabel=f"depth ({unit})")
        panel.set_xlim(0.0, 1.05 * max(float(d.max()) for d in seen if not math.isnan(d.max())))
        panel.axhline(0.0, color=INK, lw=0.8)
        panel.legend(loc="best")
    rest[0].set_ylabel("light over its model (%)")


def fillings_figure(found: Fillings) -> Figure:
    """Draw each parameter against the height of the liquid, by the layer's model and a plane's."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
        panels = figure.subplots(1, len(found.found), sharex=True)
        symbols = {
            "sigma_t_per_mm": r"$\sigma_t$ (1/mm)",
            "sigma_s_per_mm": r"$\sigma_s$ (1/mm)",
            "g": r"$g$",
        }
        for panel, one in zip(panels, found.found, strict=True):
            panel.axhline(one.mean, color=ORDERS[0][0], lw=0.8)
            panel.errorbar(
                found.height_mm,
                one.layer,
                one.layer_std,
                fmt="o-",
                color=ORDERS[0][0],
                capsize=3.0,
                label="layer",
            )
            panel.plot(found.height_mm, one.plane, "s--", color=ORDERS[1][0], label="plane")
            low, high = (f(*one.layer, *one.plane[np.isfinite(one.plane)]) for f in (min, max))
            room = max(0.15 * (high - low), 0.01 * abs(high))
            panel.set(
                title=symbols.get(one.name, one.name),
                xlabel="height of the liquid (mm)",
                ylim=(low - room, high + room),
            )
        panels[0].legend(loc="best")
        return figure
