"""What the station tells the window of rigs, plans and runs, in the door's own words."""

from __future__ import annotations

import shutil
from pathlib import Path

from labrig.acquisition.estimate import bytes_of, estimate
from labrig.acquisition.preflight import check_all
from labrig.acquisition.run_state import Event
from labrig.models.latency import LatencyRecord
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.patterns import Image
from labrig.plan import CapturePlan, bracket_of, expand, stripes_of
from labrig.rig import OpenRig
from labrig.station.door import Checked, Connected, Planned, RunTold


def planned(plan: Plan, config: Rig, latency: LatencyRecord | None, out: Path) -> Planned:
    """Return what a plan is on a rig, what it costs and whether it could run.

    Raises
    ------
    PlanError
        If the plan does not fit the rig.
    """
    expanded = expand(plan, config)
    cost = estimate(
        expanded,
        config,
        wait_s=None if latency is None else latency.latest_s + latency.settle_s,
    )
    verdicts = check_all(expanded, config, latency, out)
    stripes = stripes_of(expanded.plan)
    groups: dict[str, list[str]] = {}
    for shot in expanded.shots:
        groups.setdefault(shot.group, []).append(shot.id)
    place = next(p for p in (out.absolute(), *out.absolute().parents) if p.is_dir())
    return Planned(
        name=expanded.plan.name,
        period_px=stripes.period_px,
        shifts=stripes.shifts,
        bracket_s=bracket_of(expanded.plan, config),
        groups=tuple((name, tuple(shots)) for name, shots in groups.items()),
        patterns=lines(expanded),
        seconds={name: float(getattr(cost.seconds, name)) for name in cost.seconds.__slots__},
        n_bytes=bytes_of(expanded, config.camera.rows, config.camera.cols),
        free_bytes=shutil.disk_usage(place).free,
        verdicts=tuple(
            Checked(
                name=v.name,
                word="ok" if v.ok else "refused" if v.fatal is not None else "note",
                text=v.text,
            )
            for v in verdicts
        ),
    )


def told(event: Event) -> RunTold:
    """Return an event of a run."""
    s = event.status
    return RunTold(
        kind=event.kind,
        text=event.text,
        state=str(s.state),
        step="" if s.step is None else str(s.step),
        shot=s.shot,
        attempt=s.attempt,
        saved=s.saved,
        total=s.total,
        failures=s.failures,
        eta_s=s.eta_s,
        problem=s.problem,
        reason=s.reason,
    )


def lines(expanded: CapturePlan) -> dict[str, Image]:
    """Return what the projector shows for every shot, one line of it; nothing if it is off."""
    axis = stripes_of(expanded.plan).axis
    found = {}
    for shot in expanded.shots:
        if shot.pattern is not None:
            image = expanded.images[shot.pattern]
            found[shot.id] = image[0] if axis == "x" else image[:, 0]
    return found


def connected(rig: OpenRig) -> Connected:
    """Return what the window must know of a rig that is open."""
    config, can = rig.config, rig.camera_can
    camera, projector = rig.camera.identity, rig.projector.identity
    geometry, scene = config.geometry, rig.scene
    rows = None
    if (
        scene is not None
        and geometry.mm_per_px is not None
        and geometry.lit_side in ("left", "right")
    ):
        top = geometry.region_px[1] if geometry.region_px else 0
        rows = (
            top + scene.beam.from_mm / geometry.mm_per_px,
            top + scene.beam.to_mm / geometry.mm_per_px,
        )
    shows = ["white", "stripes", "cycle", "black"]
    return Connected(
        name=config.name,
        camera=f"{camera['model']} {camera['serial']}",
        projector=f"{projector['model']} {rig.projector_can.cols} x {rig.projector_can.rows}",
        simulated=rig.simulated,
        shape=(can.rows, can.cols),
        bits=can.bits,
        white_level=can.white_level_dn,
        black_level=rig.black_level_dn,
        exposure_range_s=can.exposure_range_s,
        gain_range_db=can.gain_range_db,
        region_px=geometry.region_px,
        mm_per_px=geometry.mm_per_px,
        lit_side=geometry.lit_side,
        beam_rows_px=rows,
        can_show=(*shows, "off") if rig.projector_can.lamp_control else tuple(shows),
    )
