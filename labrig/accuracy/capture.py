"""What accuracy costs in capture time: standard deviations of a plan before it is run.

The Fisher information of the expected light under the camera's noise is that of the fit itself:
the fit is given what the plan would see, and states its covariance.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from analysis.errors import AnalysisError
from analysis.stripe_aware import fit_stripe_aware
from labrig.accuracy.expected import expect
from labrig.acquisition.estimate import estimate
from labrig.errors import PlanError
from labrig.models.plan import Plan, StripesPattern
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.plan import bracket_of, expand

NAMES = ("sigma_t", "sigma_s", "g")
REPEATS = (1, 2, 4, 8, 16)
LONGER = (2.0, 4.0, 8.0)
SHIFTS = (4, 6, 8, 12)
MORE_EXPOSURES = (1, 2)
EXPOSURE_STEP = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Priced:
    """One plan: what it changes, what it takes and what it reaches.

    Attributes
    ----------
    kind : which of its properties was changed; ``setting`` to what
    std : of sigma_t and sigma_s relative, of g absolute; NaN where it determines nothing
    reason : why it determines nothing, else empty
    """

    kind: str
    setting: str
    seconds: float
    std: Mapping[str, float]
    reason: str

    def meets(self, wanted: Mapping[str, float]) -> bool:
        """Return whether every wished uncertainty is reached."""
        return all(self.std[name] <= limit for name, limit in wanted.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureCosts:
    """Plans by what they change, the first being the plan itself; and the cheapest that will do."""

    plans: tuple[Priced, ...]
    wanted: Mapping[str, float]
    cheapest: Priced | None


def cost_of_capture(
    plan: Plan,
    rig: Rig,
    scene: Scene,
    wanted: Mapping[str, float],
    progress: Callable[[str, int, int], None] | None = None,
) -> CaptureCosts:
    """Predict the standard deviations of a plan and of costlier and cheaper ones like it.

    Parameters
    ----------
    wanted : relative standard deviation of sigma_t and sigma_s, absolute one of g, by name

    Raises
    ------
    PlanError
        If a name is unknown or the plan holds no stripes.
    """
    unknown = sorted(set(wanted) - set(NAMES))
    if unknown:
        msg = f"--want {unknown[0]}: unknown; choose of {', '.join(NAMES)}."
        raise PlanError(msg)
    plan = plan.model_copy(
        update={
            "exposures": plan.exposures.model_copy(
                update={"bracket_s": bracket_of(plan, rig), "auto": None}
            )
        }
    )
    candidates = list(_candidates(plan))
    priced = []
    for done, (kind, setting, one) in enumerate(candidates):
        if progress is not None:
            progress("predict", done, len(candidates))
        priced.append(_price(kind, setting, one, rig, scene))
    if progress is not None:
        progress("predict", len(candidates), len(candidates))
    enough = [p for p in priced if wanted and p.meets(wanted)]
    return CaptureCosts(
        plans=tuple(priced),
        wanted=dict(wanted),
        cheapest=min(enough, key=lambda p: p.seconds, default=None),
    )


def parse_wish(text: str) -> tuple[str, float]:
    """Return name and limit of a wish such as ``sigma_t=0.5%`` or ``g=0.005``.

    Raises
    ------
    PlanError
        If it is none.
    """
    name, _, value = text.partition("=")
    share = value.endswith("%")
    try:
        limit = float(value.removesuffix("%")) / (100.0 if share else 1.0)
    except ValueError:
        limit = math.nan
    if name not in NAMES or not (math.isfinite(limit) and limit > 0.0):
        msg = f"--want {text!r} is no wish; write sigma_t=0.5%, sigma_s=1% or g=0.005."
        raise PlanError(msg)
    return name, limit


def write_csv(costs: CaptureCosts, path: Path) -> None:
    """Write a line a plan."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["kind", "setting", "seconds", *(f"std_{name}" for name in NAMES), "reason"])
        for one in costs.plans:
            stds = [f"{one.std[name]:.4g}" for name in NAMES]
            table.writerow([one.kind, one.setting, f"{one.seconds:.4g}", *stds, one.reason])


def _price(kind: str, setting: str, plan: Plan, rig: Rig, scene: Scene) -> Priced:
    seconds = estimate(expand(plan, rig), rig).seconds.total
    medium = scene.medium.record()
    try:
        fit = fit_stripe_aware(
            expect(scene, rig, plan),
            sigma_t_per_mm=medium.sigma_t_per_mm,
            phase=medium.phase,
            near=medium,
        )
    except AnalysisError as error:
        nothing = dict.fromkeys(NAMES, math.nan)
        return Priced(kind=kind, setting=setting, seconds=seconds, std=nothing, reason=str(error))
    std = [math.sqrt(fit.covariance[k, k]) for k in range(3)]
    std[0] /= medium.sigma_t_per_mm
    std[1] /= medium.sigma_s_per_mm or math.nan
    return Priced(
        kind=kind,
        setting=setting,
        seconds=seconds,
        std=dict(zip(NAMES, std, strict=True)),
        reason="",
    )


def _candidates(plan: Plan) -> Iterator[tuple[str, str, Plan]]:
    bracket = plan.exposures.bracket_s or ()
    yield "this plan", plan.name, plan
    for factor in REPEATS[1:]:
        yield "more repeats", f"x {factor}", _with_stripes(plan, repeats=factor)
    for shifts in SHIFTS:
        if all(
            shifts != s.pattern.shifts and s.pattern.period_px % shifts == 0
            for s in plan.sets
            if isinstance(s.pattern, StripesPattern)
        ):
            yield "other shifts", f"{shifts} shifts", _with_stripes(plan, shifts=shifts)
    for times in LONGER:
        longer = tuple(t * times for t in bracket)
        yield "longer exposures", f"x {times:g}", _with_bracket(plan, longer)
    for more in MORE_EXPOSURES:
        added = tuple(max(bracket) * EXPOSURE_STEP ** (k + 1) for k in range(more))
        setting = " and ".join(f"{t:.3g} s" for t in added)
        yield "more exposures", setting, _with_bracket(plan, bracket + added)
    if len(bracket) > 1:
        yield "fewer exposures", f"{bracket[0]:.3g} s alone", _with_bracket(plan, bracket[:1])


def _with_stripes(plan: Plan, *, repeats: int = 1, shifts: int | None = None) -> Plan:
    sets = []
    for entry in plan.sets:
        if isinstance(entry.pattern, StripesPattern):
            pattern = entry.pattern
            if shifts is not None:
                pattern = pattern.model_copy(update={"shifts": shifts})
            entry = entry.model_copy(  # noqa: PLW2901 - the changed one takes its place
                update={"pattern": pattern, "repeats": entry.repeats * repeats}
            )
        elif entry.role in {"black", "white"}:
            entry = entry.model_copy(update={"repeats": entry.repeats * repeats})  # noqa: PLW2901
        sets.append(entry)
    return plan.model_copy(update={"sets": tuple(sets)})


def _with_bracket(plan: Plan, bracket_s: tuple[float, ...]) -> Plan:
    exposures = plan.exposures.model_copy(update={"bracket_s": bracket_s})
    return plan.model_copy(update={"exposures": exposures})
