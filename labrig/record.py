"""What an analysis found, as the scalars of run.json and the arrays of fields.nc."""

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
from analysis.light_field import BounceField
from analysis.profile import DepthProfile
from analysis.separation_quality import closure, harmonic_ratio, stripe_residue
from analysis.stripe_aware import StripeAware
from labrig.corrections import Corrections
from labrig.joint_step import Joint
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.rectify import Pictures
from labrig.results import Field
from labrig.session import Session
from labrig.steps import Decay, Explained, Separated

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """All that a run of the pipeline found; the last three None if it stopped after separation."""

    session: Session
    setup: Setup
    known: Corrections
    config: Analysis
    pictures: Pictures
    separated: Separated
    decay: Decay | None
    joint: Joint | None
    explained: Explained | None
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
        notes += [*outcome.decay.notes, *joint, *outcome.explained.notes]
        alternatives = _alternatives(outcome.decay, outcome.joint, outcome.explained, unit)
        fit = outcome.joint.fit if outcome.joint is not None else None
        parameters = (
            _joint_parameters(fit, outcome.decay, unit) if fit else alternatives["separated"]
        )
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
        "uncertainty": "std is statistical: camera noise carried through the fits. model_std is "
        "what an error of 0.1 percent of the model at every depth would add. Neither holds the "
        "bias of Eqs. 9 and 10 (alternatives), whose single scattering still holds low orders.",
        "length_unit": outcome.pictures.unit,
        **_model(outcome),
        "alternatives": alternatives,
        "quality": _quality(outcome),
        "notes": notes,
        "seconds": dict(outcome.seconds),
        "provenance": _provenance(outcome),
    }


