"""What a layer's fit found, as scalars of run.json and arrays of fields.nc."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.slab_fit import SlabFit
from labrig.results import Field
from labrig.steps.bounces import Explained
from labrig.steps.decay import Decay
from labrig.steps.slab import Layer
from labrig.steps.slab_picture import scale_c_of

Array = NDArray[np.float64]

PLANE = "effective parameters of a plane; in a real tank light also leaves through the surface"
MODEL = {
    "geometry": "slab",
    "phase": "hg on the sphere",
    "meaning": "the liquid's own parameters, for the height and index that were told",
}
METHOD = "stripes and white light together, all bounces of a layer (slab)"
UNCERTAINTY = (
    "std is statistical: camera noise carried through the fit. model_std is what an error of 0.1 "
    "percent of the model at every depth, and of the stripes' contrast, would add. walls_std is "
    "what the stated uncertainty of height and index adds; it is missing where the tank says "
    "neither height_std_mm nor index_std, and no misfit shows such a mistake: see "
    "quality.slab.by_height_per_mm and by_index."
)


def layer_parameters(fit: SlabFit, layer: Layer, decay: Decay, unit: str) -> dict[str, Any]:
    """Return the layer's parameters with their standard deviations."""
    values = (fit.sigma_t_per_mm, fit.sigma_s_per_mm, fit.g)
    names = (f"sigma_t_per_{unit}", f"sigma_s_per_{unit}", "g")
    found: dict[str, Any] = {
        name: {
            "value": value,
            "std": math.sqrt(fit.covariance[k, k]),
            "model_std": math.sqrt(fit.model_covariance[k, k]),
        }
        for k, (name, value) in enumerate(zip(names, values, strict=True))
    }
    of_walls = layer.walls_std()
    if of_walls is not None:
        for name, std in zip(names, of_walls, strict=True):
            found[name]["walls_std"] = float(std)
    c = scale_c_of(layer, decay)
    of_c = {"value": c, "std": c * fit.scale_std / float(fit.scales[-1])}
    return {**found, "scale_c": of_c}


def layer_quality(layer: Layer, fit: SlabFit, plane: Mapping[str, Any]) -> dict[str, Any]:
    """Return how well a layer explains the light, and what it depends on.

    ``plane`` is the same of the plane's fit; empty where there is none.
    """
    slab = layer.slab
    return {
        "height_mm": slab.height_mm if slab else None,
        "surface_index": slab.surface_index if slab else None,
        "chi2_per_dof": fit.chi2_per_dof,
        "rms_relative": fit.rms_relative,
        "chi2_per_dof_of_plane": plane.get("chi2_per_dof"),
        "covariance": fit.covariance.tolist(),
        "model_covariance": fit.model_covariance.tolist(),
        "correlation": fit.correlation.tolist(),
        "height_std_mm": layer.height_std_mm,
        "index_std": layer.index_std,
        "by_height_per_mm": fit.by_height.tolist(),
        "by_index": fit.by_index.tolist(),
        "contrast": layer.contrast.tolist(),
        "at_limit": fit.at_limit,
        "solver_shift": fit.solver_shift.tolist(),
    }


def layer_fields(layer: Layer | None, explained: Explained, unit: str) -> dict[str, Field]:
    """Return the layer's light against depth, and its fluence."""
    found: dict[str, Field] = {}
    if layer is None or layer.fit is None or layer.observed is None:
        return found
    seen, light = layer.observed, f"counts/s {unit}"
    noise = np.sqrt(seen.white.covariance[:, 0, 0])
    for name, dims, values, meaning in (
        ("layer_depth", ("layer_depth",), seen.x_mm, "coordinate layer_depth"),
        (
            "layer_stripes",
            ("period", "layer_depth"),
            [s.amplitude for s in seen.stripes],
            "what keeps the stripes, summed over the rows",
        ),
        ("layer_stripes_std", ("period", "layer_depth"), [s.std for s in seen.stripes], "its std"),
        ("layer_stripes_fit", ("period", "layer_depth"), layer.harmonics, "its model, all bounces"),
        ("layer_white", ("layer_depth",), seen.white.moment[0].real, "white light over the rows"),
        ("layer_white_std", ("layer_depth",), noise, "its std"),
        ("layer_white_fit", ("layer_depth",), layer.white, "its model, all bounces"),
    ):
        of = unit if name == "layer_depth" else light
        found[name] = Field(dims=dims, values=np.asarray(values), unit=of, meaning=meaning)
    if explained.layer_fluence is not None:
        found["layer_fluence"] = Field(
            dims=("bounce", "y", "x"),
            values=explained.layer_fluence,
            unit="1",
            meaning="fluence of each bounce, mean over the height; the camera sees fluence",
        )
    return found
