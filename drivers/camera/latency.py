"""Measures how many frames still have the old exposure after a new one was set."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from drivers.camera.protocol import Camera, CameraSettings
from drivers.errors import SettingRefusedError
from drivers.waiting import CancelToken

ROUNDS = 8
PHASES_S = 0.2  # a change is made at a random moment of the camera's frame
WATCHED = 12  # frames after each change; cameras were seen to take up to six
RATIO = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureLatency:
    """How many frames may still have the old exposure after a change.

    ``frames`` is one more than the most seen, for the moment within a frame that was not hit;
    ``least_frames`` is the least seen.
    """

    frames: int
    least_frames: int


def probe(camera: Camera, *, short_s: float, cancel: CancelToken) -> ExposureLatency:
    """Change the exposure to and fro in free run and watch when the picture follows.

    Parameters
    ----------
    camera : open, looking at a steady light that ``short_s`` does not leave dark and four times
        that does not saturate

    Raises
    ------
    SettingRefusedError
        If the picture does not follow the exposure; too dark or saturated, most likely.
    DriverError
        As the camera raises it.
    """
    exposures = (short_s, RATIO * short_s)
    counted = []
    moment = np.random.default_rng(1)
    camera.arm("free-run")
    try:
        levels = [_settled(camera, exposure_s, cancel) for exposure_s in exposures]
        if levels[1] < 1.5 * levels[0] + 1.0:
            msg = (
                f"the picture has {levels[0]:.1f} counts at {exposures[0]} s, {levels[1]:.1f} at "
                f"{exposures[1]} s; give more light or less, so that it follows the exposure."
            )
            raise SettingRefusedError(msg)
        middle = (levels[0] * levels[1]) ** 0.5
        for k in range(ROUNDS):
            bright = k % 2 == 1
            cancel.wait(moment.uniform(0.0, PHASES_S))
            means = _after_change(camera, exposures[bright], cancel)
            late = [n for n, mean in enumerate(means, start=1) if (mean > middle) != bright]
            counted.append(max(late, default=0))
    finally:
        camera.disarm()
    return ExposureLatency(frames=max(counted) + 1, least_frames=min(counted))


def _settled(camera: Camera, exposure_s: float, cancel: CancelToken) -> float:
    return _after_change(camera, exposure_s, cancel)[-1]


def _after_change(camera: Camera, exposure_s: float, cancel: CancelToken) -> list[float]:
    """Return the mean counts of the frames that come after an exposure was set."""
    camera.apply(CameraSettings(exposure_s=exposure_s))
    camera.flush()
    limit_s = time.monotonic() + WATCHED * (RATIO * exposure_s + 1.0)
    return [
        float(camera.collect(deadline_s=limit_s, cancel=cancel).pixels.mean())
        for _ in range(WATCHED)
    ]
