"""What an analysis found, as the scalars of run.json."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.attenuation import Attenuation
from analysis.separation_quality import closure, harmonic_ratio, stripe_residue
from analysis.stripe_aware import StripeAware
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.bounces import POOR_FIT, Explained
from labrig.steps.corrections import Corrections
from labrig.steps.decay import Decay
from labrig.steps.joint import Joint
from labrig.steps.rectify import Pictures
from labrig.steps.remainder import Remainder
from labrig.steps.separation import Separated
from labrig.steps.slab import Layer
from labrig.steps.slab_record import (
    METHOD,
    MODEL,
    PLANE,
    UNCERTAINTY,
    layer_parameters,
    layer_quality,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """All that a run of the pipeline found; those behind None if it stopped after separation."""

    session: Session
    setup: Setup
    known: Corrections
    config: Analysis
    pictures: Pictures
    separated: Separated
    decay: Decay | None
    joint: Joint | None
    layer: Layer | None
    explained: Explained | None
    remainder: Remainder | None
    seconds: Mapping[str, float]


def run_of(outcome: Outcome) -> dict[str, Any]:
    """Return run.json: parameters with standard deviations, quality, notes, provenance."""
    header = outcome.session.header
    notes = [*outcome.pictures.notes, *outcome.separated.notes]
    parameters: dict[str, Any] = {}
    alternatives: dict[str, Any] = {}
    if outcome.decay is not None and outcome.explained is not None:
        unit = outcome.pictures.unit
        joint = outcome.joint.notes if outcome.joint is not None else ()
        if outcome.layer is not None:
            notes += outcome.layer.notes
            if outcome.layer.fit is not None:
                joint = tuple(f"Of the plane beside it: {note}" for note in joint)
        notes += [*outcome.decay.notes, *joint, *outcome.explained.notes]
        alternatives = _alternatives(outcome.decay, outcome.joint, outcome.explained, unit)
        fit = outcome.joint.fit if outcome.joint is not None else None
        parameters = (
            _joint_parameters(fit, outcome.decay, unit) if fit else alternatives["separated"]
        )
        if outcome.joint is not None and outcome.joint.g_unknown:
            parameters["g"] = {"value": None, "std": None, "assumed": parameters["g"]["value"]}
        if outcome.layer is not None and outcome.layer.fit is not None:
            if fit is not None:
                alternatives = {"flatland": {**parameters, "meaning": PLANE}, **alternatives}
            parameters = layer_parameters(outcome.layer.fit, outcome.layer, outcome.decay, unit)
    return {
        "session": {
            "id": header.get("id", outcome.session.path.name),
            "path": str(outcome.session.path),
            "simulated": bool(header.get("simulated", False)),
            "scene": str((header.get("scene") or {}).get("name", "")),
            "imported": bool(header.get("imported", False)),
            "sealed": outcome.session.sealed,
        },
        **parameters,
        **_truth(header),
        "uncertainty": UNCERTAINTY
        if _is_layer(outcome)
        else "std is statistical: camera noise carried through the fits. model_std is "
        "what an error of 0.1 percent of the model at every depth, and of 6 percent of the "
        "side walls' losses, would add. Neither holds the "
        "bias of Eqs. 9 and 10 (alternatives), whose single scattering still holds low orders.",
        "length_unit": outcome.pictures.unit,
        **_model(outcome),
        "alternatives": alternatives,
        "quality": _quality(outcome),
        "notes": notes,
        "seconds": dict(outcome.seconds),
        "provenance": _provenance(outcome),
    }


def _truth(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters a simulated scene was made with; nothing for a real session."""
    medium = (header.get("scene") or {}).get("medium") if header.get("simulated") else None
    if medium is None:
        return {}
    return {"truth": {name: medium[name] for name in ("sigma_t_per_mm", "sigma_s_per_mm", "g")}}


def _model(outcome: Outcome) -> dict[str, Any]:
    separation = {"separation": outcome.separated.best.method}
    if outcome.explained is None:
        return {"method": separation}
    plane = {"geometry": "flatland", "phase": outcome.config.phase, "meaning": PLANE}
    return {
        "model": MODEL if _is_layer(outcome) else plane,
        "method": {
            **separation,
            "parameters": METHOD
            if _is_layer(outcome)
            else "stripes and white light together, all bounces (stripe-aware)"
            if outcome.joint is not None and outcome.joint.fit is not None
            else "Eqs. 9 and 10 on separated light",
            "separated": "Eq. 9, weighted least squares; Eq. 10, least squares on the nodes",
        },
    }


