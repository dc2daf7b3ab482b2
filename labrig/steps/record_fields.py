"""What an analysis found, as the arrays of fields.nc."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from analysis.attenuation import Attenuation
from analysis.profile import DepthProfile
from labrig.results import Field
from labrig.steps.bounce_fields import axis, bounce_fields
from labrig.steps.bounces import Explained
from labrig.steps.decay import Decay
from labrig.steps.joint import Joint
from labrig.steps.record import Outcome, bright, closure_of, scale_c_of
from labrig.steps.remainder import Remainder
from labrig.steps.slab_picture import scale_c_of as slab_scale_c_of
from labrig.steps.slab_record import layer_fields


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
        **layer_fields(outcome.layer, outcome.explained, outcome.pictures.unit),
    }
    layer, decay = outcome.layer, outcome.decay
    slab = None if layer is None or layer.fit is None else layer
    return fields, {
        "length_unit": outcome.pictures.unit,
        "scale_c": slab_scale_c_of(slab, decay)
        if slab is not None
        else outcome.decay.attenuation.scale_c
        if outcome.joint is None or outcome.joint.fit is None
        else scale_c_of(outcome.joint.fit, outcome.decay),
        "scale_c_unit": "counts/s; turns fluence into camera units",
        "beam_angle_rad": math.radians(outcome.decay.beam.angle_deg),
        "beam_from": outcome.decay.beam.from_mm,
        "beam_to": outcome.decay.beam.to_mm,
        "geometry": "flatland" if slab is None else "slab",
        "phase": outcome.config.phase if slab is None else "hg on the sphere",
    }


def _pictures(outcome: Outcome, dims: tuple[str, str], *, suffix: str) -> dict[str, Field]:
    pictures, best = outcome.pictures, outcome.separated.best
    unit = "counts/s"
    rows, cols = best.single.shape
    fields = {
        dims[0]: axis(dims[0], (np.arange(rows) + 0.5) * pictures.pixel, pictures.unit),
        dims[1]: axis(dims[1], (np.arange(cols) + 0.5) * pictures.pixel, pictures.unit),
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
        gap = np.where(bright(pictures.white), closure_of(outcome), np.nan)
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
        fields[depth] = axis(depth, profile.depth_mm, unit)
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
        "wave_depth": axis("wave_depth", seen.x_mm, unit),
        "period": axis("period", periods, unit),
        "wavenumber": axis("wavenumber", seen.white.wavenumber_per_mm, f"1/{unit}"),
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
    if fit.profile_g.size:
        found["profile_g"] = axis("profile_g", fit.profile_g[:, 0], "1")
        found["profile_chi2"] = Field(
            dims=("profile_g",),
            values=fit.profile_g[:, 1],
            unit="1",
            meaning="chi^2 above its least for a g that is held, all else fitted anew",
        )
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
        **_remainder(outcome.remainder),
    }


def _remainder(left: Remainder | None) -> dict[str, Field]:
    """Return the white light on the nodes, and what its model leaves."""
    if left is None:
        return {}
    told = {
        "lit": (left.white, "mean of the shifts as a wholly lit field"),
        "remainder": (left.residual, "lit less all bounces of its fit"),
    }
    return {
        name: Field(dims=("y", "x"), values=values, unit="counts/s", meaning=meaning)
        for name, (values, meaning) in told.items()
    }
