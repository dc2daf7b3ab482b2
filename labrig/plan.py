"""A capture plan expanded to shots: what will be taken, in which order, under which name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass

from labrig.errors import PlanError
from labrig.models.plan import Pattern, Plan, Shot, StripesPattern
from labrig.models.rig import Rig
from labrig.patterns import Image, digest, draw


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturePlan:
    """Shots in order, the projector images they show, and a digest of it all."""

    plan: Plan
    shots: tuple[Shot, ...]
    images: Mapping[str, Image]
    digest: str


def expand(plan: Plan, rig: Rig) -> CapturePlan:
    """Return the shots of a plan on a rig, exposure outermost, all shifts of a group together.

    The same plan and rig give the same shots and the same digest.

    Raises
    ------
    PlanError
        If the stripes do not fit the projector.
    """
    images: dict[str, Image] = {}
    shots: list[Shot] = []
    for e, exposure_s in enumerate(plan.exposures.bracket_s):
        for entry in plan.sets:
            for repeat in range(entry.repeats):
                for shift, shifts in _shifts(entry.pattern):
                    image = draw(entry.pattern, rig.projector.rows, rig.projector.cols, shift or 0)
                    if image is not None:
                        images[digest(image)] = image
                    group = f"{entry.id}-e{e}-r{repeat}"
                    shots.append(
                        Shot(
                            id=group if shift is None else f"{group}-p{shift:02d}",
                            set=entry.id,
                            role=entry.role,
                            group=group,
                            exposure_s=exposure_s,
                            repeat=repeat,
                            shift=shift,
                            shifts=shifts,
                            pattern=None if image is None else digest(image),
                            shutter=entry.shutter,
                        )
                    )
    return CapturePlan(plan=plan, shots=tuple(shots), images=images, digest=_digest(shots))


def _shifts(pattern: Pattern) -> list[tuple[int | None, int | None]]:
    if isinstance(pattern, StripesPattern):
        return [(k, pattern.shifts) for k in range(pattern.shifts)]
    return [(None, None)]


def _digest(shots: list[Shot]) -> str:
    canonical = json.dumps([shot.model_dump() for shot in shots], sort_keys=True, allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def stripes_of(plan: Plan) -> StripesPattern:
    """Return the plan's stripes.

    Raises
    ------
    PlanError
        If the plan has none, or several that differ.
    """
    found = {s.pattern for s in plan.sets if isinstance(s.pattern, StripesPattern)}
    if len(found) != 1:
        msg = f"plan {plan.name!r} has {len(found)} kinds of stripes; one is wanted."
        raise PlanError(msg)
    return found.pop()
