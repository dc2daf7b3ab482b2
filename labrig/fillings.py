"""The same liquid filled to different heights: an experiment that tests the model without a truth.

A model of the real tank finds the same medium at every height. A plane knows no height, and takes
the light that leaves through surface and floor for little scattering.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from labrig.errors import AnalysisRefusedError
from labrig.results import Result
from labrig.series import session_name

Array = NDArray[np.float64]

NAMES = ("sigma_t_per_mm", "sigma_s_per_mm", "g")
USUAL_STD_MM = 0.05  # of a height of which nobody said how well it is known
DOUBTFUL = 0.01  # probability below which the layer's model is called into question
APART = 1.02  # ratio of two heights that is a difference


@dataclass(frozen=True, slots=True, kw_only=True)
class Filled:
    """One parameter at every height, by the layer's model and by a plane's.

    Attributes
    ----------
    layer, layer_std : (n,); the std holds noise, model error, and what the height is not known by
    plane : (n,), NaN where it was not determined
    mean : of the layer's, weighted
    p_same : probability that equal values scatter as much
    plane_ratio : the plane's largest value over its smallest; NaN where they differ in sign
    """

    name: str
    layer: Array
    layer_std: Array
    plane: Array
    mean: float
    p_same: float
    plane_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Fillings:
    """Sessions of one liquid by rising height.

    Attributes
    ----------
    height_mm, height_std_mm : (n,), and how well each is known
    """

    sessions: tuple[str, ...]
    height_mm: Array
    height_std_mm: Array
    found: tuple[Filled, ...]
    notes: tuple[str, ...]


def compare_fillings(results: Sequence[Result], *, height_std_mm: float | None = None) -> Fillings:
    """Compare what layers of one liquid at different heights are found to be.

    Parameters
    ----------
    height_std_mm : how well all heights are known; if left out what each session says, and where
        one says nothing `USUAL_STD_MM`, which a note tells

    Raises
    ------
    AnalysisRefusedError
        If a session was not analysed as a layer, or all have one height.
    """
    if height_std_mm is not None and not (math.isfinite(height_std_mm) and height_std_mm >= 0.0):
        msg = f"a height known to {height_std_mm} mm: give a number of millimetres, or 0."
        raise AnalysisRefusedError(msg)
    ordered = sorted(results, key=_height)
    heights = np.array([_height(r) for r in ordered])
    if heights.size < 2 or heights[-1] < APART * heights[0]:
        msg = (
            f"heights of {', '.join(f'{h:g}' for h in heights)} mm: fill the same liquid to two "
            "heights or more, and capture each."
        )
        raise AnalysisRefusedError(msg)
    told = [_height_std(r) if height_std_mm is None else height_std_mm for r in ordered]
    stds = np.array([USUAL_STD_MM if std is None else std for std in told])
    silent = [session_name(r) for r, std in zip(ordered, told, strict=True) if std is None]
    found = tuple(_filled(k, ordered, stds) for k in range(len(NAMES)))
    return Fillings(
        sessions=tuple(session_name(r) for r in ordered),
        height_mm=heights,
        height_std_mm=stds,
        found=found,
        notes=_of_silent(silent)
        + tuple(
            f"{one.name} differs between the heights (probability {one.p_same:.2g}): a height is "
            "wrong, the liquid changed, or the tank is no plain layer over a black floor."
            for one in found
            if one.p_same < DOUBTFUL
        ),
    )


def _of_silent(sessions: Sequence[str]) -> tuple[str, ...]:
    if not sessions:
        return ()
    return (
        f"{', '.join(sessions)}: nobody said how well the height is known; {USUAL_STD_MM:g} mm is "
        "taken. Give tank.height_std_mm, or --height-std-mm.",
    )


def write_fillings(fillings: Fillings, path: Path) -> None:
    """Write a line a session."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        names = [
            part
            for one in fillings.found
            for part in (f"{one.name}", f"{one.name}_std", f"{one.name}_of_plane")
        ]
        table.writerow(["session", "height_mm", *names])
        for k, (session, height) in enumerate(
            zip(fillings.sessions, fillings.height_mm, strict=True)
        ):
            cells = [
                f"{values[k]:.6g}"
                for one in fillings.found
                for values in (one.layer, one.layer_std, one.plane)
            ]
            table.writerow([session, f"{height:g}", *cells])


def _height(result: Result) -> float:
    quality = result.run.get("quality", {}).get("slab")
    if quality is None:
        msg = (
            f"{result.path}: was not analysed as a layer; give tank.height_mm in the scene, the "
            "rig or the manifest, and analyse again."
        )
        raise AnalysisRefusedError(msg)
    return float(quality["height_mm"])


def _height_std(result: Result) -> float | None:
    """Return how well a session's height is known, mm; None where it does not say."""
    std = result.run["quality"]["slab"].get("height_std_mm")
    return None if std is None else float(std)


def _filled(k: int, results: Sequence[Result], height_std_mm: Array) -> Filled:
    name, n = NAMES[k], len(results)
    layer, std, plane = np.empty(n), np.empty(n), np.full(n, np.nan)
    for i, result in enumerate(results):
        told, quality = result.run[name], result.run["quality"]["slab"]
        by_height = float(quality["by_height_per_mm"][k]) * height_std_mm[i]
        layer[i] = float(told["value"])
        std[i] = math.hypot(float(told["std"]), float(told["model_std"]), by_height)
        beside = result.run.get("alternatives", {}).get("flatland", {}).get(name)
        if beside is not None and beside["value"] is not None:
            plane[i] = float(beside["value"])
    weight = 1.0 / std**2
    mean = float(weight @ layer / weight.sum())
    chi2 = float(weight @ (layer - mean) ** 2)
    known = plane[np.isfinite(plane)]
    same_sign = known.size > 1 and float(known.min() * known.max()) > 0.0
    sizes = np.abs(known)
    return Filled(
        name=name,
        layer=layer,
        layer_std=std,
        plane=plane,
        mean=mean,
        p_same=float(chi2_distribution.sf(chi2, n - 1)),
        plane_ratio=float(sizes.max() / sizes.min()) if same_sign else math.nan,
    )
