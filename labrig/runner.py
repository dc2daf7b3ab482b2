"""Runs a plan on an open rig: one shot after the other, each kept before the next begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.protocol import CameraSettings
from drivers.projector.protocol import PatternHandle
from drivers.waiting import CancelToken
from labrig.errors import PlanError, RunError
from labrig.models.plan import Plan, Shot
from labrig.models.setup import Setup, StripesConfig
from labrig.plan import CapturePlan, expand, stripes_of
from labrig.rig import OpenRig
from labrig.session import SessionWriter


def capture(
    plan: Plan,
    rig: OpenRig,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Take every shot of a plan and return the sealed session folder.

    Parameters
    ----------
    out : data root; the session is made below it
    progress : called with (shots kept, shots in all)

    Raises
    ------
    PlanError, RunError, SessionError, DriverError
        The session then stays unsealed: what was kept is readable, and nothing is lost.
    """
    expanded = expand(plan, rig.config)
    refuse_impossible(expanded, rig)
    header = {
        "plan": plan.model_dump(mode="json", by_alias=True),
        "plan_digest": expanded.digest,
        "rig": rig.config.model_dump(mode="json", by_alias=True),
        "scene": rig.scene.model_dump(mode="json", by_alias=True),
        "setup": setup_of(plan, rig).model_dump(mode="json"),
        "devices": rig.snapshot(),
        "simulated": True,
        "operator": None,
        "calibration": {},
        "shots": [shot.model_dump() for shot in expanded.shots],
    }
    handles = dict(
        zip(expanded.images, rig.projector.load([*expanded.images.values()]), strict=True)
    )
    rig.camera.arm("software")
    with SessionWriter.create(out, plan.name, header, patterns=expanded.images) as session:
        for number, shot in enumerate(expanded.shots, start=1):
            pixels, details = attempt(shot, handles, rig)
            session.commit(shot.id, 1, pixels, details)
            if progress is not None:
                progress(number, len(expanded.shots))
        session.close()
    return session.path


def attempt(
    shot: Shot, handles: Mapping[str, PatternHandle], rig: OpenRig
) -> tuple[np.ndarray[Any, np.dtype[np.uint16]], dict[str, Any]]:
    """Show, settle, configure, flush, fire, collect and check one shot.

    The pattern stays until the frame is accepted, so a frame can only be wrong by being early:
    it is accepted if its exposure began after the light had surely changed and settled.

    Raises
    ------
    RunError
        If the frame is early or its exposure is not the one asked for.
    """
    never = CancelToken()
    soon_s = rig.now_s() + 1.0
    if shot.pattern is None:
        receipt = rig.projector.lamp_off(deadline_s=soon_s, cancel=never)
    else:
        receipt = rig.projector.show(handles[shot.pattern], deadline_s=soon_s, cancel=never)
    rig.cover(covered=shot.shutter == "covered")
    settled_s = receipt.latest_s + rig.projector_can.settle_s
    rig.clock.wait_until(settled_s, never)
    applied_s = rig.camera.apply(CameraSettings(exposure_s=shot.exposure_s)).exposure_s
    discarded = rig.camera.flush().discarded
    fired = rig.camera.trigger(deadline_s=soon_s, cancel=never)
    frame = rig.camera.collect(
        deadline_s=fired.latest_s + shot.exposure_s + rig.camera_can.readout_s + 1.0, cancel=never
    )
    if frame.t_start_s is None or frame.t_start_s - frame.uncertainty_s < settled_s:
        msg = (
            f"shot {shot.id}: the frame began at {frame.t_start_s} s, before the pattern had "
            f"settled at {settled_s:.4f} s; recalibrate the projector's latency."
        )
        raise RunError(msg)
    if frame.exposure_s is None or abs(frame.exposure_s - shot.exposure_s) > 1e-3 * shot.exposure_s:
        msg = (
            f"shot {shot.id}: the frame was exposed {frame.exposure_s} s instead of "
            f"{shot.exposure_s} s; choose an exposure the camera has."
        )
        raise RunError(msg)
    details = {
        "sequence": frame.sequence,
        "t_start_s": frame.t_start_s,
        "t_end_s": frame.t_end_s,
        "light_earliest_s": receipt.earliest_s,
        "light_latest_s": receipt.latest_s,
        "exposure_asked_s": shot.exposure_s,
        "exposure_applied_s": applied_s,
        "exposure_reported_s": frame.exposure_s,
        "discarded": discarded,
        "proof": "triggered",
        "floor_fraction": float(np.mean(frame.pixels == 0)),
        "saturated_fraction": float(np.mean(frame.pixels >= rig.camera_can.white_level_dn)),
    }
    return frame.pixels, details


def setup_of(plan: Plan, rig: OpenRig) -> Setup:
    """Return what the session must tell the analysis: how the rig saw and lit the tank."""
    camera, stripes = rig.config.camera, stripes_of(plan)
    return Setup.model_validate(
        {
            "camera": {
                "bits": camera.bits,
                "black_level_dn": camera.black_level_dn,
                "white_level_dn": camera.white_level_dn,
                "gain_dn_per_e": camera.gain_dn_per_e,
                "read_noise_e": camera.read_noise_e,
                "response": camera.response,
            },
            "geometry": rig.config.geometry.model_dump(),
            "tank": rig.scene.tank.model_dump(),
            "beam": rig.scene.beam.model_dump(),
            "stripes": StripesConfig(
                period_px=stripes.period_px, low=stripes.low / 255.0, high=stripes.high / 255.0
            ).model_dump(),
            "projection": rig.config.projection.model_dump(),
        }
    )


def refuse_impossible(expanded: CapturePlan, rig: OpenRig) -> None:
    """Refuse before the first shot what could not be taken.

    Raises
    ------
    PlanError
        If stripes run the wrong way or an exposure is outside the camera's range.
    """
    if stripes_of(expanded.plan).axis != "x":
        msg = (
            f"plan {expanded.plan.name!r} has stripes along axis y of the projector; this rig maps "
            "x to the tank: set axis: x."
        )
        raise PlanError(msg)
    low, high = rig.camera_can.exposure_range_s
    for shot in expanded.shots:
        if not low <= shot.exposure_s <= high:
            msg = (
                f"plan {expanded.plan.name!r} asks for {shot.exposure_s} s, the camera has "
                f"{low} .. {high} s; change exposures.bracket_s."
            )
            raise PlanError(msg)
