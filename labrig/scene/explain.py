"""What each effect of a scene does to its pictures, and what it costs: measured, not estimated."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.simulation.sensor import Noise
from drivers.simulation.world import World
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.patterns import Image, draw
from labrig.plan import kinds_of_stripes
from labrig.scene.answer import Answer
from labrig.scene.decide import Decision, situation_of
from labrig.scene.effects.base import Kind, Situation
from labrig.scene.picture import Picture
from labrig.scene.pipeline import Seen, assemble, counting, solve

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What is known of one effect; both figures are None where it was not used.

    Attributes
    ----------
    seconds : CPU, what the lit pictures of the plan took more than without it, transport included,
        also where that was kept from before
    rms_percent : rms change of the lit pictures without it, of the one it changes most
    """

    decision: Decision
    seconds: float | None
    rms_percent: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """The lit pictures of a plan, which bounds are about: names, images, and the world they show.

    ``begins_s`` are the instants of the session at which sensor and lamp are looked at.
    """

    scene: Scene
    rig: Rig
    about: Situation
    images: Mapping[str, Image]
    begins_s: tuple[float, ...]


def explain(
    scene: Scene, rig: Rig, plan: Plan, seen: Seen, progress: Progress | None = None
) -> list[Told]:
    """Tell of each effect of a scene what it does, by leaving it out.

    An effect of light is judged by light, one of the sensor with all of the sensor's effects. One
    of the transport is left out of the transport, which is then solved once more.
    """
    about = situation_of(scene, rig, plan)
    shown = Shown(
        scene=scene,
        rig=rig,
        about=about,
        images=lit_images(plan, rig),
        begins_s=begins_of(about, seen.picture),
    )
    used = [d for d in seen.decisions if d.used]
    follow = progress or (lambda _what, _done, _total: None)
    told = []
    whole: dict[Kind, tuple[dict[str, Array], float]] = {}
    for done, decision in enumerate(seen.decisions):
        follow("effects", done, len(seen.decisions))
        if not decision.used:
            told.append(Told(decision=decision, seconds=None, rms_percent=None))
            continue
        kind = decision.effect.kind
        if kind not in whole:
            whole[kind] = _rendered(shown, used, seen.picture.answer, kind)
        rest = [d for d in used if d is not decision]
        answer = _answer(shown, rest, seen.picture.answer, kind, follow)
        pictures, seconds = _rendered(shown, rest, answer, kind)
        told.append(
            Told(
                decision=decision,
                seconds=max(whole[kind][1] - seconds, 0.0),
                rms_percent=100.0 * change(whole[kind][0], pictures),
            )
        )
    return told


def _answer(
    shown: Shown, used: list[Decision], whole: Answer | None, kind: Kind, follow: Progress
) -> Answer | None:
    """Return the multiple scattering with some effects less than the whole."""
    parts = assemble(shown.scene, shown.rig, used)
    if parts.multiple and kind != "transport":
        return whole
    return solve(parts, shown.about.periods_px, lambda done, total: follow("light", done, total))


def _rendered(
    shown: Shown, used: list[Decision], answer: Answer | None, kind: Kind
) -> tuple[dict[str, Array], float]:
    """Return what an effect of a kind is judged by, and the CPU seconds it takes."""
    begun_s = time.process_time()
    parts = assemble(shown.scene, shown.rig, used)
    if kind == "lamp" and parts.sensor is not None:
        parts = replace(parts, sensor=counting(parts.sensor))
    picture = Picture(parts, answer, periods_px=shown.about.periods_px)
    if kind in ("light", "transport"):
        found = lit(picture, shown.images)
    else:
        found = exposed(picture, shown.images, shown.about, shown.begins_s)
    transport_s = 0.0 if answer is None else answer.seconds
    return found, time.process_time() - begun_s + transport_s


def lit_images(plan: Plan, rig: Rig) -> dict[str, Image]:
    """Return a white image and the first of each kind of stripes, by name."""
    rows, cols = rig.projector.rows, rig.projector.cols
    images = {"white": np.full((rows, cols), 255, dtype=np.uint8)}
    for stripes in kinds_of_stripes(plan):
        image = draw(stripes, rows, cols, 0)
        if image is not None:
            images[f"stripes-{stripes.period_px}px"] = image
    return images


def lit(picture: Picture, images: Mapping[str, Image]) -> dict[str, Array]:
    """Return the light of each image on the sensor, electrons/s."""
    return {name: picture.light(image, picture.black_level) for name, image in images.items()}


def begins_of(about: Situation, *pictures: Picture) -> tuple[float, ...]:
    """Return when pictures are to be looked at: at the begin, and at the end if a lamp changes."""
    steady = all(picture.parts.lamp.steady for picture in pictures)
    return (0.0,) if steady else (0.0, about.duration_s)


def exposed(
    picture: Picture,
    images: Mapping[str, Image],
    about: Situation,
    begins_s: Sequence[float] = (0.0,),
    *,
    noisy: bool = True,
) -> dict[str, Array]:
    """Return what the sensor reads of each image, in electrons/s, less its black level.

    At the shortest and the longest exposure, begun at some instants of the session. Pictures
    that are to be compared must not be ``noisy``: a little more light is another draw.
    """
    parts = picture.parts
    if parts.sensor is None:
        return lit(picture, images)
    sensor, found = parts.sensor, {}
    if not noisy:
        sensor = replace(sensor, shot_noise=False, read_noise_e=0.0)
    noise = Noise(sensor, 1)
    for name, image in images.items():
        world = World(light=picture.light, lamp=parts.lamp, projector_black=parts.black_level)
        world.project(image, at_s=0.0)
        for begin_s in begins_s:
            for exposure_s in {about.exposures_s[0], about.exposures_s[-1]}:
                electrons = world.expose(begin_s, exposure_s, sensor.row_time_s)
                counts = noise.counts(electrons, exposure_s, name)
                scale = sensor.gain_dn_per_e * exposure_s
                found[f"{name}-{begin_s}-{exposure_s}"] = (counts - sensor.black_level_dn) / scale
    noise.close()
    return found


def change(base: Mapping[str, Array], other: Mapping[str, Array]) -> float:
    """Return the largest relative rms change of a picture."""
    worst = 0.0
    for name, picture in base.items():
        size = float(np.sqrt(np.mean(picture**2)))
        moved = float(np.sqrt(np.mean((other[name] - picture) ** 2)))
        worst = max(worst, moved / size if size > 0.0 else float(moved > 0.0))
    return worst
