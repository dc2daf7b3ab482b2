"""Writes a calibration record as one self-contained page of HTML."""

from __future__ import annotations

from datetime import UTC
from pathlib import Path
from typing import Any

from calibration.record import HEEDED, MAX_AGE
from labrig.calibration_records import read_record
from labrig.models.calibration import QuantityFile, RecordFile
from labrig.reporting import figures_calibration
from labrig.reporting.page import Plate, plates, templates, write_page
from labrig.reporting.views import UNKNOWN, with_std

CAPTIONS = {
    "photon-transfer": (
        "Photon transfer",
        "Noise of light grows as its mean: the slope is the gain. Points must lie on the line; "
        "where the camera clips, the variance collapses, and such levels are left out. (b) shows "
        "what a straight line in exposure leaves; a rise at short exposures is the shutter's "
        "offset.",
    ),
    "response": (
        "Response",
        "Counts of one unchanged scene at several exposures against proportional ones, or patterns "
        "and their inverses against white and black; a camera within two percent counts as linear "
        "and is given no response. Else the rising curve that makes them so.",
    ),
    "dark": (
        "Dark frames",
        "What every pixel counts without light. Pixels that stand out by six robust deviations "
        "are masked, and nothing is put in their place.",
    ),
    "flat": (
        "Flat field",
        "How strongly each pixel answers uniform light, relative to the median pixel. Slow "
        "changes are the lens and the lamp, quick ones the pixels.",
    ),
    "geometry": (
        "Board in the tank's plane",
        "Corners of the board, and where they fall on it against where they should: the residual "
        "should show no order.",
    ),
    "map": (
        "Where the projector shines",
        "Projector column and row that light each camera pixel, decoded from the Grey code. "
        "Grey: unknown.",
    ),
    "contrast": (
        "Contrast of the stripes",
        "Contrast that arrives, against the period of the stripes or the depth. Without it, what "
        "blur takes from the stripes is read as multiple scattering.",
    ),
    "gamma": ("Grey levels", "Light of the projector against the grey level it was sent."),
    "leak": ("Black", "Light of a black picture as a share of white, where white is bright."),
}


def write_record_page(folder: Path, out: Path | None = None) -> Path:
    """Write ``report.html``, and ``figures/`` with a PNG and a PDF of each; return the page.

    Raises
    ------
    ConfigError
        If the folder holds no whole record.
    RunError
        If the place cannot be written.
    """
    file, record = read_record(folder)

    def page(files: Path) -> str:
        return _render(file, plates(figures_calibration.all_figures(record), CAPTIONS, files))

    return write_page(out or folder, "report.html", page)


def _render(file: RecordFile, drawn: list[Plate]) -> str:
    heeded = HEEDED[file.kind]
    made = file.created.astimezone(UTC)
    return (
        templates()
        .get_template("calibration.html")
        .render(
            title=file.kind.replace("-", " "),
            identity=file.id,
            made=f"{made.day} {made:%B %Y, %H:%M} UTC",
            warn_after=f"{MAX_AGE[file.kind].total_seconds() / 3600.0:.0f} h",
            quantities=[(name, _measured(q), q.unit) for name, q in file.quantities.items()],
            settings=[(key, _flat(value)) for key, value in file.settings.items()],
            conditions=[
                (name.replace("_", " "), _flat(value) if value is not None else UNKNOWN)
                for name, value in file.conditions.model_dump().items()
                if name in heeded
            ],
            notes=file.notes,
            plates=drawn,
            source=file.source.model_dump(),
            software=file.software,
        )
    )


def _measured(quantity: QuantityFile) -> str:
    return UNKNOWN if quantity.value is None else with_std(quantity.value, quantity.std)


def _flat(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_flat(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        shown = ", ".join(_flat(v) for v in value[:12])
        return f"{shown} …" if len(value) > 12 else shown or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
