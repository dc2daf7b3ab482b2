"""Writes a result as one self-contained page of HTML, its figures also as PNG and PDF."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from labrig.reporting.figure_set import all_figures
from labrig.reporting.page import Plate, plates, templates, write_page
from labrig.reporting.report_models import model_rows
from labrig.reporting.report_rows import extinction_rows, parameter_rows, quality_rows, remarks
from labrig.reporting.views import UNKNOWN, along_beam, length_unit
from labrig.results import Result

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

    def page(files: Path) -> str:
        return render(result, plates(all_figures(result), CAPTIONS, files), truth or {})

    return write_page(out or result.path, "report.html", page)


def render(result: Result, drawn: list[Plate], truth: Mapping[str, float]) -> str:
    """Return the page as HTML."""
    run, unit = result.run, length_unit(result)
    provenance = dict(run.get("provenance", {}))
    return (
        templates()
        .get_template("report.html")
        .render(
            session=run.get("session", {}),
            origin=_origin(run.get("session", {})),
            **headline(run),
            unit=unit,
            parameters=list(parameter_rows(run, unit, truth)),
            with_truth=bool(truth),
            models=list(model_rows(run, unit, truth)),
            remarks=list(remarks(run, unit)),
            uncertainty=run.get("uncertainty", ""),
            methods=_methods(run, unit),
            alternatives=list(extinction_rows(run, unit, truth)),
            notes=run.get("notes", []),
            plates=drawn,
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


def headline(run: Mapping[str, Any]) -> dict[str, str]:
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
