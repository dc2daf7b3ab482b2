"""What realism costs: how wrong a picture is, and how long it takes, as effects are added."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from labrig.errors import PlanError
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.patterns import Image
from labrig.scene.answer import Answer, Array
from labrig.scene.decide import Decision, decide, situation_of
from labrig.scene.explain import change, lit_images
from labrig.scene.picture import Picture
from labrig.scene.pipeline import assemble, solve

LAST = ("multiple-scattering", "anisotropy")  # together: both are the one transport
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Added:
    """The picture with one effect more.

    Attributes
    ----------
    name : of what was added
    seconds : CPU, of all the lit pictures made with what there is so far, transport included
    error : relative rms against the pictures with all effects, of the one that is furthest off
    """

    name: str
    seconds: float
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
    """Add a scene's effects of light one by one, multiple scattering last.

    Noise is no error of a picture, and what sensor and lamp do is not counted. Transport is
    computed anew, so that its time is that of a scene never seen before.

    Raises
    ------
    PlanError
        If the scene has no light.
    """
    about, images = situation_of(scene, rig, plan), lit_images(plan, rig)
    decisions = decide(about)
    used = [d for d in decisions if d.used and d.effect.kind in ("light", "transport")]
    single = [d for d in used if d.name == "single-scattering"]
    if not single:
        msg = f"scene {scene.name!r} has no single scattering; name it among its effects."
        raise PlanError(msg)
    parts = assemble(scene, rig, used)
    begun_s = time.process_time()
    answer = solve(
        parts, about.periods_px, lambda done, total: progress("light", done, total), anew=True
    )
    transport_s = time.process_time() - begun_s
    others = [d for d in used if d.name not in (*LAST, "single-scattering")]
    order = {d.name: n for n, d in enumerate(used)}
    stages = [("single scattering", single)]
    for decision in others:
        together = sorted([*stages[-1][1], decision], key=lambda d: order[d.name])
        stages.append((decision.name, together))
    if parts.multiple:
        stages.append(("multiple scattering", used))
    whole = Picture(parts, answer, periods_px=about.periods_px)
    truth = {name: whole.light(image, parts.black_level) for name, image in images.items()}
    steps = []
    for done, (name, together) in enumerate(stages):
        progress("effects", done, len(stages))
        found, took_s = _pictures(scene, rig, together, answer, images, about.periods_px)
        if name == "multiple scattering":
            took_s += transport_s
        steps.append(Added(name=name, seconds=took_s, error=change(truth, found)))
    return Realism(
        scene=scene.name,
        tolerance=scene.tolerance,
        method="none" if answer is None else answer.method,
        steps=tuple(steps),
        left_out=sum(d.bound for d in decisions if not d.used and d.asked != "never"),
    )


def _pictures(
    scene: Scene,
    rig: Rig,
    together: list[Decision],
    answer: Answer | None,
    images: dict[str, Image],
    periods_px: tuple[int, ...],
) -> tuple[dict[str, Array], float]:
    begun_s = time.process_time()
    parts = assemble(scene, rig, together)
    picture = Picture(parts, answer if parts.multiple else None, periods_px=periods_px)
    found = {name: picture.light(image, parts.black_level) for name, image in images.items()}
    return found, time.process_time() - begun_s
