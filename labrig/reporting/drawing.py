"""How every figure looks and is written: colours, panels, pictures, files.

Without pyplot, so that nothing stays open or needs a window.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from labrig.reporting import views
from labrig.reporting.views import Picture

Drawn = Mapping[str, Figure]  # by name

DPI = 150
WIDTH_IN = 9.6

# Okabe and Ito's colours, told apart by every kind of colour vision
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, INK = "#CC79A7", "#56B4E9", "#1b1f24"
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
    "font.size": 9.0,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.edgecolor": "#6b727a",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#4a5159",
    "ytick.color": "#4a5159",
    "text.color": INK,
    "axes.labelcolor": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
    "figure.dpi": DPI,
    "figure.facecolor": "white",
}


def save(figure: Figure, stem: Path) -> bytes:
    """Write a figure as ``stem.png`` and ``stem.pdf``; return the PNG's bytes."""
    picture = png_bytes(figure)
    stem.with_name(f"{stem.name}.png").write_bytes(picture)
    with rc_context(STYLE):
        # without a date the same result gives the same file
        figure.savefig(stem.with_name(f"{stem.name}.pdf"), metadata={"CreationDate": None})
    return picture


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG file's bytes."""
    buffer = io.BytesIO()
    with rc_context(STYLE):
        _settle(figure)
        figure.savefig(buffer, format="png", dpi=DPI, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def _settle(figure: Figure) -> None:
    """Lay a figure out once: to do it for each of its files takes longer than to draw them."""
    if engine := figure.get_layout_engine():
        engine.execute(figure)
        figure.set_layout_engine(None)


def side_by_side(
    like: Picture, n: int, *, bars: tuple[bool, ...], foot_in: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """Return a figure with n panels of the shape of a picture, with the axes' units.

    Their places are reckoned here: a layout engine takes as long as all the drawing.

    Parameters
    ----------
    bars : of each column, whether a colour bar stands right of it
    foot_in : room for a legend, inches
    """
    columns, room = len(bars), [1.15 if bar else 0.28 for bar in bars]
    free = WIDTH_IN - 0.75 - sum(room)
    width = min(free / columns, 6.0 / like.aspect)
    high = width * like.aspect
    height = math.ceil(n / columns) * (high + 0.4) + 0.5 + foot_in
    figure = Figure(figsize=(WIDTH_IN, height))
    panels: list[Axes] = []
    for index in range(n):
        row, column = divmod(index, columns)
        x = 0.75 + 0.5 * (free - columns * width) + column * width + sum(room[:column])
        y = height - (row + 1) * (high + 0.4)
        place = (x / WIDTH_IN, y / height, width / WIDTH_IN, high / height)
        first = panels[0] if panels else None
        panel = figure.add_axes(place, sharex=first, sharey=first)
        lowest = index + columns >= n
        panel.tick_params(labelleft=column == 0, labelbottom=lowest)
        panel.set_xlabel(f"depth x ({like.unit})" if lowest else "")
        panel.set_ylabel(f"y ({like.unit})" if column == 0 else "")
        panels.append(panel)
    return figure, panels


def bar(figure: Figure, panel: Axes, image: AxesImage, label: str, **looks: Any) -> None:
    """Put a colour bar of the panel's height right of it."""
    place = panel.get_position()
    beside = figure.add_axes((place.x1 + 0.1 / WIDTH_IN, place.y0, 0.14 / WIDTH_IN, place.height))
    figure.colorbar(image, cax=beside, label=label, **looks)


def show(panel: Axes, picture: Picture, norm: Normalize | None = None) -> AxesImage:
    """Show a picture with the lit face left and rows running down; without norm, a difference."""
    colours, reach = "cividis" if norm else "RdBu_r", views.reach(picture.values)
    norm = norm or Normalize(-reach, reach)
    image = panel.imshow(picture.values, norm=norm, cmap=colours, extent=picture.extent)
    panel.set_facecolor(BAD)
    panel.spines[["top", "right"]].set_visible(True)
    panel.locator_params(nbins=5)
    return image


def logarithmic(panel: Axes, low: float, high: float) -> None:
    """Give a panel a logarithmic y axis with plain text: mathtext costs more than all the rest."""
    panel.set(yscale="log", ylim=(low, high))
    decades = math.log10(high / low)
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0,) if decades > 1.5 else (1.0, 2.0, 5.0)))
    panel.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0) if decades > 1.5 else (1.0,)))
    panel.yaxis.set_major_formatter(FuncFormatter(views.power_of_ten))
    panel.yaxis.set_minor_formatter(NullFormatter())
