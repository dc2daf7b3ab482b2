"""What a report's tables say of a result, row by row, as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from labrig.reporting.views import UNKNOWN, with_std


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A row of the table of parameters, as text; ``base`` and ``index`` make the symbol.

    ``key`` is its name in run.json.
    """

    key: str
    name: str
    base: str
    index: str
    measured: str
    unit: str
    truth: str
    deviation: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Extinction:
    """A way to sigma_t beside the others, as text."""

    source: str
    sigma_t: str
    scale_c: str
    against_chosen: str
    against_truth: str


def parameter_rows(
    run: Mapping[str, Any], unit: str, truth: Mapping[str, float]
) -> Iterator[Parameter]:
    """Yield the parameters that were found or are known, absorption beside them."""
    per_length = f"{unit}⁻¹"
    sigma_t, sigma_s = f"sigma_t_per_{unit}", f"sigma_s_per_{unit}"
    known, found = dict(truth), dict(run)
    if sigma_t in run and sigma_s in run:
        absorbed = run[sigma_t]["value"] - run[sigma_s]["value"]
        found["absorption"] = {"value": absorbed, "std": _absorption_std(run)}
    if sigma_t in truth and sigma_s in truth:
        known["absorption"] = truth[sigma_t] - truth[sigma_s]
    rows = {
        sigma_t: ("extinction", "σ", "t", per_length),
        sigma_s: ("scattering", "σ", "s", per_length),
        "absorption": ("absorption, σₜ − σₛ", "σ", "a", per_length),
        "g": ("asymmetry", "g", "", ""),
        "scale_c": ("scale of the camera", "c", "", "counts/s"),
    }
    for key in truth:
        rows.setdefault(key, (key, "", "", ""))
    for key, (name, base, index, of) in rows.items():
        value, true = found.get(key), known.get(key)
        if value is None and true is None:
            continue
        yield Parameter(
            key=key,
            name=name,
            base=base,
            index=index,
            measured=_measured(value),
            unit=of,
            truth=UNKNOWN if true is None else f"{true:.5g}".replace("-", "−"),
            deviation=UNKNOWN
            if value is None or value["value"] is None or true is None
            else _off(value["value"], true, relative=key != "g"),
        )


def _measured(found: Mapping[str, Any] | None) -> str:
    if found is None:
        return UNKNOWN
    if found["value"] is None:
        return "not determined"
    told = with_std(found["value"], found["std"])
    return f"{told} ± {found['walls_std']:.2g} (height, index)" if found.get("walls_std") else told


def _off(value: float, true: float, *, relative: bool = True) -> str:
    """Return how far a value lies off, in percent where that has a meaning."""
    if relative and true:
        return f"{100.0 * (value / true - 1.0):+.2g} %".replace("-", "−")
    return f"{value - true:+.2g}".replace("-", "−")


def _absorption_std(run: Mapping[str, Any]) -> float | None:
    """Return the std of sigma_t less sigma_s; None where their covariance is not recorded."""
    quality = run.get("quality", {})
    of_model = quality.get("slab") or quality.get("stripe_aware") or {}
    covariance = of_model.get("covariance")
    if covariance is None:
        return None
    (tt, ts, *_), (_, ss, *_), *_ = covariance
    return math.sqrt(max(tt + ss - 2.0 * ts, 0.0))


