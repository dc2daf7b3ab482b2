"""Writes a result as one self-contained page of HTML, its figures also as PNG and PDF."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from labrig import figures
from labrig.errors import RunError
from labrig.figure_set import all_figures
from labrig.report_models import model_rows
from labrig.results import Result
from labrig.views import along_beam, length_unit, with_std

UNKNOWN = "—"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A row of the table of parameters, as text; ``base`` and ``index`` make the symbol."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Plate:
    """A figure of the page, its picture as base64 text of a PNG."""

    name: str
    title: str
    caption: str
    png: str


SLIDER_FAINTEST = 3e-3  # of the brightest: deeper light is not drawn beside the slider
SLIDER_POINTS = 120
CAPTIONS = {
    "separation": (
        "Single and multiple scattering",
        "One of the captured stripe pictures, and single and multiple scattering separated from "
        "all of them, on one square-root scale. No stripe should be left in (b) and (c); single "
        "scattering should end at the edges of the beam, multiple scattering reach beyond them.",
    ),
    "closure": (
        "Closure",
        "Single plus multiple scattering against the white picture, which was captured on its own, "
        "where that is above a fifth of its brightest. Noise alone gives a histogram around zero "
        "and no pattern in the map, which shows means over blocks of pixels.",
    ),
    "attenuation": (
        "Attenuation along the beam",
        "Light against depth with the exponential fitted to it over the shaded depths, and the "
        "residual relative to the fit. Light without separation bends away from an exponential, "
        "for it holds multiple scattering; single scattering should leave no trend.",
    ),
    "layer": (
        "A layer and a plane",
        "What keeps the stripes, and the white light, with the light of the layer's medium (line). "
        "Below, what the layer's model leaves, and what a plane's best fit leaves (dashed): light "
        "that escapes through the surface bends the curves in a way that no plane can.",
    ),
    "stripes": (
        "Stripes and white light together",
        "What keeps the stripes, and the white light by waves along the face, with the light of "
        "the one medium that explains both, all bounces included. The dashed line is the light "
        "that was scattered once: what lies above it keeps the stripes and is no single "
        "scattering. Below, what the model leaves, and one std of the camera's noise.",
    ),
    "identifiability": (
        "What the data tell apart",
        "How much worse the fit of stripes and white light becomes with g held elsewhere and all "
        "else fitted anew: a parabola says that the stated std holds to three of them, a flat "
        "curve that g is not determined. Beside it, how the errors of the parameters go together.",
    ),
    "remainder": (
        "What all bounces leave of the white light",
        "White light as measured, the picture of the medium found with all its bounces and the "
        "side walls, and the difference. Lines along the edges of the beam are those of a picture "
        "put together from a limited number of waves.",
    ),
    "bounces": (
        "Bounce by bounce",
        "Each bounce as computed with the parameters found, averaged across the beam. The peaks "
        "move inwards from order to order; the sum of all should meet the measured white light.",
    ),
    "light-field": (
        "Light field of the bounces",
        "Colour is the light of a bounce; a glyph is the radiance by direction at its cross, drawn "
        "relative to its own maximum. A long lobe is light of one direction, a circle around the "
        "cross is isotropic light. The mean cosine to the beam falls as the direction is lost.",
    ),
    "residual": (
        "What the model leaves",
        "Multiple scattering as measured, as bounces two and up explain it, and the difference. "
        "Structure in (c) is light that the model or the separation puts in the wrong place.",
    ),
}


def write_report(
    result: Result, out: Path | None = None, truth: Mapping[str, float] | None = None
) -> Path:
    """Write ``report.html``, and ``figures/`` with a PNG and a PDF of each; return the page.

    Parameters
    ----------
    out : folder to write into; else the result's own
    truth : true parameters by their names in run.json, as a simulated scene knows them

    Raises
    ------
    RunError
        If the place cannot be written.
    """
    folder = out or result.path
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        plates = []
        for name, figure in all_figures(result).items():
            png = base64.b64encode(figures.save(figure, folder / "figures" / name)).decode("ascii")
            title, caption = CAPTIONS[name]
            plates.append(Plate(name=name, title=title, caption=caption, png=png))
        page = folder / "report.html"
        page.write_text(render(result, plates, truth or {}), encoding="utf-8")
    except OSError as error:
        reason = error.strerror or str(error)
        msg = f"{folder}: the report cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error
    return page


def render(result: Result, plates: list[Plate], truth: Mapping[str, float]) -> str:
    """Return the page as HTML."""
    environment = Environment(
        loader=PackageLoader("labrig"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    run, unit = result.run, length_unit(result)
    provenance = dict(run.get("provenance", {}))
    return environment.get_template("report.html").render(
        session=run.get("session", {}),
        origin=_origin(run.get("session", {})),
        **_headline(run),
        unit=unit,
        parameters=list(parameter_rows(run, unit, truth)),
        with_truth=bool(truth),
        models=list(model_rows(run, unit, truth)),
        remarks=list(remarks(run, unit)),
        uncertainty=run.get("uncertainty", ""),
        methods=_methods(run, unit),
        alternatives=list(_extinctions(run, unit, truth)),
        notes=run.get("notes", []),
        plates=plates,
        reweighting=_reweighting(result, unit),
        quality=list(quality_rows(run.get("quality", {}), unit)),
        seconds=run.get("seconds", {}),
        result_id=run.get("id", result.path.name),
        schema=run.get("schema", UNKNOWN),
        software=provenance.pop("software", {}),
        hashes={key: provenance.pop(key) for key in list(provenance) if key.endswith("sha256")},
        records={
            key: json.dumps(value, indent=2, ensure_ascii=False)
            for key, value in provenance.items()
            if value is not None
        },
    )


def _reweighting(result: Result, unit: str) -> dict[str, Any] | None:
    """Return curves of every bounce for the slider of sigma_s; None without bounces."""
    sigma_s = result.run.get(f"sigma_s_per_{unit}", {}).get("value", 0.0)
    if "fluence" not in result.fields or not sigma_s > 0.0:
        return None
    depth, orders = along_beam(result)
    total = orders.sum(axis=0)
    lit = depth <= depth[total >= SLIDER_FAINTEST * total.max()][-1]
    step = max(1, int(lit.sum()) // SLIDER_POINTS)
    largest = max(float(result.run[f"sigma_t_per_{unit}"]["value"]), sigma_s)
    data = {
        "sigma_s": sigma_s,
        "top": 2.0 * float(total.max()),
        "depth": np.round(depth[lit][::step], 4).tolist(),
        "orders": [[float(f"{v:.4g}") for v in order[lit][::step]] for order in orders],
    }
    return {"sigma_s": sigma_s, "largest": largest, "data": data}


def _methods(run: Mapping[str, Any], unit: str) -> dict[str, str]:
    """Return model and methods; of a run that stopped after the separation only that."""
    methods = run.get("method", {})
    if f"sigma_t_per_{unit}" in run:
        return {**run.get("model", {}), **methods}
    return {"separation": methods.get("separation", UNKNOWN)}


def _headline(run: Mapping[str, Any]) -> dict[str, str]:
    """Return name and date of the session from its id, and the date of the analysis from its."""
    identity = str(run.get("session", {}).get("id", "session"))
    found = re.fullmatch(r"(\d{4}-\d\d-\d\d_\d{6})_(.+)_[0-9a-f]{4}", identity)
    stamp = re.match(r"\d{8}-\d{6}", str(run.get("id", "")))
    return {
        "title": found[2] if found else identity,
        "captured": _date(found[1], "%Y-%m-%d_%H%M%S") if found else "",
        "analysed": _date(stamp[0], "%Y%m%d-%H%M%S") if stamp else "",
    }


def _origin(session: Mapping[str, Any]) -> str:
    """Return whether the pictures were simulated, imported from files, or measured on a rig."""
    return next((kind for kind in ("simulated", "imported") if session.get(kind)), "measured")


def _date(text: str, form: str) -> str:
    try:
        moment = datetime.strptime(text, form).replace(tzinfo=UTC)
    except ValueError:
        return text
    return f"{moment.day} {moment:%B %Y, %H:%M} UTC"


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
    return "not determined" if found["value"] is None else with_std(found["value"], found["std"])


def _off(value: float, true: float, *, relative: bool = True) -> str:
    """Return how far a value lies off, in percent where that has a meaning."""
    if relative and true:
        return f"{100.0 * (value / true - 1.0):+.2g} %".replace("-", "−")
    return f"{value - true:+.2g}".replace("-", "−")


def _absorption_std(run: Mapping[str, Any]) -> float | None:
    """Return the std of sigma_t less sigma_s; None where their covariance is not recorded."""
    covariance = run.get("quality", {}).get("stripe_aware", {}).get("covariance")
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


def _extinctions(
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
