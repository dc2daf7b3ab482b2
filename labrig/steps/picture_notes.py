"""What must be said of a session's pictures before they are believed."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.corrections import Corrections

STEADY = 0.01  # change of the references' light that is not worth a note


def notes_of(
    session: Session,
    shots: Sequence[Shot],
    setup: Setup,
    pictures: Set[str],
    known: Corrections,
) -> list[str]:
    """Return the notes; ``pictures`` are the names of those that were merged."""
    notes = list(known.notes)
    if not session.sealed:
        notes.append("The session was interrupted: it is not sealed.")
    if session.missing:
        notes.append(
            f"{session.missing[0]} is missing: its picture is what the opposite shift leaves of "
            "the light that each pair of opposite shifts adds up to."
        )
    if known.camera.floor_variance_dn2 is None:
        notes.append(
            "Gain or read noise of the camera is unknown: no variance map, no detection limit; "
            "standard deviations come from the scatter of rows."
        )
    if setup.geometry.mm_per_px is None and known.view is None:
        notes.append("The scale of the picture is unknown: lengths are in px.")
    if "black" not in pictures:
        instead, remains = (
            ("the ambient picture", "the projector's leak remains")
            if "ambient" in pictures
            else ("nothing", "the projector's leak and ambient light remain")
        )
        notes.append(
            f"There is no black picture: {instead} was subtracted; {remains} in the multiple "
            "scattering."
        )
    if "white" not in pictures:
        notes.append("There is no white picture: no closure, and no fit without separation.")
    roles = {shot.role for shot in shots}
    if "dark" not in roles and known.dark is None:
        notes.append("There are no dark frames: the declared black level is the offset.")
    if "flat" in roles and known.flat is None:
        notes.append("Flat frames are in the session: make a record of them and name it.")
    notes += _lamp(session)
    notes += _response(session)
    notes += _short_exposures(shots, known)
    return notes


def _references(session: Session) -> list[dict[str, Any]]:
    return [e["reference"] for e in session.events if isinstance(e.get("reference"), dict)]


def _response(session: Session) -> list[str]:
    """Return a note on a camera whose response nothing in the session has tested."""
    ratios = [r["response_ratio"] for r in _references(session) if "response_ratio" in r]
    if not ratios or any(ratio is not None for ratio in ratios):
        return []
    return [
        "All frames have one exposure, and white light was too dark or too bright to be compared "
        "with another one: that the camera answers as declared was not tested. Bracket exposures, "
        "or make a camera record."
    ]


def _lamp(session: Session) -> list[str]:
    """Return a note on a projector whose light changed while its references were taken."""
    told = _references(session)
    light_dn = [float(r["light_dn"]) for r in told if isinstance(r.get("light_dn"), int | float)]
    if not light_dn or min(light_dn) <= 0.0:
        return []
    change = max(light_dn) / min(light_dn) - 1.0
    if change < STEADY:
        return []
    return [
        f"The projector's light changed by {100 * change:.1f} % during the capture; what was "
        "separated is uncertain by as much."
    ]


def _short_exposures(shots: Sequence[Shot], known: Corrections) -> list[str]:
    """Return a note on exposures of which the shutter's offset is more than 1 percent."""
    offset_s = known.camera.shutter_offset_s
    short = sorted({s.exposure_s for s in shots if abs(offset_s) > 0.01 * s.exposure_s})
    if not short:
        return []
    times = ", ".join(f"{t:g}" for t in short)
    return [
        f"The shutter's offset of {1e6 * offset_s:.1f} us exceeds 1 % of the exposures {times} s."
    ]
