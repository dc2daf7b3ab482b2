"""Which figures a result has, in the paper's order."""

from __future__ import annotations

from matplotlib.figure import Figure

from labrig.reporting.figures import (
    Draw,
    attenuation_figure,
    bounces_figure,
    closure_figure,
    light_field_figure,
    remainder_figure,
    residual_figure,
    separation_figure,
)
from labrig.reporting.figures_inversion import identifiability_figure, stripes_figure
from labrig.reporting.figures_slab import layer_figure
from labrig.results import Result

FIGURES: dict[str, tuple[Draw, str]] = {  # and the field that each needs
    "separation": (separation_figure, "captured"),
    "closure": (closure_figure, "closure"),
    "attenuation": (attenuation_figure, "single_profile"),
    "layer": (layer_figure, "layer_white"),
    "stripes": (stripes_figure, "stripe_wave"),
    "identifiability": (identifiability_figure, "profile_chi2"),
    "remainder": (remainder_figure, "remainder"),
    "bounces": (bounces_figure, "fluence"),
    "light-field": (light_field_figure, "light_field"),
    "residual": (residual_figure, "residual"),
}


OF_A_PLANE = ("stripes", "identifiability")  # not drawn where a layer was fitted


def all_figures(result: Result) -> dict[str, Figure]:
    """Return the figures that a result has the fields for, by name."""
    layered = FIGURES["layer"][1] in result.fields
    return {
        name: draw(result)
        for name, (draw, needed) in FIGURES.items()
        if (needed in result.fields or f"{needed}_image" in result.fields)
        and not (layered and name in OF_A_PLANE)
    }
