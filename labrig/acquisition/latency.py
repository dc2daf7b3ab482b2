"""Measures a projector's latency on an open rig, and checks before a run that it still holds."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from calibration.latency import Flip, estimate_latency, times_of
from drivers.camera.protocol import CameraSettings
from drivers.projector.protocol import PatternHandle
from drivers.waiting import CancelToken
from labrig.errors import RunError
from labrig.models.latency import LatencyRecord
from labrig.models.plan import BlackPattern, UniformPattern
from labrig.patterns import draw
from labrig.rig import OpenRig

N_FLIPS = 50
N_CHECKS = 5
AFTER_S = 0.4  # watched after a request: the slowest projectors take a tenth of a second
BEFORE_FRAMES = 2
MARGIN_S = 1.0


def measure_latency(
    rig: OpenRig, *, flips: int = N_FLIPS, exposure_s: float = 0.02, seed: int = 1
) -> LatencyRecord:
    """Flip between black and white at random phase, and bound when the light has come.

    Raises
    ------
    RunError
        If the camera's time stamps do not mean what its driver says.
    CalibrationError
        If the light does not change.
    """
    if rig.camera_can.timestamp_source not in ("start", "end"):
        msg = (
            f"the camera's time stamps are {rig.camera_can.timestamp_source!r}: latency cannot be "
            "measured by it; give latency_s in the rig file with a wide margin."
        )
        raise RunError(msg)
    seen = _watch(rig, flips, (exposure_s, 2.0 * exposure_s), np.random.default_rng(seed))
    found = estimate_latency(seen, refresh_s=1.0 / rig.projector_can.refresh_hz)
    if found.timestamps != "start":
        msg = (
            f"the camera's time stamps were found to mean {found.timestamps!r} where the begin of "
            "the exposure was wanted; correct timestamp_source in the rig file or the driver."
        )
        raise RunError(msg)
    camera, projector = rig.camera.identity, rig.projector.identity
    return LatencyRecord.model_validate(
        {
            "schema": "labrig-latency/1",
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "earliest_s": round(found.earliest_s, 6),
            "latest_s": round(found.latest_s, 6),
            "settle_s": round(found.settle_s, 6),
            "jitter_s": round(found.jitter_s, 6),
            "flips": flips,
            "timestamps": found.timestamps,
            "camera": f"{camera['model']} {camera['serial']}",
            "projector": f"{projector['model']} {projector['serial']}",
        }
    )


def check_latency(rig: OpenRig, cancel: CancelToken) -> str:
    """Flip five times; return in words that the record still holds.

    Raises
    ------
    RunError
        If a flip lies outside the record's bounds.
    """
    record = rig.latency
    if record is None or rig.camera_can.timestamp_source not in ("start", "end"):
        return ""
    seen = _watch(rig, N_CHECKS, (0.02,), np.random.default_rng(), cancel)
    latency_s = [times_of(flip).latency_s for flip in seen]
    worst = max(latency_s)
    if worst > record.latest_s or min(latency_s) < record.earliest_s:
        msg = (
            f"light came {min(latency_s):.4f} .. {worst:.4f} s after the request, but "
            f"{record.earliest_s} .. {record.latest_s} s was calibrated: run labrig calibrate "
            "latency."
        )
        raise RunError(msg)
    return f"{N_CHECKS} flips agree with the latency of {record.date}: at most {worst:.4f} s"


def _watch(
    rig: OpenRig,
    flips: int,
    exposures_s: tuple[float, ...],
    rng: np.random.Generator,
    cancel: CancelToken | None = None,
) -> list[Flip]:
    cancel = cancel or CancelToken()
    rows, cols = rig.projector_can.rows, rig.projector_can.cols
    drawn = [
        draw(p, rows, cols, 0) for p in (UniformPattern(kind="uniform"), BlackPattern(kind="black"))
    ]
    handles = rig.projector.load([image for image in drawn if image is not None])
    seen: list[Flip] = []
    try:
        # what was shown before must be gone, or the first flip is measured by its going
        rig.projector.black(deadline_s=rig.now_s() + MARGIN_S, cancel=cancel)
        rig.clock.wait_until(rig.now_s() + AFTER_S, cancel)
        for k in range(flips):
            exposure_s = exposures_s[k // 2 % len(exposures_s)]
            rig.notice(f"flip-{k}", "show")
            seen.append(_flip(rig, handles[k % 2], exposure_s, rng.uniform(), cancel))
    finally:
        rig.camera.disarm()
        rig.projector.make_safe()
    return seen


def _flip(
    rig: OpenRig, handle: PatternHandle, exposure_s: float, phase: float, cancel: CancelToken
) -> Flip:
    """Show the other picture at a random phase of refresh and exposure; watch the light change."""
    camera, clock = rig.camera, rig.clock
    camera.disarm()
    camera.apply(CameraSettings(exposure_s=exposure_s))
    camera.arm("free-run")
    starts, means = [], []

    def look() -> float:
        frame = camera.collect(
            deadline_s=clock.now_s() + exposure_s + rig.camera_can.readout_s + MARGIN_S,
            cancel=cancel,
        )
        starts.append(frame.t_start_s if frame.t_start_s is not None else np.nan)
        means.append(float(np.mean(frame.pixels)))
        return starts[-1]

    for _ in range(BEFORE_FRAMES):
        look()
    clock.wait_until(clock.now_s() + phase * exposure_s, cancel)
    receipt = rig.projector.show(handle, deadline_s=clock.now_s() + MARGIN_S, cancel=cancel)
    while look() < receipt.requested_s + AFTER_S:
        pass
    return Flip(
        requested_s=receipt.requested_s,
        exposure_s=exposure_s,
        starts_s=np.array(starts),
        brightness_dn=np.array(means),
    )
