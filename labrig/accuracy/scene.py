"""What realism costs: how wrong a picture is, and how long it takes, as effects are added."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from labrig.errors import PlanError
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.patterns import Image
from labrig.scene.answer import Answer, Array
from labrig.scene.decide import Decision, decide, situation_of
from labrig.scene.explain import Progress, change, lit, lit_images
from labrig.scene.picture import Picture
from labrig.scene.pipeline import assemble, solve

FIRST = "single-scattering"
TOGETHER = ("multiple-scattering", "anisotropy")  # both are the one transport
ROUNDS = 2  # of which the quicker counts: a busy machine is never too quick


@dataclass(frozen=True, slots=True, kw_only=True)
class Added:
    """The picture with one effect more.

    Attributes
    ----------
    name : of what was added
    seconds : CPU, of all the lit pictures made with what there is so far, transport apart
    transport_s : CPU, of the transport, which is solved once and kept; 0 as long as there is none
    error : relative rms against the pictures with all effects, of the one that is furthest off
    """

    name: str
    seconds: float
    transport_s: float
    error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Realism:
    """A scene's pictures from bare single scattering to all of its effects of light.

    ``left_out`` is the sum of the bounds of what the tolerance did without.
    """

    scene: str
    tolerance: float
    method: str
    steps: tuple[Added, ...]
    left_out: float


def cost_of_realism(scene: Scene, rig: Rig, plan: Plan, progress: Progress) -> Realism:
    """Add a scene's effects of light one by one: what changes the transport, it, and the rest.

    The rest comes in the order in which it matters. Noise is no error of a picture, and what
    sensor and lamp do is not counted. Transport is computed anew, so that its time is that of a
    scene never seen before.

    Raises
    ------
    PlanError
        If the scene has no light.
    """
    about, images = situation_of(scene, rig, plan), lit_images(plan, rig)
    decisions = decide(about)
    used = [d for d in decisions if d.used and d.effect.kind in ("light", "transport")]
    if FIRST not in [d.name for d in used]:
        msg = f"scene {scene.name!r} has no single scattering; name it among its effects."
        raise PlanError(msg)
    parts = assemble(scene, rig, used)
    answer = solve(
        parts, about.periods_px, lambda done, total: progress("light", done, total), anew=True
    )

    def pictures(some: Sequence[Decision]) -> Mapping[str, Array]:
        return _pictures(scene, rig, some, answer, images, about.periods_px)

    truth = pictures(used)
    stages = _stages(used, lambda rest: change(truth, pictures(rest)), multiple=parts.multiple)
    steps = []
    for done, (name, together) in enumerate(stages):
        progress("effects", done, len(stages))
        found, seconds = _timed(pictures, together)
        solved = answer is not None and TOGETHER[0] in [d.name for d in together]
        steps.append(
            Added(
                name=name,
                seconds=seconds,
                transport_s=answer.seconds if answer and solved else 0.0,
                error=change(truth, found),
            )
        )
    return Realism(
        scene=scene.name,
        tolerance=scene.tolerance,
        method="none" if answer is None else answer.method,
        steps=tuple(steps),
        left_out=sum(d.bound for d in decisions if not d.used and d.asked != "never"),
    )


def _stages(
    used: list[Decision], missed: Callable[[list[Decision]], float], *, multiple: bool
) -> list[tuple[str, list[Decision]]]:
    """Return what is added, in order, each with all that there is then.

    ``missed`` tells how wrong pictures are that are made of some effects only.
    """
    others = [d for d in used if d.name not in (FIRST, *TOGETHER)]
    rest = [d for d in others if d.effect.kind == "light"]
    matters = {d.name: missed([one for one in used if one is not d]) for d in rest}
    rest.sort(key=lambda d: -matters[d.name])
    groups = [[FIRST], *([d.name] for d in others if d.effect.kind == "transport")]
    if multiple:
        groups.append(list(TOGETHER))
    groups += [[d.name] for d in rest]
    stages, there = [], set[str]()
    for group in groups:
        there.update(group)
        stages.append((group[0], [d for d in used if d.name in there]))
    return stages


def _timed(
    pictures: Callable[[Sequence[Decision]], Mapping[str, Array]], some: Sequence[Decision]
) -> tuple[Mapping[str, Array], float]:
    seconds = math.inf
    for _ in range(ROUNDS):
        begun_s = time.process_time()
        found = pictures(some)
        seconds = min(seconds, time.process_time() - begun_s)
    return found, seconds


def _pictures(
    scene: Scene,
    rig: Rig,
    some: Sequence[Decision],
    answer: Answer | None,
    images: Mapping[str, Image],
    periods_px: tuple[int, ...],
) -> Mapping[str, Array]:
    parts = assemble(scene, rig, some)
    picture = Picture(parts, answer if parts.multiple else None, periods_px=periods_px)
    return lit(picture, images)
