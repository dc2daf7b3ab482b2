"""How high the liquid of a scene stands: the scene says it, or the rig does."""

from __future__ import annotations

from labrig.errors import PlanError
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.models.setup import BeamConfig, TankConfig, refuse_unseen
from labrig.plan import kinds_of_stripes


def layered(scene: Scene, rig: Rig, plan: Plan) -> Scene:
    """Return the scene with the height of its liquid, which the rig may say in its place.

    Raises
    ------
    PlanError
        If both say it and differ, or a layer is asked what no model of it can do.
    """
    own, of_rig = scene.tank.slab(), rig.tank
    if own is not None and of_rig is not None:
        told = (of_rig.height_mm, of_rig.surface_index)
        if told != (own.height_mm, own.surface_index):
            msg = (
                f"the scene's liquid is {own.height_mm:g} mm high with a surface of index "
                f"{own.surface_index:g}, the rig's {told[0]:g} and {told[1]:g}; mend either."
            )
            raise PlanError(msg)
    if own is None and of_rig is not None:
        tank = scene.tank.model_copy(update=of_rig.model_dump())
        scene = scene.model_copy(update={"tank": tank})
    refuse_plan(plan, rig, scene.tank, scene.beam_inside())
    return scene


def refuse_plan(
    plan: Plan, rig: Rig, tank: TankConfig | None, beam: BeamConfig | None = None
) -> None:
    """Refuse stripes that the camera cannot tell apart, and layers that no model is made for.

    Raises
    ------
    PlanError
        With one line that says what to do.
    """
    periods_px = [stripes.period_px for stripes in kinds_of_stripes(plan)]
    try:
        refuse_unseen(tank, beam, rig.projection, rig.geometry, periods_px)
    except ValueError as error:
        msg = f"{error}."
        raise PlanError(msg) from error


def tank_of(rig: Rig) -> TankConfig | None:
    """Return the tank of a rig that knows how high its liquid stands: what its region shows of it.

    None where the analysis may take the tank from the picture.
    """
    geometry, layer = rig.geometry, rig.tank
    if layer is None or geometry.mm_per_px is None:
        return None
    _, _, *shape = geometry.region_px or (0, 0, rig.camera.cols, rig.camera.rows)
    depth_px, width_px = shape if geometry.lit_side in ("left", "right") else shape[::-1]
    return TankConfig(
        depth_mm=depth_px * geometry.mm_per_px,
        width_mm=width_px * geometry.mm_per_px,
        **layer.model_dump(),
    )


def refuse_layer(scene: Scene, what: str) -> None:
    """Refuse a scene whose liquid has a height where all is computed in a plane.

    Raises
    ------
    PlanError
        With one line that says what to do.
    """
    if scene.tank.height_mm is not None:
        msg = (
            f"{what} computes in a plane, and the tank's liquid has a height of "
            f"{scene.tank.height_mm:g} mm; leave tank.height_mm out for a plane."
        )
        raise PlanError(msg)