def fields_of(outcome: Outcome) -> tuple[dict[str, Field], dict[str, Any]]:
    """Return the arrays of fields.nc and its attributes.

    Pictures in full resolution lie on (row, col); what the solver made, and the separated
    pictures averaged to its nodes, on (y, x). A run that stopped after separation has no solver's
    grid: (y, x) are then the pixels.
    """
    if outcome.decay is None or outcome.explained is None:
        return _pictures(outcome, ("y", "x"), suffix=""), {"length_unit": outcome.pictures.unit}
    fields = {
        **_pictures(outcome, ("row", "col"), suffix="_image"),
        **_profiles(outcome.decay, outcome.pictures.unit),
        **_waves(outcome.joint, outcome.pictures.unit),
        **_bounces(outcome, outcome.explained),
    }
    return fields, {
        "length_unit": outcome.pictures.unit,
        "scale_c": outcome.decay.attenuation.scale_c
        if outcome.joint is None or outcome.joint.fit is None
        else _scale_c(outcome.joint.fit, outcome.decay),
        "scale_c_unit": "counts/s; turns fluence into camera units",
        "beam_angle_rad": math.radians(outcome.decay.beam.angle_deg),
        "beam_from": outcome.decay.beam.from_mm,
        "beam_to": outcome.decay.beam.to_mm,
        "geometry": "flatland",
        "phase": outcome.config.phase,
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
    return {
        "model": {"geometry": "flatland", "phase": outcome.config.phase},
        "method": {
            **separation,
            "parameters": "stripes and white light together, all bounces (stripe-aware)"
            if outcome.joint is not None and outcome.joint.fit is not None
            else "Eqs. 9 and 10 on separated light",
            "separated": "Eq. 9, weighted least squares; Eq. 10, least squares on the nodes",
        },
    }


def _joint_parameters(fit: StripeAware, decay: Decay, unit: str) -> dict[str, Any]:
    medium, noise, model = fit.medium, fit.covariance, fit.model_covariance
    values = (medium.sigma_t_per_mm, medium.sigma_s_per_mm, medium.g)
    names = (f"sigma_t_per_{unit}", f"sigma_s_per_{unit}", "g")
    found: dict[str, Any] = {
        name: {**_with_std(value, noise[k, k]), "model_std": math.sqrt(model[k, k])}
        for k, (name, value) in enumerate(zip(names, values, strict=True))
    }
    c = _scale_c(fit, decay)
    return {**found, "scale_c": _with_std(c, (c * fit.scale_c_std / fit.scale_c) ** 2)}


def _scale_c(fit: StripeAware, decay: Decay) -> float:
    """Return the light of the ballistic beam where it enters: c of Eq. 9."""
    y, light = decay.beam.profile_points()
    return fit.scale_c / float(np.sum(0.5 * (light[1:] + light[:-1]) * np.diff(y)))


def _alternatives(
    decay: Decay, joint: Joint | None, explained: Explained, unit: str
) -> dict[str, Any]:
    """Return the paper's way, and what else could be fitted."""
    paper = explained.inversion
    found: dict[str, Any] = {
        "separated": {
            **_decay_of(decay.attenuation, unit),
            f"sigma_s_per_{unit}": _with_std(paper.sigma_s_per_mm, paper.covariance[0, 0]),
            "g": _with_std(paper.g, paper.covariance[1, 1]),
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
    lit = _bright(together)
    found: dict[str, Any] = {
        "saturated_fraction": pictures.saturated_fraction,
        "detected_fraction": float(np.mean(best.detected))
        if np.isfinite(best.single_variance).any()
        else None,
        "direct_share_median": _median(best.single[lit] / together[lit]),
    }
    found |= _stripe_quality(outcome, lit)
    if pictures.white is not None:
        gap = _closure(outcome)[_bright(pictures.white)]
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
    }


def _additivity(pictures: Pictures) -> float | None:
    """Return the mean of (pattern + inverse)/(white + black) - 1, black not subtracted."""
    if pictures.white is None or pictures.black is None:
        return None
    together = pictures.stripes.sum(axis=0) + 2.0 * pictures.black
    both = pictures.white + 2.0 * pictures.black
    bright = _bright(pictures.white)
    return _finite(np.nanmean(together[bright] / both[bright] - 1.0))


def _closure(outcome: Outcome) -> Array:
    """Return how far single and multiple scattering miss the white picture, (rows, cols)."""
    pictures = outcome.pictures
    if pictures.white is None:
        return np.full(outcome.separated.best.single.shape, np.nan)
    leak = 0.0 if pictures.leak is None else pictures.leak
    return closure(outcome.separated.best, pictures.white, leak)


def _bright(light: Array) -> NDArray[np.bool_]:
    """Return where a ratio means something: light above a fifth of its brightest."""
    with np.errstate(invalid="ignore"):
        return np.asarray(light > 0.2 * np.nanpercentile(light, 99.5))


def _median(values: NDArray[np.floating[Any]]) -> float | None:
    return _finite(np.nanmedian(values)) if np.isfinite(values).any() else None


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _pictures(outcome: Outcome, dims: tuple[str, str], *, suffix: str) -> dict[str, Field]:
    pictures, best = outcome.pictures, outcome.separated.best
    unit = "counts/s"
    rows, cols = best.single.shape
    fields = {
        dims[0]: _axis(dims[0], (np.arange(rows) + 0.5) * pictures.pixel, pictures.unit),
        dims[1]: _axis(dims[1], (np.arange(cols) + 0.5) * pictures.pixel, pictures.unit),
    }
    wanted = {
        "captured": (pictures.captured, "first stripe picture, dark level subtracted"),
        "single": (best.single, "single scattering I_1"),
        "multiple": (best.multiple, "multiple scattering I_M"),
        "single_variance": (best.single_variance, "variance of single"),
        "multiple_variance": (best.multiple_variance, "variance of multiple"),
    }
    if pictures.white is not None:
        wanted["white"] = (pictures.white, "white picture less black")
    for name, (values, meaning) in wanted.items():
        of = f"({unit})^2" if name.endswith("variance") else unit
        key = f"{name}{suffix}"
        fields[key] = Field(dims=dims, values=values.astype(np.float32), unit=of, meaning=meaning)
    if pictures.white is not None:
        gap = np.where(_bright(pictures.white), _closure(outcome), np.nan)
        fields[f"closure{suffix}"] = Field(
            dims=dims,
            values=gap.astype(np.float32),
            unit="1",
            meaning="(single + multiple + 2 leak)/(white + 2 leak) - 1 where white is above a "
            "fifth of its brightest",
        )
    return fields


def _profiles(decay: Decay, unit: str) -> dict[str, Field]:
    fields: dict[str, Field] = {}
    profiles: list[tuple[str, DepthProfile | None, Attenuation | None]] = [
        ("single", decay.single, decay.attenuation),
        ("white", decay.white, decay.unseparated),
    ]
    for name, profile, fit in profiles:
        if profile is None:
            continue
        depth = f"{name}_depth"
        nothing = np.full(profile.value.size, np.nan)
        fields[depth] = _axis(depth, profile.depth_mm, unit)
        for what, values in (
            ("profile", profile.value),
            ("profile_std", profile.std),
            ("profile_fit", nothing if fit is None else fit.at(profile.depth_mm)),
        ):
            fields[f"{name}_{what}"] = Field(
                dims=(depth,),
                values=values,
                unit="counts/s",
                meaning=f"{name} light across the beam, {what}",
            )
    return fields


def _waves(joint: Joint | None, unit: str) -> dict[str, Field]:
    """Return stripes and white light against depth with their model."""
    if joint is None or joint.fit is None or joint.observed is None or joint.share is None:
        return {}
    seen, fit = joint.observed, joint.fit
    periods = np.array([2.0 * np.pi / abs(s.wavenumber_per_mm) for s in seen.stripes])
    n = len(seen.white.wavenumber_per_mm)
    white_std = np.sqrt(np.diagonal(seen.white.covariance, axis1=1, axis2=2)[:, :n]).T
    striped, waved = ("period", "wave_depth"), ("wavenumber", "wave_depth")
    light = f"counts/s {unit}"
    found = {
        "wave_depth": _axis("wave_depth", seen.x_mm, unit),
        "period": _axis("period", periods, unit),
        "wavenumber": _axis("wavenumber", seen.white.wavenumber_per_mm, f"1/{unit}"),
    }
    for name, dims, values, of, meaning in (
        ("stripe_wave", striped, [s.amplitude for s in seen.stripes], light, "stripes' amplitude"),
        ("stripe_wave_std", striped, [s.std for s in seen.stripes], light, "its std"),
        ("stripe_wave_fit", striped, fit.stripe_fit, light, "its model, all bounces"),
        ("single_share", striped, joint.share, "1", "part of the stripes' light scattered once"),
        ("white_wave", waved, seen.white.moment.real, light, "white light by waves along y"),
        ("white_wave_std", waved, white_std, light, "its std"),
        ("white_wave_fit", waved, fit.white_fit.real, light, "its model, all bounces"),
    ):
        found[name] = Field(dims=dims, values=np.asarray(values), unit=of, meaning=meaning)
    return found


def _bounces(outcome: Outcome, explained: Explained) -> dict[str, Field]:
    grid = explained.grid
    single, _ = grid.average(outcome.separated.best.single, outcome.pictures.pixel)
    return {
        **bounce_fields(explained.bounces, outcome.pictures.unit),
        "single": Field(
            dims=("y", "x"), values=single, unit="counts/s", meaning="I_1 averaged to the nodes"
        ),
        "multiple": Field(
            dims=("y", "x"),
            values=explained.multiple,
            unit="counts/s",
            meaning="I_M averaged to the nodes",
        ),
        "residual": Field(
            dims=("y", "x"),
            values=explained.inversion.residual,
            unit="counts/s",
            meaning="multiple less its model (Eq. 10)",
        ),
    }


def bounce_fields(field: BounceField, unit: str) -> dict[str, Field]:
    """Return the bounces and their coordinates as named fields; ``unit`` is that of lengths."""
    grid, n = field.grid, field.n_bounces
    fields = {
        "x": _axis("x", grid.x_mm, unit),
        "y": _axis("y", grid.y_mm, unit),
        "bounce": _axis("bounce", np.arange(1, n + 1), "1"),
        "fluence": Field(
            dims=("bounce", "y", "x"),
            values=field.fluence,
            unit="1",
            meaning="phi_k, one where the beam enters; times scale_c: the picture of bounce k",
        ),
    }
    if field.error_estimate is not None:
        fields["error_estimate"] = Field(
            dims=("bounce",),
            values=field.error_estimate,
            unit="1",
            meaning="relative rms error of each bounce's fluence",
        )
    if field.light_field is not None and n > 1:
        fields["theta"] = _axis("theta", grid.theta_rad, "rad")
        fields["scattered_bounce"] = _axis("scattered_bounce", np.arange(2, n + 1), "1")
        fields["light_field"] = Field(
            dims=("scattered_bounce", "y", "x", "theta"),
            values=field.light_field.astype(np.float32, copy=False),
            unit="1/rad",
            meaning="L_k, radiance per radian of bounces 2 .. K",
        )
    return fields


def _axis(name: str, values: NDArray[Any], unit: str) -> Field:
    return Field(dims=(name,), values=values, unit=unit, meaning=f"coordinate {name}")


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
    here = Path(__file__).parent
    for package in ("analysis", "calibration", "drivers", "labrig"):
        for path in sorted((here.parent / package).rglob("*.py")):
            found.update(path.relative_to(here.parent).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()
