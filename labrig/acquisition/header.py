"""What session.json says of a capture: plan, rig, devices, and what the analysis must know."""

from __future__ import annotations

from typing import Any

from labrig.models.plan import Plan
from labrig.models.setup import Setup, StripesConfig
from labrig.plan import CapturePlan, stripes_of
from labrig.rig import OpenRig
from labrig.scene.filled import tank_of


def header_of(expanded: CapturePlan, rig: OpenRig, operator: str | None) -> dict[str, Any]:
    """Return the header of a session about to be captured."""
    latency, scene = rig.latency, rig.scene
    return {
        "plan": expanded.plan.model_dump(mode="json", by_alias=True),
        "plan_digest": expanded.digest,
        "rig": rig.config.model_dump(mode="json", by_alias=True),
        "scene": None if scene is None else scene.model_dump(mode="json", by_alias=True),
        "setup": setup_of(expanded.plan, rig).model_dump(mode="json"),
        "devices": rig.snapshot(),
        "simulated": rig.simulated,
        "simulation": rig.simulation,
        "operator": operator,
        "calibration": {}
        if latency is None
        else {"projector_latency": latency.model_dump(mode="json", by_alias=True)},
        "shots": [shot.model_dump() for shot in expanded.shots],
    }


def setup_of(plan: Plan, rig: OpenRig) -> Setup:
    """Return what the session must tell the analysis: how the rig saw and lit the tank."""
    camera, stripes = rig.config.camera, stripes_of(plan)
    levels = (stripes.low / 255.0, stripes.high / 255.0)
    # the simulated projector is linear
    tank = tank_of(rig.config) if rig.scene is None else rig.scene.tank
    beam = None if rig.scene is None else rig.scene.beam_inside()
    grey = None if rig.simulated or levels == (0.0, 1.0) else levels
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
            "tank": None if tank is None else tank.model_dump(),
            "beam": None if beam is None else beam.model_dump(),
            "stripes": StripesConfig(
                period_px=stripes.period_px, low=levels[0], high=levels[1], levels=grey
            ).model_dump(),
            "projection": rig.config.projection.model_dump(),
        }
    )
