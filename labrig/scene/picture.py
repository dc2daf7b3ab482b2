"""The picture of the tank under any projector image, in electrons/s on the camera's pixels.

Without noise: noise is the camera's.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.errors import PlanError, RunError
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.patterns import Image
from labrig.scene.answer import Answer, Wave, between
from labrig.scene.parts import Parts
from labrig.scene.single import REACH, Places, rays, single_scattering
from labrig.scene.stripes import coefficients

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What the light is made of under a white projector, electrons/s, in the tank's orientation.

    Attributes
    ----------
    single, multiple : (rows, cols), in the region's pixels
    bounces : (K - 1, n_y, n_x), bounces 2 .. K where the answer has them; empty without multiple
        scattering
    y_mm, x_mm : (n_y,), (n_x,), where these are
    method : what computed them: montecarlo, ordinates or none
    """

    single: Array
    multiple: Array
    bounces: Array
    y_mm: Array
    x_mm: Array
    method: str


class Picture:
    """A scene as the camera of a rig sees it.

    Parameters
    ----------
    parts : the simulated world
    answer : multiple scattering; None if there is none
    periods_px : of the stripes that may be shown
    """

    def __init__(
        self, parts: Parts, answer: Answer | None, *, periods_px: tuple[int, ...] = ()
    ) -> None:
        self.parts = parts
        self.answer = answer
        self._periods_px = tuple(sorted(set(periods_px)))
        self._kept: dict[str, Array] = {}
        self._region, self._places = places_of(parts.rig, parts.scene)
        _refuse_dark_edges(parts)
        self._white = None
        self._waves: dict[tuple[float, int], Wave] = {}
        if answer is not None:
            self._white = self._on_pixels(answer, answer.fluence.sum(axis=0)).real
            self._waves = {k: self._on_pixels(answer, wave) for k, wave in answer.waves.items()}

    @property
    def black_level(self) -> float:
        """Light of a black projector pixel as a share of a white one."""
        return self.parts.black_level

    def light(self, image: Image | None, black_level: float) -> Array:
        """Return electrons/s on the sensor, (rows, cols), for a projector image, None for off."""
        name = "off" if image is None else hashlib.sha256(image.tobytes()).hexdigest()
        key = f"{name} {black_level}"
        if key not in self._kept:
            camera = self.parts.rig.camera
            seen = np.full((camera.rows, camera.cols), self.parts.ambient_e_per_s)
            if image is not None:
                single, multiple = self.parted(image, black_level)
                x, y, width, height = self._region
                seen[y : y + height, x : x + width] += self._turned(single + multiple)
            for step in self.parts.optics:
                seen = step(seen)
            self._kept[key] = seen
        return self._kept[key]

    def parted(self, image: Image, black_level: float) -> tuple[Array, Array]:
        """Return single and multiple scattering under an image, electrons/s in the tank."""
        levels = self._line(image) / 255.0
        if self.parts.transfer is not None:
            levels = self.parts.transfer(levels)
        levels = black_level + (1.0 - black_level) * levels
        peak = self.parts.scene.light.peak_e_per_s * self.parts.transmission
        return peak * self._single(levels), peak * self._multiple(levels)

    def truth(self, black_level: float) -> Truth:
        """Return the light under white less that under black, apart, as the analysis sees it."""
        full = np.full(self.parts.rig.projector.cols, 1.0 - black_level)
        peak = self.parts.scene.light.peak_e_per_s * self.parts.transmission
        answer = self.answer
        none = np.empty(0)
        return Truth(
            single=peak * self._single(full),
            multiple=peak * self._multiple(full),
            bounces=np.empty((0, 0, 0))
            if answer is None
            else peak * (1.0 - black_level) * answer.fluence,
            y_mm=none if answer is None else answer.y_mm,
            x_mm=none if answer is None else answer.x_mm,
            method="none" if answer is None else answer.method,
        )

    def noise(self) -> float:
        """Return the rms noise of the multiple scattering, of a white picture's rms; 0 if solved.

        At most so much: the noise of the bounces is added up as if it were all the same.
        """
        answer = self.answer
        if answer is None or answer.std_error is None:
            return 0.0
        truth = self.truth(0.0)
        peak = self.parts.scene.light.peak_e_per_s * self.parts.transmission
        noise = peak * answer.std_error.sum(axis=0)
        light = truth.single + truth.multiple
        return math.sqrt(float(np.mean(noise**2) / np.mean(light**2)))

    def _single(self, levels: Array) -> Array:
        if not self.parts.single:
            return np.zeros((self._places.y_mm.size, self._places.x_mm.size))
        return single_scattering(self.parts, levels, self._places)

    def _multiple(self, levels: Array) -> Array:
        """Return the sum of bounces 2 .. K under stripes of a period foreseen, or uniform light."""
        if self._white is None:
            return np.zeros((self._places.y_mm.size, self._places.x_mm.size))
        if np.ptp(levels) == 0.0:
            return np.asarray(np.maximum(levels[0] * self._white, 0.0))
        projection, period_px = self.parts.rig.projection, self._period_of(levels)
        period_mm = period_px * projection.mm_per_px
        known = sorted(h for period, h in self._waves if period == period_mm)
        mean, *others = coefficients(levels, period_px, known, self.parts.blur_px)
        ray = rays(self.parts, self._places.y_mm, self._places.x_mm)
        phase = 2j * np.pi * (ray.entry_mm - projection.origin_mm) / period_mm
        total = mean.real * self._white
        for harmonic, coefficient in zip(known, others, strict=True):
            if abs(coefficient) > 1e-12:
                turned = 2.0 * coefficient * np.exp(harmonic * phase)
                wave = self._waves[period_mm, harmonic]
                total += turned.real * wave.real
                total -= turned.imag * wave.imag
        # A cut series with the noise of a Monte Carlo may undershoot; light cannot.
        return np.asarray(np.maximum(total, 0.0, out=total))

    def _period_of(self, levels: Array) -> int:
        """Return the shortest period, px, of those foreseen with which the levels repeat.

        Raises
        ------
        RunError
            If there is none.
        """
        for period in self._periods_px:
            if (levels[period:] == levels[:-period]).all():
                return period
        foreseen = " or ".join(str(period) for period in self._periods_px) or "no"
        msg = (
            f"the projector image does not repeat every {foreseen} px, as the scene's answer "
            "assumes; show stripes of the plan's period or a uniform image."
        )
        raise RunError(msg)

    def _on_pixels(self, answer: Answer, values: Array | Wave) -> Wave:
        """Return what stands on the answer's places at the camera's pixels."""
        places = self._places
        if math.isinf(self.parts.divergence_mm):
            return between(values, answer.y_mm, answer.x_mm, places.y_mm, places.x_mm)
        # A beam that spreads carries its scattered light along: the tank stretches with depth.
        ray = rays(self.parts, places.y_mm, places.x_mm)
        straight = rays_back(self.parts, ray.entry_mm, places.x_mm)
        fine = between(values, answer.y_mm, answer.x_mm, places.y_mm, places.x_mm)
        found = np.empty_like(fine)
        for n in range(places.x_mm.size):
            found[:, n] = np.interp(straight[:, n], places.y_mm, fine[:, n])
        return found * ray.dilution

    def _line(self, image: Image) -> Array:
        """Return the image along the axis in which its brightness varies, which is tank y.

        Raises
        ------
        RunError
            If it varies along the other axis.
        """
        if (image != image[0]).any():
            msg = "the projector image varies along y, the rig maps x to the tank; set axis: x."
            raise RunError(msg)
        return np.asarray(image[0], dtype=np.float64)

    def _turned(self, tank: Array) -> Array:
        """Return a picture in tank orientation (lit side left) as the camera sees it."""
        side = self.parts.rig.geometry.lit_side
        if side == "right":
            return tank[:, ::-1]
        if side == "top":
            return tank.T
        if side == "bottom":
            return tank.T[::-1]
        return tank


