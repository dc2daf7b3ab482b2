"""One test frame before a run: how bright the sample is, and which bracket fits it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.waiting import CancelToken
from labrig.acquisition.estimate import discard_of, settle_of
from labrig.acquisition.looks import Looks
from labrig.acquisition.sequence import Sequencer
from labrig.errors import RunError
from labrig.models.plan import AutoBracket, Plan, Shot, UniformPattern
from labrig.patterns import digest, draw
from labrig.rig import OpenRig

FIRST_S = 0.02  # an exposure that most cameras have and few scenes saturate


@dataclass(frozen=True, slots=True, kw_only=True)
class Probed:
    """A test frame of white light: exposure, brightest counts that matter, saturated share."""

    exposure_s: float
    bright_dn: float
    saturated_fraction: float


def probe(plan: Plan, rig: OpenRig, exposure_s: float, clip: float = 0.001) -> Probed:
    """Take one frame of the white projector; ``clip`` is the share of pixels left out as glints."""
    white = draw(UniformPattern(kind="uniform"), rig.projector_can.rows, rig.projector_can.cols, 0)
    if white is None:
        msg = "a white image is never off"
        raise AssertionError(msg)
    handles = rig.arm([white])
    sequencer = Sequencer(
        rig=rig,
        handles={digest(white): handles[0]},
        settle_s=settle_of(plan, rig.projector_can.settle_s),
        discard=discard_of(plan, rig.camera_can.exposure_latency_frames),
        looks=Looks(rig, plan),
        gain_db=plan.exposures.gain_db,
    )
    shot = Shot(
        id=f"probe-{exposure_s:.6g}",
        set="probe",
        role="white",
        group="probe",
        exposure_s=exposure_s,
        pattern=digest(white),
    )
    try:
        frame = sequencer.attempt(shot, CancelToken(), again=False).frame
    finally:
        rig.camera.disarm()
        rig.projector.make_safe()
    return Probed(
        exposure_s=exposure_s,
        bright_dn=float(np.quantile(frame.pixels, 1.0 - clip)),
        saturated_fraction=float(np.mean(frame.pixels >= rig.camera_can.white_level_dn)),
    )


def resolve(plan: Plan, rig: OpenRig) -> Plan:
    """Return the plan with its bracket found, if it asks for an automatic one.

    Raises
    ------
    RunError
        If the sample is too bright for the shortest exposure, or too dark to be seen.
    """
    auto = plan.exposures.auto
    if auto is None:
        return plan
    low, high = rig.camera_can.exposure_range_s
    shortest_s = _shortest(plan, rig, auto)
    bracket = [shortest_s * auto.ratio**k for k in range(auto.steps)]
    kept = tuple(float(f"{e:.6g}") for e in bracket if low <= e <= high)
    exposures = plan.exposures.model_copy(update={"bracket_s": kept, "auto": None})
    return plan.model_copy(update={"exposures": exposures})


def _shortest(plan: Plan, rig: OpenRig, auto: AutoBracket) -> float:
    """Return the exposure at which the brightest counts that matter reach the target, s."""
    low, high = rig.camera_can.exposure_range_s
    black, white = rig.black_level_dn, rig.camera_can.white_level_dn
    wanted_dn = auto.target * (white - black)
    exposure_s = min(max(FIRST_S, low), high)
    for _ in range(8):
        found = probe(plan, rig, exposure_s, auto.clip)
        light_dn = found.bright_dn - black
        if found.bright_dn >= 0.95 * white:
            factor = 0.1
        elif light_dn < 0.02 * wanted_dn:
            factor = 10.0
        else:
            factor = wanted_dn / light_dn
            if 0.9 < factor < 1.1 or low <= exposure_s * factor <= high:
                return min(max(exposure_s * factor, low), high)
        if not low <= exposure_s * factor <= high:
            break
        exposure_s *= factor
    msg = (
        f"no exposure of {low} .. {high} s brings the white picture to {auto.target} of the white "
        "level; change light or aperture, or give exposures.bracket_s."
    )
    raise RunError(msg)
