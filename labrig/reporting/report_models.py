"""The report's table of a layer's parameters beside those that a plane would give."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from labrig.reporting.views import with_std


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelRow:
    """A model and what it finds, as text; ``misfit`` is in units of noise and model error."""

    name: str
    values: tuple[str, ...]
    misfit: str


def model_rows(run: Mapping[str, Any], unit: str, truth: Mapping[str, float]) -> Iterator[ModelRow]:
    """Yield the layer, the plane beside it, and the truth if it is known; nothing for a plane."""
    quality = run.get("quality", {}).get("slab")
    if quality is None:
        return
    names = (f"sigma_t_per_{unit}", f"sigma_s_per_{unit}", "g")
    height, index = quality["height_mm"], quality["surface_index"]
    yield ModelRow(
        name=f"layer of {height:g} mm, surface index {index:g} (chosen)",
        values=tuple(with_std(run[n]["value"], run[n]["std"]) for n in names),
        misfit=_misfit(quality["chi2_per_dof"]),
    )
    plane = run.get("alternatives", {}).get("flatland")
    if plane is not None:
        yield ModelRow(
            name="plane (flatland), effective parameters",
            values=tuple("—" if plane[n]["value"] is None else _told(plane[n]) for n in names),
            misfit=_misfit(quality["chi2_per_dof_of_plane"]),
        )
    if all(n in truth for n in names):
        yield ModelRow(name="truth", values=tuple(f"{truth[n]:.5g}" for n in names), misfit="")


def _told(found: Mapping[str, Any]) -> str:
    return with_std(found["value"], found["std"])


def _misfit(chi2: float | None) -> str:
    return "—" if chi2 is None else f"{math.sqrt(chi2):.3g}"