def remarks(run: Mapping[str, Any], unit: str) -> Iterator[str]:
    """Yield what must be known to read the table: missing and too small standard deviations."""
    quality = run.get("quality", {})
    missing = [
        name
        for name, key in (
            ("σₜ", f"sigma_t_per_{unit}"),
            ("c", "scale_c"),
            ("σₛ", f"sigma_s_per_{unit}"),
            ("g", "g"),
        )
        if key in run and run[key]["value"] is not None and run[key]["std"] is None
    ]
    if missing:
        limit = quality.get("inversion", {}).get("at_limit")
        why = (
            "the fit stopped at the end of its range"
            if limit
            else "the noise of the pictures is not known, so none could be carried through the fit"
        )
        yield f"No std of {', '.join(missing)} ({UNKNOWN}): {why}."
    if f"sigma_s_per_{unit}" in run and _absorption_std(run) is None:
        yield (
            f"Absorption is a difference; it has no std ({UNKNOWN}), for how its two terms vary "
            "together is not recorded."
        )
    chi2 = quality.get("attenuation", {}).get("chi2_per_dof")
    if chi2 is not None and chi2 > 2.0:
        yield (
            f"χ² per degree of freedom is {_chi2(chi2)} in the fit of Eq. 9: its residuals exceed "
            "the noise, and the error is larger than the std."
        )


def extinction_rows(
    run: Mapping[str, Any], unit: str, truth: Mapping[str, float]
) -> Iterator[Extinction]:
    """Yield sigma_t as found from the chosen separation and from the alternatives."""
    key = f"sigma_t_per_{unit}"
    if key not in run:
        return
    others = run.get("alternatives", {})
    method = run.get("method", {}).get("separation", UNKNOWN)
    for source, found in (
        (f"{run.get('method', {}).get('parameters', 'light')} (chosen)", run),
        (f"Eq. 9 on single scattering, {method} (the paper)", others.get("separated")),
        ("Eq. 9 on single scattering, extrema (Eq. 7)", others.get("extrema")),
        ("Eq. 9 on light without separation", others.get("unseparated")),
    ):
        if found is None:
            yield Extinction(
                source=source,
                sigma_t=UNKNOWN,
                scale_c=UNKNOWN,
                against_chosen="no exponential could be fitted",
                against_truth=UNKNOWN,
            )
            continue
        value = found[key]["value"]
        yield Extinction(
            source=source,
            sigma_t=with_std(value, found[key]["std"]),
            scale_c=with_std(found["scale_c"]["value"], found["scale_c"]["std"]),
            against_chosen="" if found is run else _off(value, run[key]["value"]),
            against_truth=_off(value, truth[key]) if key in truth else UNKNOWN,
        )


def quality_rows(quality: Mapping[str, Any], unit: str) -> Iterator[tuple[str, str]]:
    """Yield what was checked and what came out, as text."""
    for key, name in (
        ("saturated_fraction", "pixels saturated in every exposure"),
        ("detected_fraction", "pixels with single scattering above the noise"),
        ("direct_share_median", "share of single scattering, median of the pixels"),
    ):
        if quality.get(key) is not None:
            yield name, f"{100.0 * quality[key]:.3g} %"
    for key, name in (
        ("mean", "closure, mean"),
        ("median", "closure, median"),
        ("p16", "closure, 16th percentile"),
        ("p84", "closure, 84th percentile"),
    ):
        if quality.get("closure", {}).get(key) is not None:
            yield name, f"{100.0 * quality['closure'][key]:+.2g} %".replace("-", "−")
    if quality.get("additivity") is not None:
        text = f"{100.0 * quality['additivity']:+.2g} %".replace("-", "−")
        yield "additivity, (pattern + inverse) / (white + black) − 1", text
    for key, name in (
        ("attenuation", "exponential of single scattering"),
        ("attenuation_unseparated", "exponential without separation"),
    ):
        if key in quality:
            fit = quality[key]
            low, high = fit["depth_range"]
            yield (
                name,
                f"rms residual {100.0 * fit['rms_relative']:.2g} %, χ² per degree of freedom "
                f"{_chi2(fit['chi2_per_dof'])}, fitted from {low:.4g} to {high:.4g} {unit}",
            )
    if "inversion" in quality:
        fit = quality["inversion"]
        limit = "stopped at the end of its range" if fit["at_limit"] else "ended inside its range"
        yield (
            "inversion",
            f"rms residual {100.0 * fit['rms_relative']:.2g} % of the multiple scattering, {limit}",
        )
        yield "light in the last bounce computed", f"{100.0 * fit['last_bounce_share']:.2g} %"


def _chi2(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"
