"""What a plan costs: seconds by cause, and bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from labrig.models.plan import Plan, Shot
from labrig.models.rig import Rig
from labrig.plan import CapturePlan, blocks_of, expand

COMMIT_S = 0.007  # of one frame, as measured; frames are kept while the next is exposed
FILE_BYTES = 2048  # header, description and journal line of a frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Seconds:
    """Where the time of a capture goes, s."""

    warm_up: float
    settle: float
    exposure: float
    exposure_switch: float
    readout: float
    references: float
    writing: float

    @property
    def total(self) -> float:
        """All of it."""
        return float(sum(asdict(self).values()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What a plan costs; ``other_order`` is the same with the other order outermost."""

    n_shots: int
    n_groups: int
    seconds: Seconds
    other_order: Seconds
    n_bytes: int


def estimate(expanded: CapturePlan, rig: Rig, *, wait_s: float | None = None) -> Estimate:
    """Return what a plan costs on a rig.

    Parameters
    ----------
    wait_s : from a request to settled light; else what the rig file says
    """
    plan = expanded.plan
    outer = "pattern" if plan.order.outer == "exposure" else "exposure"
    turned = plan.model_copy(update={"order": plan.order.model_copy(update={"outer": outer})})
    p = rig.projector
    rest_s = p.latency_s + p.jitter_s + 1.0 / p.refresh_hz + settle_of(plan, p.settle_s)
    return Estimate(
        n_shots=len(expanded.shots),
        n_groups=len({shot.group for shot in expanded.shots}),
        seconds=_seconds(plan, expanded.shots, rig, wait_s or rest_s),
        other_order=_seconds(plan, expand(turned, rig).shots, rig, wait_s or rest_s),
        n_bytes=bytes_of(expanded, rig.camera.rows, rig.camera.cols),
    )


def settle_of(plan: Plan, calibrated_s: float) -> float:
    """Return the settle time of a plan: never below the calibrated one."""
    asked = plan.timing.settle_s
    return calibrated_s if asked == "calibrated" else max(float(asked), calibrated_s)


def discard_of(plan: Plan, latency_frames: int) -> int:
    """Return how many frames are thrown away after a change of exposure."""
    asked = plan.timing.discard_after_exposure_change
    return latency_frames if asked == "capability" else max(int(asked), latency_frames)


def bytes_of(
    expanded: CapturePlan, rows: int, cols: int, shots: Sequence[Shot] | None = None
) -> int:
    """Return the bytes of a session's frames and patterns; of some ``shots`` if these are given."""
    frames = 2 * rows * cols + FILE_BYTES
    if shots is not None:
        return len(shots) * frames
    patterns = sum(image.nbytes // 50 for image in expanded.images.values())
    return len(expanded.shots) * frames + patterns + (1 << 20)


def _seconds(plan: Plan, shots: Sequence[Shot], rig: Rig, wait_s: float) -> Seconds:
    shown = switched = 0.0
    before: Shot | None = None
    discard = discard_of(plan, rig.camera.exposure_latency_frames)
    for shot in shots:
        looks = (shot.pattern, shot.shutter)
        shown += before is None or looks != (before.pattern, before.shutter)
        if before is None or before.exposure_s != shot.exposure_s:
            switched += discard * (shot.exposure_s + rig.camera.readout_s)
        before = shot
    exposures_s = sum(shot.exposure_s for shot in shots)
    shortest_s = min(shot.exposure_s for shot in shots)
    busy_s = shown * wait_s + exposures_s + len(shots) * rig.camera.readout_s
    return Seconds(
        warm_up=plan.timing.warmup_s,
        settle=shown * wait_s,
        exposure=exposures_s,
        exposure_switch=switched,
        readout=len(shots) * rig.camera.readout_s,
        references=4.0 * (wait_s + shortest_s + rig.camera.readout_s),
        writing=max(len(shots) * COMMIT_S - busy_s, 0.0) + COMMIT_S * len(blocks_of(shots)),
    )
