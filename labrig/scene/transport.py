"""Multiple scattering of a scene: by which method, and with how many waves of the stripes.

Nothing of a method is loaded before it is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from labrig.errors import PlanError
from labrig.scene.answer import Answer
from labrig.scene.effects.scattering import scattering_evenly
from labrig.scene.parts import Parts
from labrig.scene.stripes import FIRST, LAST, rms_beyond

Progress = Callable[[int, int], None]


def answer_of(
    parts: Parts,
    periods_px: Sequence[int],
    *,
    tolerance: float,
    progress: Progress | None = None,
    anew: bool = False,
) -> Answer:
    """Return the tank's multiple scattering under white light and stripes of some periods, px.

    The first and third harmonic are always there. The fifth and later ones are added where
    stripes would else be wrong by more than ``tolerance`` of the picture's rms.

    Raises
    ------
    analysis.errors.AnalysisError
        If the series of bounces has no end.
    """
    from labrig.scene.response import bounces_of  # noqa: PLC0415 - kernels

    bounces_of(parts.scene)  # refuses light without end before it is spread evenly
    if parts.isotropic and parts.scene.medium.g != 0.0:
        even = scattering_evenly(parts.scene.medium)
        scene = parts.scene.model_copy(update={"medium": even})
        parts = replace(parts, scene=scene, isotropic=False)
    mm_per_px = parts.rig.projection.mm_per_px
    wanted: dict[float, tuple[int, ...]] = {
        period * mm_per_px: FIRST for period in sorted(set(periods_px))
    }
    first = _solved(parts, wanted, progress, anew=anew)
    more = {p: FIRST + _higher(parts, first, p, tolerance) for p in wanted}
    return first if more == wanted else _solved(parts, more, progress)


def _solved(
    parts: Parts,
    harmonics: Mapping[float, tuple[int, ...]],
    progress: Progress | None,
    *,
    anew: bool = False,
) -> Answer:
    folded = parts.face_index != 1.0 or parts.wall_reflectance != 0.0
    if parts.scene.tank.height_mm is not None:
        _refuse_in_layer(parts, folded=folded)
    if parts.scene.transport.method == "ordinates":
        if folded or parts.defocus_px_per_mm:
            msg = (
                "walls that give light back, and a blur that grows with depth, are followed by the "
                "Monte Carlo only; set transport: {method: montecarlo}, or leave the effect out."
            )
            raise PlanError(msg)
        from labrig.scene.by_ordinates import answer_by_ordinates  # noqa: PLC0415 - kernels

        return answer_by_ordinates(parts.scene, harmonics, progress)
    from analysis.transport.montecarlo import Walls  # noqa: PLC0415 - kernels
    from labrig.scene.response import answer_by_montecarlo  # noqa: PLC0415

    walls, mm_per_px = None, parts.rig.projection.mm_per_px
    if folded or parts.defocus_px_per_mm:
        walls = Walls(
            face_index=parts.face_index,
            reflectance=parts.wall_reflectance,
            blur_mm=parts.blur_px * mm_per_px,
            growth=parts.defocus_px_per_mm * mm_per_px,
        )
    return answer_by_montecarlo(parts.scene, harmonics, walls, progress, anew=anew)


def _refuse_in_layer(parts: Parts, *, folded: bool) -> None:
    method, what = parts.scene.transport.method, ""
    if method != "montecarlo":
        what = f"transport: {{method: {method}}}"
    elif folded:
        what = "walls that give light back"
    elif parts.defocus_px_per_mm:
        what = "a blur that grows with depth"
    if what:
        msg = (
            f"{what}: not followed in a layer of known height, only by the plain Monte Carlo; "
            "leave it out, or leave tank.height_mm out."
        )
        raise PlanError(msg)


def _higher(parts: Parts, answer: Answer, period_mm: float, tolerance: float) -> tuple[int, ...]:
    """Return the harmonics after the first two that stripes of a period need.

    Finer waves are answered less than coarser ones, so the last known answer bounds the next.
    """
    period_px = period_mm / parts.rig.projection.mm_per_px
    last = answer.waves[period_mm, FIRST[-1]]
    answered = math.sqrt(float(np.mean(np.abs(last) ** 2)))
    seen = answer.fluence.sum(axis=0) + _beam_on(parts, answer)
    under_stripes = 0.5 * math.sqrt(float(np.mean(seen**2)))
    needed = []
    for harmonic in range(FIRST[-1], LAST, 2):
        missed = rms_beyond(harmonic, period_px, parts.blur_px) * answered
        if missed <= tolerance * under_stripes:
            break
        needed.append(harmonic + 2)
    return tuple(needed)


def _beam_on(parts: Parts, answer: Answer) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the white beam's light on the answer's places, coarsely."""
    beam = parts.scene.beam
    angle = math.radians(beam.angle_deg)
    entry = answer.y_mm[:, None] - math.tan(angle) * answer.x_mm[None, :]
    lit = (entry > beam.from_mm) & (entry < beam.to_mm)
    path = answer.x_mm[None, :] / math.cos(angle)
    return np.asarray(lit * np.exp(-parts.scene.medium.sigma_t_per_mm * path))