def _is_layer(outcome: Outcome) -> bool:
    return outcome.layer is not None and outcome.layer.fit is not None


def _joint_parameters(fit: StripeAware, decay: Decay, unit: str) -> dict[str, Any]:
    medium, noise, model = fit.medium, fit.covariance, fit.model_covariance
    values = (medium.sigma_t_per_mm, medium.sigma_s_per_mm, medium.g)
    names = (f"sigma_t_per_{unit}", f"sigma_s_per_{unit}", "g")
    found: dict[str, Any] = {
        name: {**_with_std(value, noise[k, k]), "model_std": math.sqrt(model[k, k])}
        for k, (name, value) in enumerate(zip(names, values, strict=True))
    }
    c = scale_c_of(fit, decay)
    return {**found, "scale_c": _with_std(c, (c * fit.scale_c_std / fit.scale_c) ** 2)}


def scale_c_of(fit: StripeAware, decay: Decay) -> float:
    """Return the light of the ballistic beam where it enters: c of Eq. 9."""
    y, light = decay.beam.profile_points()
    return fit.scale_c / float(np.sum(0.5 * (light[1:] + light[:-1]) * np.diff(y)))


def _alternatives(
    decay: Decay, joint: Joint | None, explained: Explained, unit: str
) -> dict[str, Any]:
    """Return the paper's way, and what else could be fitted."""
    paper = explained.inversion
    # Where the bounces explain the picture badly, what noise does to them says nothing.
    spread = paper.covariance if paper.rms_relative < POOR_FIT else np.full((2, 2), np.nan)
    found: dict[str, Any] = {
        "separated": {
            **_decay_of(decay.attenuation, unit),
            f"sigma_s_per_{unit}": _with_std(paper.sigma_s_per_mm, spread[0, 0]),
            "g": _with_std(paper.g, spread[1, 1]),
        }
    }
    for name, fit in (("extrema", decay.by_extrema), ("unseparated", decay.unseparated)):
        if fit is not None:
            found[name] = _decay_of(fit, unit)
    other = None if joint is None else joint.other_phase
    if other is not None:
        found[other.medium.phase] = _joint_parameters(other, decay, unit)
    return found


def _decay_of(fit: Attenuation, unit: str) -> dict[str, Any]:
    return {
        f"sigma_t_per_{unit}": _with_std(fit.sigma_t_per_mm, fit.covariance[1, 1]),
        "scale_c": _with_std(fit.scale_c, fit.covariance[0, 0]),
    }


def _with_std(value: float, variance: float) -> dict[str, float | None]:
    return {"value": value, "std": math.sqrt(variance) if math.isfinite(variance) else None}


def _quality(outcome: Outcome) -> dict[str, Any]:
    pictures, best = outcome.pictures, outcome.separated.best
    together = best.single + best.multiple
    lit = bright(together)
    found: dict[str, Any] = {
        "saturated_fraction": pictures.saturated_fraction,
        "detected_fraction": float(np.mean(best.detected))
        if np.isfinite(best.single_variance).any()
        else None,
        "direct_share_median": _median(best.single[lit] / together[lit]),
    }
    found |= _stripe_quality(outcome, lit)
    if pictures.white is not None:
        gap = closure_of(outcome)[bright(pictures.white)]
        low, middle, high = np.nanpercentile(gap, [16, 50, 84]) if gap.size else (np.nan,) * 3
        found["closure"] = {
            "mean": _finite(np.nanmean(gap)),
            "median": _finite(middle),
            "p16": _finite(low),
            "p84": _finite(high),
        }
        if pictures.stripes.shape[0] == 2 and pictures.black is not None:
            found["additivity"] = _additivity(pictures)
    if outcome.decay is not None and outcome.explained is not None:
        fit, other = outcome.decay.attenuation, outcome.decay.unseparated
        found["attenuation"] = _fit_quality(fit)
        if other is not None:
            found["attenuation_unseparated"] = _fit_quality(other)
        if outcome.joint is not None and outcome.joint.fit is not None:
            found["stripe_aware"] = _joint_quality(outcome.joint.fit)
        of_layer = outcome.layer
        if of_layer is not None and of_layer.fit is not None:
            plane = found.get("stripe_aware", {})
            found["slab"] = layer_quality(of_layer, of_layer.fit, plane)
        if outcome.remainder is not None:
            found["slab" if "slab" in found else "stripe_aware"]["picture"] = {
                "rms_relative": outcome.remainder.rms_relative,
                "chi2": outcome.remainder.chi2,
            }
        inversion = outcome.explained.inversion
        found["inversion"] = {
            "rms_relative": inversion.rms_relative,
            "last_bounce_share": inversion.last_bounce_share,
            "at_limit": inversion.at_limit,
            "covariance": np.where(
                np.isfinite(inversion.covariance), inversion.covariance, 0.0
            ).tolist()
            if np.isfinite(inversion.covariance).all()
            else None,
        }
    return found


