"""Draws bounce by bounce: against the truth, and for beams that enter straight and aslant."""

from __future__ import annotations

import numpy as np
from matplotlib import rc_context
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from analysis.directions import anisotropy, mean_direction_deg
from analysis.light_field import BounceField
from labrig.reporting import views
from labrig.reporting.drawing import BLUE, INK, ORANGE, RED, STYLE, WIDTH_IN, show
from labrig.reporting.views import Picture
from labrig.verification import Verification, Verified

SHOWN = 4  # bounces
PER_MILLE = 1e-3


def verification_figure(verification: Verification) -> Figure:
    """Draw the first bounces as they were, as they were recovered, and both along the beam."""
    shown = verification.orders[:SHOWN]
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 6.0), layout="constrained")
        panels = figure.subplots(3, len(shown), height_ratios=(1.0, 1.0, 1.05), squeeze=False)
        for column, order in zip(panels.T, shown, strict=True):
            _compare(column, verification, order)
        names = ("truth: y (mm)", "recovered: y (mm)", "along the beam (counts/s)")
        for panel, name in zip(panels[:, 0], names, strict=True):
            panel.set_ylabel(name)
        panels[2, 0].legend(loc="upper right")
        return figure


def _compare(column: np.ndarray, verification: Verification, order: Verified) -> None:
    norm = Normalize(0.0, views.brightest(order.truth))
    for panel, values in zip(column[:2], (order.truth, order.found), strict=True):
        picture = Picture(values=values, y=verification.y_mm, x=verification.x_mm, unit="mm")
        show(panel, picture, norm)
    column[0].set_title(f"bounce {order.bounce}: rms {100 * order.rms_relative:.1f} % off")
    across = order.truth.sum(axis=1)
    lit = across > 0.5 * across.max()
    for values, colour, style, name in (
        (order.truth, ORANGE, "-", "truth"),
        (order.found, BLUE, (0, (5, 2)), "recovered"),
    ):
        light = values[lit].mean(axis=0)
        column[2].plot(verification.x_mm, light, color=colour, linestyle=style, label=name)
    top = float(order.truth[lit].mean(axis=0).max())
    column[2].set(yscale="log", ylim=(PER_MILLE * top, 2.0 * top), xlabel="depth (mm)")
    column[2].grid(color="#e8ebee", linewidth=0.8)


def slant_figure(fields: tuple[BounceField, BounceField]) -> Figure:
    """Draw how the directions of light forget the beam's, straight and aslant (Fig. 14)."""
    with rc_context(STYLE):
        figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.25, 1.0))[:, 0]
        for field, part in zip(fields, above.subfigures(1, 2, squeeze=False)[0], strict=True):
            part.suptitle(
                f"(a) light by direction, beam at {field.beam.angle_deg:g}°", fontsize=10.5
            )
            _directions(part, field)
        kept, towards = below.subplots(1, 2)
        for field, colour in zip(fields, (BLUE, RED), strict=True):
            bounces = np.arange(1, field.n_bounces + 1)
            label = f"beam at {field.beam.angle_deg:g}°"
            kept.plot(bounces, anisotropy(field), "o-", color=colour, ms=5, label=label)
            towards.plot(bounces, mean_direction_deg(field), "o-", color=colour, ms=5, label=label)
            towards.axhline(field.beam.angle_deg, color=colour, lw=0.9, ls=(0, (4, 3)))
        kept.set(title="(b) how directed light is", ylabel="mean cosine to its mean direction")
        kept.set_ylim(0.0, 1.05)
        towards.set(title="(c) where it goes", ylabel="mean direction (°)")
        for panel in (kept, towards):
            panel.set(xlabel="bounce", xticks=bounces)
            panel.grid(color="#e8ebee", linewidth=0.8)
        kept.legend()
        return figure


def _directions(part: Figure, field: BounceField) -> None:
    """Draw the light of the whole tank against direction, a curve a bounce."""
    panel = part.add_subplot(projection="polar")
    if field.light_field is None:
        return
    theta = np.r_[field.grid.theta_rad, field.grid.theta_rad[:1]]
    for k, colour in zip(range(2, SHOWN + 2), (ORANGE, BLUE, RED, INK), strict=True):
        light = field.light_field[k - 2].sum(axis=(0, 1))
        light = np.r_[light, light[:1]] / light.max()
        panel.plot(theta, light, color=colour, lw=1.5, label=f"bounce {k}")
    panel.annotate(
        "",
        xy=(np.radians(field.beam.angle_deg), 0.98),
        xytext=(np.radians(field.beam.angle_deg), 0.0),
        arrowprops={"arrowstyle": "-|>", "color": "#6b727a", "lw": 1.2, "ls": "--"},
        annotation_clip=False,
    )
    panel.set(ylim=(0.0, 1.0), yticklabels=[], theta_direction=-1)  # y grows downwards
    panel.tick_params(labelsize=8)
    panel.legend(loc="lower left", bbox_to_anchor=(-0.35, -0.1), fontsize=8)
