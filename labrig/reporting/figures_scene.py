"""Draws simulated scenes: what realism costs, and the contact sheet of a gallery."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from labrig.accuracy.scene import Realism
from labrig.reporting.drawing import BLUE, RED, STYLE, WIDTH_IN
from labrig.scene.answer import Array

TEXT_COLS = 96  # characters of a line beside a picture
PICTURE_IN = (2.0, 1.5)  # of the contact sheet, width and height
GAP_IN = 0.14  # between its pictures
BAR_MM = 20.0  # length of its scale bar
GREY = "#6b727a"
Place = tuple[int, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """One scene of a gallery: its picture, what is in it, and lines on what is not and its cost."""

    name: str
    picture: Array
    mm_per_px: float
    used: Sequence[str]
    foot: Sequence[str]


def realism_figure(realism: Realism) -> Figure:
    """Draw the error of a picture against CPU seconds, as effects are added one by one.

    Once with the transport that is kept, and once with what it took to solve it.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.8), layout="constrained")
        panel = figure.subplots()
        panel.grid(color="#e8ebee", linewidth=0.8)
        steps, floor = realism.steps, realism.tolerance
        top = 2.5 * max(floor, *(step.error for step in steps))
        bottom = 0.25 * min(step.error for step in steps if step.error or step is steps[0])
        bottom = min(bottom, 0.25 * floor)
        errors = [max(step.error, 1.6 * bottom) for step in steps]
        kept = [
            (n, step.seconds, error)
            for n, (step, error) in enumerate(zip(steps, errors, strict=True), 1)
        ]
        begin = next((n for n, step in enumerate(steps) if step.transport_s), None)
        fresh = [(n, x + steps[n - 1].transport_s, error) for n, x, error in kept[begin:]]
        panel.axhspan(bottom, floor, color=RED, alpha=0.07, lw=0)
        if begin is not None:
            _, seconds, ends = zip(*kept[begin - 1 : begin], *fresh[:1], strict=True)
            panel.plot(seconds, ends, ":", color=GREY, lw=1.2, zorder=1)
            _draw_steps(panel, fresh, GREY, "transport solved anew")
        _draw_steps(panel, kept, BLUE, "transport kept from before")
        panel.text(
            0.01,
            0.92 * floor,
            f"within the tolerance, {floor:g}",
            color=RED,
            transform=panel.get_yaxis_transform(),
            va="top",
            fontsize=8.5,
        )
        panel.set(xscale="log", yscale="log", xlabel="CPU seconds of the lit pictures of a plan")
        panel.set_ylabel("error of the picture, relative rms")
        panel.set_title(f"What realism costs: {realism.scene}")
        panel.set_ylim(bottom, top)
        every = [x for _, x, _ in (*kept, *fresh)]
        panel.set_xlim(0.6 * min(every), 1.6 * max(every))
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter("{x:g}")
        _list_steps(figure, panel, realism)
        return figure


def _draw_steps(panel: Axes, places: Sequence[Place], colour: str, label: str) -> None:
    """Draw numbered steps (number, seconds, error); those that fall together share a mark."""
    _, seconds, errors = zip(*places, strict=True)
    panel.plot(seconds, errors, "-", color=colour, lw=1.2, zorder=2)
    marks: list[tuple[str, Place]] = []
    for place in places:
        if marks and _together(marks[-1][1], place):
            marks[-1] = (f"{marks[-1][0]}, {place[0]}", marks[-1][1])
        else:
            marks.append((str(place[0]), place))
    for text, (_, x, y) in marks:
        box = {"boxstyle": "round,pad=0.32,rounding_size=0.7", "fc": colour, "ec": "white"}
        panel.text(
            x, y, text, color="white", ha="center", va="center", fontsize=8, bbox=box, zorder=3
        )
    panel.plot([], [], "o-", color=colour, ms=7, lw=1.2, label=label)


def _together(one: Place, other: Place) -> bool:
    """Tell whether two marks would lie on one another."""
    return abs(math.log(other[1] / one[1])) < 0.1 and abs(math.log(other[2] / one[2])) < 0.25


def _list_steps(figure: Figure, panel: Axes, realism: Realism) -> None:
    """Write beside the panel what the numbers stand for."""
    last = len(realism.steps)
    lines = [
        f"{n}  {step.name}  ({step.error:.1%})" if n < last else f"{n}  {step.name}  (complete)"
        for n, step in enumerate(realism.steps, start=1)
    ]
    listed = figure.legend(
        [panel.plot([], [], " ")[0]] * len(lines),
        lines,
        loc="outside right upper",
        handlelength=0,
        handletextpad=0,
        title="added, in this order\n(error that is left)",
        alignment="left",
        title_fontsize=9,
    )
    listed.get_title().set_color(GREY)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 0.18), fontsize=8.5)


def contact_sheet(cards: Sequence[Card]) -> Figure:
    """Draw every scene's picture with its effects and its cost beside it."""
    height_in = len(cards) * (PICTURE_IN[1] + GAP_IN) + GAP_IN
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, height_in))
        for n, card in enumerate(cards):
            bottom = height_in - (n + 1) * (PICTURE_IN[1] + GAP_IN)
            shown = figure.add_axes(
                (
                    GAP_IN / WIDTH_IN,
                    bottom / height_in,
                    PICTURE_IN[0] / WIDTH_IN,
                    PICTURE_IN[1] / height_in,
                )
            )
            _draw_picture(shown, card)
            left = (PICTURE_IN[0] + 3.0 * GAP_IN) / WIDTH_IN
            told = figure.add_axes(
                (left, bottom / height_in, 1.0 - left, PICTURE_IN[1] / height_in)
            )
            _write_card(told, card)
        return figure


def _draw_picture(panel: Axes, card: Card) -> None:
    top = float(np.quantile(card.picture, 0.999))
    panel.imshow(
        card.picture,
        cmap="cividis",
        norm=PowerNorm(0.5, 0.0, max(top, 1e-12)),
        interpolation="antialiased",
    )
    panel.set_axis_off()
    rows, cols = card.picture.shape
    ends = cols * 0.96 - BAR_MM / card.mm_per_px, cols * 0.96
    panel.plot(ends, (rows * 0.93, rows * 0.93), color="white", lw=2.0, solid_capstyle="butt")
    panel.text(
        sum(ends) / 2.0, rows * 0.91, f"{BAR_MM:g} mm", color="white", ha="center", fontsize=7.5
    )


def _write_card(panel: Axes, card: Card) -> None:
    panel.set_axis_off()
    panel.text(0.0, 1.0, card.name, va="top", fontsize=11, fontweight="bold")
    panel.text(0.0, 0.84, _wrapped(", ".join(card.used)), va="top", fontsize=8.5, linespacing=1.4)
    panel.text(
        0.0,
        0.0,
        "\n".join(_wrapped(line) for line in card.foot),
        va="bottom",
        fontsize=8.5,
        color=GREY,
        linespacing=1.4,
    )


def _wrapped(text: str) -> str:
    return textwrap.fill(text, TEXT_COLS, break_on_hyphens=False)
