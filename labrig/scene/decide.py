"""Which of a scene's effects are used: those that its tolerance cannot do without."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from labrig.models.effects import AS_THE_RIG_SAYS
from labrig.models.plan import Plan, StripesPattern
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import kinds_of_stripes
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.registry import named, refuse_unknown

FALLBACK_S = 0.05  # exposure where the bracket is still to be found


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What was asked of an effect, whether it is used, and why.

    ``asked`` is auto, always, never, or given (with parameters).
    """

    name: str
    asked: str
    used: bool
    bound: float
    why: str
    effect: Effect[Any]


def situation_of(scene: Scene, rig: Rig, plan: Plan) -> Situation:
    """Return what bounds are about."""
    kinds = kinds_of_stripes(plan)
    levels = {level / 255.0 for s in kinds for level in (s.low, s.high)} | {1.0}
    exposures = tuple(sorted(plan.exposures.bracket_s or (FALLBACK_S,)))
    n_frames = sum(
        s.repeats * (s.pattern.shifts if isinstance(s.pattern, StripesPattern) else 1)
        for s in plan.sets
    )
    overhead_s = rig.projector.latency_s + rig.projector.settle_s + rig.camera.readout_s
    return Situation(
        scene=scene,
        rig=rig,
        periods_px=tuple(s.period_px for s in kinds),
        levels=tuple(sorted(levels)),
        exposures_s=exposures,
        duration_s=n_frames * (sum(exposures) + len(exposures) * (overhead_s + 0.1)),
    )


def decide(about: Situation, force: tuple[str, ...] = ()) -> list[Decision]:
    """Decide on every effect that a scene names, in the order in which light meets them.

    Effects that change nothing are left out. Of the others, those on auto are left out from the
    smallest bound on, as long as the bounds together stay below the tolerance: what is left out
    for a strict tolerance is then left out for a looser one too.

    Raises
    ------
    PlanError
        If one is forced that the scene does not name.
    """
    scene = about.scene
    effects = AS_THE_RIG_SAYS if scene.effects is None else scene.effects
    refuse_unknown(force, effects)
    asked = [(entry.name, said, entry.make(said)) for entry, said in named(effects)]
    bounds = {name: effect.bound(about) for name, _, effect in asked}
    open_ones = [
        name
        for name, said, _ in asked
        if said not in ("always", "never") and name not in force and bounds[name].value > 0.0
    ]
    spent, skipped = 0.0, set()
    for name in sorted(open_ones, key=lambda n: bounds[n].value):
        if spent + bounds[name].value > scene.tolerance:
            break
        spent += bounds[name].value
        skipped.add(name)
    return [
        _decided(name, said, effect, bounds[name], scene.tolerance, name in force, name in skipped)
        for name, said, effect in asked
    ]


def _decided(
    name: str,
    said: object,
    effect: Effect[Any],
    bound: Bound,
    tolerance: float,
    forced: bool,
    skipped: bool,
) -> Decision:
    compared = "unbounded" if math.isinf(bound.value) else f"changes at most {bound.value:.2g}"
    if forced:
        used, why = True, f"forced; {compared}: {bound.why}"
    elif said == "never":
        used, why = False, f"the scene forbids it; {compared}: {bound.why}"
    elif bound.value == 0.0:
        used, why = False, f"nothing to do: {bound.why}"
    elif said == "always":
        used, why = True, f"the scene insists; {compared}: {bound.why}"
    elif skipped:
        used, why = False, f"{compared}, within {tolerance:g} with the others: {bound.why}"
    else:
        used, why = True, f"{compared}, more than {tolerance:g} leaves: {bound.why}"
    return Decision(
        name=name,
        asked=said if isinstance(said, str) else "given",
        used=used,
        bound=bound.value,
        why=why,
        effect=effect,
    )
