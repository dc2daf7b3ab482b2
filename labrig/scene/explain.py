"""What each effect of a scene does to its pictures, and what it costs: measured, not estimated."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
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
from labrig.scene.decide import Decision, situation_of
from labrig.scene.effects.base import Situation
from labrig.scene.parts import Parts
from labrig.scene.picture import Picture
from labrig.scene.pipeline import Seen, assemble, counting, solve

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What is known of one effect.

    Attributes
    ----------
    seconds : CPU, what the lit pictures of the plan took more than without it; the transport's
        with multiple scattering; None where it was not used or shares the transport's
    rms_percent : rms change of the lit pictures without it, of the one it changes most; None if
        not used, or if another transport would have to be computed to tell
    """

    decision: Decision
    seconds: float | None
    rms_percent: float | None


def lit_images(plan: Plan, rig: Rig) -> dict[str, Image]:
    """Return a white image and the first of each kind of stripes, by name."""
    rows, cols = rig.projector.rows, rig.projector.cols
    images = {"white": np.full((rows, cols), 255, dtype=np.uint8)}
    for stripes in kinds_of_stripes(plan):
        image = draw(stripes, rows, cols, 0)
        if image is not None:
            images[f"stripes-{stripes.period_px}px"] = image
    return images


def exposed(
    picture: Picture,
    parts: Parts,
    images: Mapping[str, Image],
    about: Situation,
    *,
    noisy: bool = True,
) -> dict[str, Array]:
    """Return what the sensor reads of each image, in electrons/s, less its black level.

    At the shortest and the longest exposure, at the begin and at the end of the session. Pictures
    that are to be compared must not be ``noisy``: a little more light is another draw.
    """
    if parts.sensor is None:
        return {name: picture.light(image, parts.black_level) for name, image in images.items()}
    sensor, found = parts.sensor, {}
    if not noisy:
        sensor = replace(sensor, shot_noise=False, read_noise_e=0.0)
    noise = Noise(sensor, 1)
    ends = {0.0, about.duration_s} if not parts.lamp.steady else {0.0}
    for name, image in images.items():
        for begin_s in sorted(ends):
            world = World(light=picture.light, lamp=parts.lamp, projector_black=parts.black_level)
            world.project(image, at_s=0.0)
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


def explain(
    scene: Scene,
    rig: Rig,
    plan: Plan,
    seen: Seen,
    progress: Callable[[int, int], None] | None = None,
) -> list[Told]:
    """Tell of each effect of a scene what it does, by leaving it out.

    An effect of light is judged by light, one of the sensor with all of the sensor's effects.
    """
    about, images = situation_of(scene, rig, plan), lit_images(plan, rig)
    told, used = [], [d for d in seen.decisions if d.used]
    base: dict[str, tuple[dict[str, Array], float]] = {}
    for done, decision in enumerate(seen.decisions):
        if progress is not None:
            progress(done, len(seen.decisions))
        if not decision.used:
            told.append(Told(decision=decision, seconds=None, rms_percent=None))
            continue
        effect = decision.effect
        if effect.kind not in base:
            base[effect.kind] = _rendered(seen, scene, rig, used, images, about, effect.kind)
        rest = [d for d in used if d is not decision]
        known = _without(seen, assemble(scene, rig, rest), decision, about)
        if known is None:
            told.append(Told(decision=decision, seconds=None, rms_percent=None))
            continue
        pictures, took_s = _rendered(known, scene, rig, rest, images, about, effect.kind)
        seconds = max(base[effect.kind][1] - took_s, 0.0)
        if decision.name == "multiple-scattering":
            seconds += seen.transport_s
        percent = 100.0 * change(base[effect.kind][0], pictures)
        told.append(Told(decision=decision, seconds=seconds, rms_percent=percent))
    return told


def _rendered(
    seen: Seen,
    scene: Scene,
    rig: Rig,
    used: list[Decision],
    images: Mapping[str, Image],
    about: Situation,
    kind: str,
) -> tuple[dict[str, Array], float]:
    """Return the pictures of a world and the CPU seconds they take, its transport being known."""
    begun_s = time.process_time()
    parts = assemble(scene, rig, used)
    picture = Picture(parts, seen.picture.answer, periods_px=about.periods_px)
    if kind in ("light", "transport"):
        found = {name: picture.light(image, parts.black_level) for name, image in images.items()}
    else:
        if kind == "lamp" and parts.sensor is not None:
            parts = replace(parts, sensor=counting(parts.sensor))
        found = exposed(picture, parts, images, about)
    return found, time.process_time() - begun_s


def _without(seen: Seen, parts: Parts, decision: Decision, about: Situation) -> Seen | None:
    """Return the scene's light without an effect; None if a Monte Carlo would be needed anew."""
    answer = seen.picture.answer
    if not parts.multiple:
        answer = None
    elif decision.effect.kind == "transport":
        if parts.scene.transport.method == "montecarlo":
            return None
        answer = solve(parts, about.periods_px)
    picture = Picture(parts, answer, periods_px=about.periods_px)
    return Seen(picture=picture, decisions=seen.decisions, transport_s=0.0)
