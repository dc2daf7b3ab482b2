"""Draws simulated scenes: what realism costs, and the contact sheet of a gallery."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from labrig.figures import BLUE, INK, RED, STYLE, WIDTH_IN
from labrig.realism import Realism
from labrig.scene.answer import Array

TEXT_COLS = 62  # characters of a line beside a picture
GREY = "#6b727a"


@dataclass(frozen=True, slots=True, kw_only=True)
class Card:
    """One scene of a gallery: its picture, what is in it, and what it took."""

    name: str
    picture: Array
    used: Sequence[str]
    left_out: Sequence[str]
    cost: str


def realism_figure(realism: Realism) -> Figure:
    """Draw the error of a picture against CPU seconds, as effects are added one by one."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 4.6), layout="constrained")
        panel = figure.subplots()
        panel.grid(color="#e8ebee", linewidth=0.8)
        floor = realism.tolerance
        seconds = [step.seconds for step in realism.steps]
        errors = [max(step.error, floor) for step in realism.steps]
        panel.plot(seconds, errors, "-", color=INK, lw=1.0, zorder=2)
        panel.plot(seconds, errors, "o", color=BLUE, ms=7, mec="white", mew=0.8, zorder=3)
        for n, (step, error) in enumerate(zip(realism.steps, errors, strict=True), start=1):
            panel.annotate(
                str(n),
                (step.seconds, error),
                (0, 7),
                textcoords="offset points",
                ha="center",
                color=BLUE,
                fontsize=9,
                fontweight="bold",
            )
        panel.axhline(floor, color=RED, lw=0.9, linestyle=(0, (4, 3)), zorder=1)
        panel.text(
            0.995,
            floor,
            f"tolerance {floor:g}; points on it are at or below",
            color=RED,
            transform=panel.get_yaxis_transform(),
            ha="right",
            va="bottom",
            fontsize=8.5,
        )
        panel.set(xscale="log", yscale="log", xlabel="CPU seconds of the lit pictures of a plan")
        panel.set_ylabel("error of the picture, relative rms")
        panel.set_title(f"What realism costs: {realism.scene}")
        panel.set_ylim(0.6 * floor, 2.0 * max(errors))
        panel.margins(x=0.12)
        lines = [f"{n}  {step.name}" for n, step in enumerate(realism.steps, start=1)]
        figure.legend(
            [panel.plot([], [], " ")[0]] * len(lines),
            lines,
            loc="outside right upper",
            handlelength=0,
            handletextpad=0,
            title="added, in this order",
            alignment="left",
            title_fontsize=9,
        )
        return figure


def contact_sheet(cards: Sequence[Card]) -> Figure:
    """Draw every scene's picture with its effects and its cost beside it."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 1.95 * len(cards)), layout="constrained")
        panels = figure.subplots(len(cards), 2, width_ratios=(1.0, 1.45), squeeze=False)
        for (shown, told), card in zip(panels, cards, strict=True):
            top = float(np.quantile(card.picture, 0.999))
            shown.imshow(
                card.picture,
                cmap="cividis",
                norm=PowerNorm(0.5, 0.0, max(top, 1e-12)),
                interpolation="antialiased",
            )
            shown.set_axis_off()
            told.set_axis_off()
            used = textwrap.fill("used: " + ", ".join(card.used), TEXT_COLS)
            left = ", ".join(card.left_out)
            told.text(0.0, 1.0, card.name, va="top", fontsize=11, fontweight="bold")
            told.text(0.0, 0.85, used, va="top", fontsize=8.5, linespacing=1.35)
            foot = textwrap.fill(f"left out: {left}" if left else "nothing left out", TEXT_COLS)
            told.text(
                0.0,
                0.0,
                f"{foot}\n{card.cost}",
                va="bottom",
                fontsize=8.5,
                color=GREY,
                linespacing=1.35,
            )
        return figure
