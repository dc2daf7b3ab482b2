"""Under which conditions a session was taken, as far as it says so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calibration.record import Conditions
from labrig.models.setup import ConditionsConfig, Setup
from labrig.session import Session


def conditions_of(session: Session, setup: Setup) -> Conditions:
    """Return what is known: what the setup notes, else what the devices said of themselves."""
    noted = setup.conditions or ConditionsConfig()
    told = _of_devices(session.header.get("devices") or {})
    known = {key: value for key, value in noted.model_dump().items() if value is not None}
    sizes = {(f.details["rows"], f.details["cols"]) for f in session.frames.values()}
    roi = next(iter(sizes)) if len(sizes) == 1 else None
    return Conditions(bits=setup.camera.bits, roi=roi, **{**told, **known})


def _of_devices(devices: Mapping[str, Any]) -> dict[str, str | None]:
    camera, projector = devices.get("camera") or {}, devices.get("projector") or {}
    shown = projector.get("settings") or {}
    mode = None
    if {"rows", "cols", "refresh_hz"} <= set(shown):
        mode = f"{shown['cols']} x {shown['rows']} px, {shown['refresh_hz']:g} Hz"
    return {
        "camera": _identity(camera),
        "projector": _identity(projector),
        "projector_mode": mode,
    }


def _identity(device: Mapping[str, Any]) -> str | None:
    if not device.get("model"):
        return None
    return f"{device['model']} {device.get('serial', '')}".strip()