def _joint_quality(fit: StripeAware) -> dict[str, Any]:
    std = np.sqrt(np.diag(fit.covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = fit.covariance / np.outer(std, std)
    return {
        "chi2_per_dof": fit.chi2_per_dof,
        "covariance": fit.covariance.tolist() if np.isfinite(fit.covariance).all() else None,
        "correlation": correlation.tolist() if np.isfinite(correlation).all() else None,
        "condition": fit.condition,
        "profile_g": fit.profile_g.tolist(),
        "contrast": fit.contrast.tolist(),
        "at_limit": fit.at_limit,
        "depth_range": list(fit.depth_range_mm),
        "stripe_range": list(fit.stripe_range_mm),
    }


def _stripe_quality(outcome: Outcome, lit: NDArray[np.bool_]) -> dict[str, Any]:
    """Return what the stripes left behind, and what their model left of them."""
    pictures, best = outcome.pictures, outcome.separated.best
    found: dict[str, Any] = {}
    white = best.single + best.multiple if pictures.white is None else pictures.white
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(lit, best.single / white, np.nan)
    found["stripe_residue"] = _finite(stripe_residue(share))
    found["chi2_median"] = _median(best.chi2[lit])
    if pictures.stripes.shape[0] >= 5:
        found["second_harmonic_ratio"] = _median(harmonic_ratio(pictures.stripes)[lit])
    return found


def _fit_quality(fit: Attenuation) -> dict[str, Any]:
    return {
        "chi2_per_dof": fit.chi2_per_dof,
        "rms_relative": fit.rms_relative,
        "depth_range": list(fit.depth_range_mm),
        "ended_by": fit.ended_by,
        "sigma_t_std_by_rows": _finite(fit.row_std[1]),
    }


def _additivity(pictures: Pictures) -> float | None:
    """Return the mean of (pattern + inverse)/(white + black) - 1, black not subtracted."""
    if pictures.white is None or pictures.black is None:
        return None
    together = pictures.stripes.sum(axis=0) + 2.0 * pictures.black
    both = pictures.white + 2.0 * pictures.black
    lit = bright(pictures.white)
    return _finite(np.nanmean(together[lit] / both[lit] - 1.0))


def closure_of(outcome: Outcome) -> Array:
    """Return how far single and multiple scattering miss the white picture, (rows, cols)."""
    pictures = outcome.pictures
    if pictures.white is None:
        return np.full(outcome.separated.best.single.shape, np.nan)
    leak = 0.0 if pictures.leak is None else pictures.leak
    return closure(outcome.separated.best, pictures.white, leak)


def bright(light: Array) -> NDArray[np.bool_]:
    """Return where a ratio means something: light above a fifth of its brightest."""
    with np.errstate(invalid="ignore"):
        return np.asarray(light > 0.2 * np.nanpercentile(light, 99.5))


def _median(values: NDArray[np.floating[Any]]) -> float | None:
    return _finite(np.nanmedian(values)) if np.isfinite(values).any() else None


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _provenance(outcome: Outcome) -> dict[str, Any]:
    packages = ("labrig", "numpy", "scipy", "numba", "h5netcdf", "tifffile")
    header = outcome.session.header
    return {
        "config": outcome.config.model_dump(mode="json", by_alias=True),
        "setup": outcome.setup.model_dump(mode="json"),
        "software": {"python": platform.python_version(), **{p: version(p) for p in packages}},
        "code_sha256": code_digest(),
        "session_header_sha256": hashlib.sha256(
            (outcome.session.path / "session.json").read_bytes()
        ).hexdigest(),
        "devices": header.get("devices"),
        "calibration": dict(outcome.known.used),
    }


def code_digest() -> str:
    """Return the SHA-256 of the program's own source files, so that a result names its code."""
    found = hashlib.sha256()
    house = Path(__file__).parents[2]
    for room in ("analysis", "calibration", "drivers", "labrig"):
        for path in sorted((house / room).rglob("*.py")):
            found.update(path.relative_to(house).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()