def rays_back(parts: Parts, entry_mm: Array, x_mm: Array) -> Array:
    """Return the heights at which a beam that did not spread would be, for heights of entry."""
    slope = math.tan(math.radians(parts.scene.beam.angle_deg))
    return np.asarray(entry_mm + slope * x_mm[None, :])


def places_of(rig: Rig, scene: Scene) -> tuple[tuple[int, int, int, int], Places]:
    """Return the region of the sensor that shows the tank, px, and its pixels in the tank.

    Raises
    ------
    RunError, PlanError
        If the rig does not say where the tank is, or shows another one.
    """
    geometry, camera, tank = rig.geometry, rig.camera, scene.tank
    if geometry.mm_per_px is None or geometry.region_px is None:
        msg = f"rig {rig.name!r}: a simulated camera needs geometry.mm_per_px and region_px."
        raise RunError(msg)
    x, y, width, height = region = geometry.region_px
    if x + width > camera.cols or y + height > camera.rows:
        msg = f"region_px {list(region)} leaves {camera.cols} x {camera.rows} px."
        raise PlanError(msg)
    along, across = (width, height)
    if geometry.lit_side in {"top", "bottom"}:
        along, across = (height, width)
    pixel_mm = geometry.mm_per_px
    seen = (along * pixel_mm, across * pixel_mm)
    wanted = (tank.depth_mm, tank.width_mm)
    if max(abs(a - b) for a, b in zip(seen, wanted, strict=True)) > pixel_mm:
        msg = (
            f"the region shows {seen[0]:g} x {seen[1]:g} mm, the scene's tank is "
            f"{wanted[0]:g} x {wanted[1]:g} mm; mend region_px or the tank."
        )
        raise PlanError(msg)
    return region, Places(
        x_mm=np.asarray((np.arange(along) + 0.5) * pixel_mm),
        y_mm=np.asarray((np.arange(across) + 0.5) * pixel_mm),
        pixel_mm=pixel_mm,
    )


def _refuse_dark_edges(parts: Parts) -> None:
    projection, beam = parts.rig.projection, parts.scene.beam
    blur_px = parts.blur_px + parts.defocus_px_per_mm * parts.scene.tank.depth_mm
    reach = REACH * blur_px * projection.mm_per_px
    first = projection.origin_mm
    last = first + parts.rig.projector.cols * projection.mm_per_px
    if first > beam.from_mm - reach or last < beam.to_mm + reach:
        msg = (
            f"the projector lights {first:g} .. {last:g} mm, not the whole beam "
            f"{beam.from_mm:g} .. {beam.to_mm:g} mm and the reach of its blur; mend projection."
        )
        raise PlanError(msg)
