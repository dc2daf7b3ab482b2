"""What is checked before a run: each verdict with what was found and what to do."""

from __future__ import annotations

import operator
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from labrig.acquisition.estimate import bytes_of
from labrig.errors import LabrigError, PlanError, RunError
from labrig.models.latency import LatencyRecord
from labrig.models.plan import Plan, Shot
from labrig.models.rig import Rig
from labrig.plan import CapturePlan, kinds_of_stripes

RESERVE_SHARE = 1.1  # of the bytes a session takes: journal, results and the file system's own
_WISH = re.compile(r"\s*([a-z_]+\.[a-z_]+)\s*(?:(>=|<=|==|>|<)\s*([0-9.eE+-]+))?\s*")
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    ">": operator.gt,
    "<": operator.lt,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """One check. ``fatal`` is the kind of error a refusal raises, None if it is only said."""

    name: str
    ok: bool
    text: str
    fatal: type[LabrigError] | None = None


def check_all(
    expanded: CapturePlan,
    rig: Rig,
    latency: LatencyRecord | None,
    out: Path,
    *,
    left: Sequence[Shot] | None = None,
) -> list[Verdict]:
    """Return every verdict that needs no device, in the order an operator would ask.

    ``left`` are the shots that a session still lacks; else there must be room for all.
    """
    return [
        _axis(expanded),
        *_exposures(expanded, rig),
        *_wishes(expanded.plan, rig),
        _latency(expanded.plan, latency),
        _room(expanded, rig, out, left),
    ]


def refuse(verdicts: list[Verdict]) -> None:
    """Raise the first fatal verdict that is not well, if there is one."""
    for verdict in verdicts:
        if not verdict.ok and verdict.fatal is not None:
            raise verdict.fatal(verdict.text)


def _axis(expanded: CapturePlan) -> Verdict:
    if all(stripes.axis == "x" for stripes in kinds_of_stripes(expanded.plan)):
        return Verdict(name="axis", ok=True, text="the stripes vary along the projector's x")
    text = (
        f"plan {expanded.plan.name!r} has stripes along axis y of the projector; this rig maps "
        "x to the tank: set axis: x."
    )
    return Verdict(name="axis", ok=False, text=text, fatal=PlanError)


def _exposures(expanded: CapturePlan, rig: Rig) -> list[Verdict]:
    verdicts = []
    low, high = 1e-5, 60.0
    exposures = sorted({shot.exposure_s for shot in expanded.shots})
    outside = [e for e in exposures if not low <= e <= high]
    if outside:
        text = (
            f"plan {expanded.plan.name!r} asks for {outside[0]} s, the camera has "
            f"{low} .. {high} s; change exposures.bracket_s."
        )
        verdicts.append(Verdict(name="exposures", ok=False, text=text, fatal=PlanError))
    else:
        text = f"{len(exposures)} exposures from {exposures[0]:g} to {exposures[-1]:g} s"
        verdicts.append(Verdict(name="exposures", ok=True, text=text))
    period_s = 1.0 / rig.projector.refresh_hz
    if exposures[0] < 0.999 * period_s:
        text = (
            f"the exposure of {exposures[0]:g} s is shorter than a refresh of {period_s:.4f} s; "
            "a projector that makes grey by turns would show stripes of its own."
        )
        verdicts.append(Verdict(name="refresh", ok=False, text=text))
    return verdicts


def _wishes(plan: Plan, rig: Rig) -> list[Verdict]:
    has: dict[str, float] = {
        "camera.global_shutter": float(rig.camera.row_time_s == 0.0),
        "camera.bits": rig.camera.bits,
        "camera.width": rig.camera.cols,
        "camera.height": rig.camera.rows,
        "projector.width": rig.projector.cols,
        "projector.height": rig.projector.rows,
        "projector.refresh_hz": rig.projector.refresh_hz,
    }
    verdicts = []
    for wish in plan.rig.require:
        match = _WISH.fullmatch(wish)
        name, sign, number = match.groups() if match else (wish, None, None)
        try:
            wanted = float(number) if number else 1.0
        except ValueError:
            name, wanted = wish, 1.0
        if name not in has:
            known = ", ".join(has)
            text = f"rig.require {wish!r} is not understood; known are {known}."
            verdicts.append(Verdict(name="wish", ok=False, text=text, fatal=PlanError))
            continue
        ok = _COMPARE[sign or "=="](has[name], wanted)
        text = f"{wish}: the rig has {has[name]:g}" + ("" if ok else "; use another rig.")
        verdicts.append(Verdict(name="wish", ok=ok, text=text, fatal=PlanError))
    return verdicts


def _latency(plan: Plan, latency: LatencyRecord | None) -> Verdict:
    limit_h = plan.calibration.projector_latency_max_age_h
    remedy = "run labrig calibrate latency."
    if latency is None:
        text = f"the projector's latency was never measured on this rig; {remedy}"
        fatal = None if limit_h is None else RunError
        return Verdict(name="latency", ok=False, text=text, fatal=fatal)
    age_h = latency.age_h()
    text = f"the projector's latency was measured {age_h:.1f} h ago"
    if limit_h is not None and not 0.0 <= age_h <= limit_h:
        text += f", the plan allows {limit_h:g} h; {remedy}"
        return Verdict(name="latency", ok=False, text=text, fatal=RunError)
    return Verdict(name="latency", ok=True, text=text)


def _room(expanded: CapturePlan, rig: Rig, out: Path, left: Sequence[Shot] | None) -> Verdict:
    wanted = RESERVE_SHARE * bytes_of(expanded, rig.camera.rows, rig.camera.cols, left)
    place = next(p for p in (out.absolute(), *out.absolute().parents) if p.is_dir())
    free = shutil.disk_usage(place).free
    text = f"{wanted / 1e6:.0f} MB wanted, {free / 1e6:.0f} MB free in {place}"
    ok = free > wanted
    return Verdict(
        name="disk", ok=ok, text=text + ("" if ok else "; make room or use --out."), fatal=RunError
    )
