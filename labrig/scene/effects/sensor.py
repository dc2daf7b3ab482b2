"""The camera's sensor: what of it a scene asks for; the sensor itself is the simulated camera's."""

from __future__ import annotations

import math
from dataclasses import replace

from labrig.errors import PlanError
from labrig.models.effects import (
    BloomingConfig,
    HotPixelsConfig,
    ResponseConfig,
    RollingShutterConfig,
    Word,
)
from labrig.models.rig import SimulatedCameraConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.parts import Parts

SRGB_AT_BLACK = 12.92  # its slope there (IEC 61966-2-1)


def camera_of(about: Situation | Parts) -> SimulatedCameraConfig:
    """Return the simulated camera; a real one brings its own effects."""
    camera = about.rig.camera
    if not isinstance(camera, SimulatedCameraConfig):
        msg = (
            f"rig {about.rig.name!r} has a real camera, whose sensor is not simulated; choose a "
            "rig with a simulated one, or leave the sensor's effects out."
        )
        raise PlanError(msg)
    return camera


def brightest_e(about: Situation) -> float:
    """Return a bound of the electrons in a pixel at the longest exposure."""
    light, irradiance = about.scene.light, about.scene.beam_inside().record().profile_points()[1]
    most = light.peak_e_per_s * float(irradiance.max()) * (1.0 + about.multiple_at_most)
    return (most + light.ambient_e_per_s) * about.exposures_s[-1]


def lift(about: Situation) -> float:
    """Return how much larger noise stands in the counts, at most, than in the electrons.

    sRGB's slope at black; a picture's rms in its counts is not below that of its light.
    """
    effects = about.scene.effects
    asked = "auto" if effects is None else effects.response
    if asked is None or asked == "never":
        return 1.0
    curve = (
        asked.curve if isinstance(asked, ResponseConfig) else None
    ) or about.rig.camera.response
    return 1.0 if curve == "linear" else SRGB_AT_BLACK


def _with(parts: Parts, **changes: object) -> Parts:
    sensor = parts.sensor
    return parts if sensor is None else replace(parts, sensor=replace(sensor, **changes))  # type: ignore[arg-type]


class ShotNoise(Effect[Word]):
    """Electrons come by chance (Poisson): their variance is their mean."""

    kind, cost = "sensor", "a random number for each pixel"

    def bound(self, about: Situation) -> Bound:
        """Return sqrt(mean) over rms of the dimmest picture; the mean is below the rms."""
        electrons = about.dimmest_e_per_s * about.exposures_s[0]
        size = 1.0 / math.sqrt(electrons) if electrons > 0.0 else math.inf
        why = f"{electrons:.3g} electrons (rms) in the shortest exposure"
        return Bound(lift(about) * size, why)

    def onto(self, parts: Parts) -> Parts:
        """Draw the electrons."""
        return _with(parts, shot_noise=True)


class ReadNoise(Effect[Word]):
    """Reading a pixel adds normal noise."""

    kind, cost = "sensor", "a random number for each pixel"

    def bound(self, about: Situation) -> Bound:
        """Return it over the rms of the dimmest picture."""
        noise = camera_of(about).read_noise_e
        size = about.of_rms(noise / about.exposures_s[0])
        return Bound(lift(about) * size, f"{noise:g} electrons")

    def onto(self, parts: Parts) -> Parts:
        """Add it."""
        return _with(parts, read_noise_e=camera_of(parts).read_noise_e)


class Quantisation(Effect[Word]):
    """Counts are whole. The frames of a session always are, whatever a scene says."""

    kind, cost = "sensor", "a rounding"

    def bound(self, about: Situation) -> Bound:
        """Return a count over sqrt(12), as a share of the dimmest picture."""
        electrons = 1.0 / (math.sqrt(12.0) * camera_of(about).gain_dn_per_e)
        return Bound(about.of_rms(electrons / about.exposures_s[0]), "a count over sqrt(12)")

    def onto(self, parts: Parts) -> Parts:
        """Round the counts."""
        return _with(parts, quantised=True)


