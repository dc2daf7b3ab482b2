"""A capture plan expanded to shots: what will be taken, in which order, under which name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labrig.errors import PlanError
from labrig.models.plan import Pattern, Plan, PlanSet, Shot, StripesPattern
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
    """Return the shots of a plan on a rig, all shifts of a group together.

    Exposure is outermost, or with ``order.outer: pattern`` innermost. A set with ``every`` comes
    again after so many shots, between groups. The same plan and rig give the same shots and the
    same digest.

    Raises
    ------
    PlanError
        If the stripes do not fit the projector, or the bracket is still to be found.
    """
    bracket = bracket_of(plan, rig)
    images: dict[str, Image] = {}
    shots: list[Shot] = []
    turns: list[tuple[int, ...]] = [(e,) for e in range(len(bracket))]
    if plan.order.outer == "pattern":
        turns = [tuple(range(len(bracket)))]
    for exposures in turns:
        for entry, repeat in _blocks(plan, len(exposures)):
            shots += _block(entry, repeat, {e: bracket[e] for e in exposures}, rig, images)
    return CapturePlan(plan=plan, shots=tuple(shots), images=images, digest=_digest(shots))


def bracket_of(plan: Plan, rig: Rig) -> tuple[float, ...]:
    """Return the exposures of a plan, s, rounded to the projector's refresh where it says so.

    Raises
    ------
    PlanError
        If they are still to be found, or become one by the rounding.
    """
    bracket = plan.exposures.bracket_s
    if bracket is None:
        msg = f"plan {plan.name!r}: an automatic bracket is found on the open rig: --probe."
        raise PlanError(msg)
    if plan.exposures.snap_to == "nothing":
        return bracket
    period_s = 1.0 / rig.projector.refresh_hz
    snapped = tuple(max(round(e / period_s), 1) * period_s for e in bracket)
    if len(set(snapped)) < len(snapped):
        msg = (
            f"plan {plan.name!r}: two of bracket_s {list(bracket)} become one when rounded to "
            f"the projector's {period_s:.4f} s; space them wider."
        )
        raise PlanError(msg)
    return snapped


def _blocks(plan: Plan, n_exposures: int) -> list[tuple[PlanSet, int]]:
    """Return sets with the number of their repeat in order, references put in between."""
    blocks: list[tuple[PlanSet, int]] = []
    taken = dict.fromkeys((entry.id for entry in plan.sets), 0)
    since = {entry.id: 0 for entry in plan.sets if entry.every}

    def take(entry: PlanSet) -> None:
        blocks.append((entry, taken[entry.id]))
        taken[entry.id] += 1
        n_shots = len(_shifts(entry.pattern)) * n_exposures
        for name, shots in since.items():
            since[name] = 0 if name == entry.id else shots + n_shots

    for entry in plan.sets:
        for _ in range(entry.repeats):
            take(entry)
            for reference in plan.sets:
                if reference.every and since[reference.id] >= reference.every:
                    take(reference)
    return blocks


def _block(
    entry: PlanSet,
    repeat: int,
    exposures_s: Mapping[int, float],
    rig: Rig,
    images: dict[str, Image],
) -> list[Shot]:
    """Return what is taken without a gap: a group, or with the pattern outermost its bracket."""
    block = []
    for shift, shifts in _shifts(entry.pattern):
        image = draw(entry.pattern, rig.projector.rows, rig.projector.cols, shift or 0)
        if image is not None:
            images[digest(image)] = image
        for e, exposure_s in exposures_s.items():
            group = f"{entry.id}-e{e}-r{repeat}"
            block.append(
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
    return block


def blocks_of(shots: Sequence[Shot]) -> list[tuple[Shot, ...]]:
    """Return the shots that must be taken without a long gap, block by block, in order.

    A block is a group, or the groups whose shots alternate because the pattern is outermost.
    """
    last = {shot.group: n for n, shot in enumerate(shots)}
    blocks: list[tuple[Shot, ...]] = []
    begin = end = 0
    for n, shot in enumerate(shots):
        end = max(end, last[shot.group])
        if n == end:
            blocks.append(tuple(shots[begin : n + 1]))
            begin = end = n + 1
    return blocks


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