class Saturation(Effect[Word]):
    """Counts end at the white level."""

    kind, cost = "sensor", "a comparison"

    def bound(self, about: Situation) -> Bound:
        """Return zero if not even the brightest pixel can reach it."""
        camera = camera_of(about)
        full = (camera.white_level_dn - camera.black_level_dn) / camera.gain_dn_per_e
        bright = brightest_e(about) + camera.hot_e_per_s * about.exposures_s[-1]
        # Noise may lift a pixel by some deviations.
        reach = bright + 8.0 * math.sqrt(bright + camera.read_noise_e**2)
        if reach <= full:
            return Bound(0.0, f"at most {reach:.3g} of {full:.3g} electrons")
        return Bound(math.inf, f"up to {reach:.3g} of {full:.3g} electrons")

    def onto(self, parts: Parts) -> Parts:
        """Clip the counts."""
        return _with(parts, saturates=True)


class Blooming(Effect[BloomingConfig]):
    """Charge above full well spills up and down its column."""

    kind, cost = "sensor", "passes over the picture until nothing spills"

    def bound(self, about: Situation) -> Bound:
        """Return zero if no pixel can be full."""
        full = Saturation("auto").bound(about)
        share = self.parameters.share
        return Bound(full.value if share else 0.0, full.why)

    def onto(self, parts: Parts) -> Parts:
        """Let charge spill."""
        return _with(parts, blooming=self.parameters.share)


class Response(Effect[ResponseConfig]):
    """Counts are not proportional to electrons but bent, as those of a webcam."""

    kind, cost = "sensor", "a power for each pixel"

    def _curve(self, about: Situation | Parts) -> str:
        return self.parameters.curve or about.rig.camera.response

    def bound(self, about: Situation) -> Bound:
        """Return zero for a linear camera; sRGB lifts dark counts without bound."""
        if self._curve(about) == "linear":
            return Bound(0.0, "counts are linear")
        return Bound(math.inf, "sRGB lifts dark counts twelvefold")

    def onto(self, parts: Parts) -> Parts:
        """Bend the counts."""
        return _with(parts, response=self._curve(parts))


class HotPixels(Effect[HotPixelsConfig]):
    """Some pixels collect electrons without light."""

    kind, cost = "sensor", "a copy of the picture"

    def _figures(self, about: Situation | Parts) -> tuple[int, float]:
        own, camera = self.parameters, camera_of(about)
        number = camera.hot_pixels if own.number is None else own.number
        return number, camera.hot_e_per_s if own.e_per_s is None else own.e_per_s

    def bound(self, about: Situation) -> Bound:
        """Return their rms over the sensor."""
        number, rate = self._figures(about)
        camera = camera_of(about)
        rms = rate * math.sqrt(number / (camera.rows * camera.cols))
        return Bound(about.of_rms(rms), f"{number} of {rate:g} electrons/s")

    def onto(self, parts: Parts) -> Parts:
        """Let them glow."""
        number, rate = self._figures(parts)
        return _with(parts, hot_pixels=number, hot_e_per_s=rate)


class RollingShutter(Effect[RollingShutterConfig]):
    """Each row begins later than the one above; it shows where the light changes meanwhile."""

    kind, cost = "sensor", "an exposure for each row"

    def _row_s(self, about: Situation | Parts) -> float:
        own = self.parameters.row_time_s
        return camera_of(about).row_time_s if own is None else own

    def bound(self, about: Situation) -> Bound:
        """Return zero for a global shutter; else the change of pictures is in the rows."""
        row_s = self._row_s(about)
        if row_s == 0.0:
            return Bound(0.0, "a global shutter")
        return Bound(
            math.inf, f"{1e3 * row_s * about.rig.camera.rows:.3g} ms from first to last row"
        )

    def onto(self, parts: Parts) -> Parts:
        """Delay the rows."""
        return _with(parts, row_time_s=self._row_s(parts))
