"""The picture of the tank under any projector image: single and multiple scattering, ambient.

All of it in electrons per second on the camera's pixels, without noise; noise is the camera's.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import erf

from labrig.errors import PlanError, RunError
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.patterns import Image
from labrig.scene.response import HARMONICS, TankResponse

Array = NDArray[np.float64]

REACH = 6.0  # standard deviations beyond which a blurred edge is flat, to 1e-9
SUBPIXELS = 8  # samples of a camera row, across the stripes


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What the light is made of under a white projector, electrons/s in the region's pixels.

    Attributes
    ----------
    single, multiple : (rows, cols)
    bounces : (K - 1, rows, cols) on the response's own cells, bounces 2 .. K, same units
    """

    single: Array
    multiple: Array
    bounces: Array


class Picture:
    """A scene as the camera of a rig sees it."""

    def __init__(self, scene: Scene, rig: Rig, response: TankResponse, *, period_px: int) -> None:
        self._scene = scene
        self._rig = rig
        self._response = response
        self._period_px = period_px
        self._kept: dict[str, Array] = {}
        geometry = rig.geometry
        if geometry.mm_per_px is None or geometry.region_px is None:
            msg = f"rig {rig.name!r}: a simulated camera needs geometry.mm_per_px and region_px."
            raise RunError(msg)
        self._pixel_mm = geometry.mm_per_px
        self._region = geometry.region_px
        self._refuse_bad_fit()
        _, _, width, height = geometry.region_px
        cols, rows = (width, height) if geometry.lit_side in {"left", "right"} else (height, width)
        self._x_mm = (np.arange(cols) + 0.5) * self._pixel_mm
        self._y_mm = (np.arange(rows) + 0.5) * self._pixel_mm
        self._slope = math.tan(math.radians(scene.beam.angle_deg))
        self._answers = [self._on_pixels(a) for a in self._complex_answers()]

    def light(self, image: Image | None, black_level: float) -> Array:
        """Return electrons/s on the sensor, (rows, cols), for a projector image, None for off."""
        key = "off" if image is None else hashlib.sha256(image.tobytes()).hexdigest()
        if key not in self._kept:
            seen = np.full(
                (self._rig.camera.rows, self._rig.camera.cols), self._scene.light.ambient_e_per_s
            )
            if image is not None:
                levels = black_level + (1.0 - black_level) * self._line(image) / 255.0
                x, y, width, height = self._region
                seen[y : y + height, x : x + width] += self._turned(
                    self._scene.light.peak_e_per_s * (self._single(levels) + self._multiple(levels))
                )
            self._kept[key] = seen
        return self._kept[key]

    def truth(self, black_level: float) -> Truth:
        """Return the light under white less that under black, apart, as the analysis sees it."""
        full = np.full(self._rig.projector.cols, 1.0 - black_level)
        peak = self._scene.light.peak_e_per_s
        return Truth(
            single=peak * self._single(full),
            multiple=peak * self._multiple(full),
            bounces=peak * (1.0 - black_level) * self._response.field.fluence,
        )

    def _single(self, levels: Array) -> Array:
        """Return I_1: the beam's stripes, blurred, carried along it and attenuated."""
        beam = self._scene.beam
        offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
        fine_y = (self._y_mm[:, None] + offsets * self._pixel_mm).ravel()
        drift = self._x_mm * self._slope if self._slope else np.zeros(1)
        entry = fine_y[:, None] - drift[None, :]
        lit = (entry > beam.from_mm) & (entry < beam.to_mm)
        profile = np.interp(entry, *beam.record().profile_points())
        shown = lit * profile * self._blurred(levels, entry)
        rows = shown.reshape(self._y_mm.size, SUBPIXELS, -1).mean(axis=1)
        rate = self._scene.medium.sigma_t_per_mm / math.cos(math.radians(beam.angle_deg))
        half = 0.5 * rate * self._pixel_mm
        decay = np.exp(-rate * self._x_mm) * math.sinh(half) / half
        return np.asarray(rows * decay)

    def _blurred(self, levels: Array, y_mm: Array) -> Array:
        """Return the projected light at tank heights: pixels blurred by a Gaussian."""
        projection = self._rig.projection
        u = (y_mm - projection.origin_mm) / projection.mm_per_px
        if projection.blur_px == 0.0:
            index = np.floor(u).astype(int)
            inside = (index >= 0) & (index < levels.size)
            return np.asarray(np.where(inside, levels[np.clip(index, 0, levels.size - 1)], 0.0))
        # A Gaussian over steps is a sum of error functions, one for each change of level.
        fine = np.arange(-8.0, levels.size + 8.0, 1.0 / 32.0)
        edges = np.flatnonzero(np.diff(levels, prepend=0.0, append=0.0))
        jumps = np.diff(levels, prepend=0.0, append=0.0)[edges]
        profile = np.zeros_like(fine)
        scale = 1.0 / (math.sqrt(2.0) * projection.blur_px)
        reach = REACH * projection.blur_px
        for edge, jump in zip(edges, jumps, strict=True):
            first, last = np.searchsorted(fine, (edge - reach, edge + reach))
            near = fine[first:last] - edge
            profile[first:last] += 0.5 * jump * (1.0 + erf(near * scale))
            profile[last:] += jump
        return np.asarray(np.interp(u, fine, profile))

    def _multiple(self, levels: Array) -> Array:
        """Return the sum of bounces 2 .. K under light of the plan's period."""
        projection = self._rig.projection
        coefficients = self._coefficients(levels)
        period_mm = self._period_px * projection.mm_per_px
        drift = self._x_mm * self._slope if self._slope else np.zeros(1)
        carried = self._y_mm[:, None] - drift[None, :] - projection.origin_mm
        total = coefficients[0].real * self._answers[0].real
        for harmonic, coefficient, answer in zip(
            HARMONICS, coefficients[1:], self._answers[1:], strict=True
        ):
            if abs(coefficient) > 1e-12:
                wave = np.exp(2j * np.pi * harmonic * carried / period_mm)
                total = total + 2.0 * (coefficient * wave * answer).real
        # A cut series with the noise of a Monte Carlo may undershoot; light cannot.
        return np.asarray(np.maximum(total, 0.0))

    def _coefficients(self, levels: Array) -> list[complex]:
        """Return the Fourier coefficients of one period: the mean and each of HARMONICS.

        Raises
        ------
        RunError
            If the image does not repeat with the plan's period.
        """
        period = self._period_px
        whole = levels[: levels.size // period * period].reshape(-1, period)
        if np.abs(whole - whole[0]).max() > 0.0:
            msg = (
                f"the projector image does not repeat every {period} px, as the scene's response "
                "assumes; show stripes of the plan's period or a uniform image."
            )
            raise RunError(msg)
        u = np.arange(period) + 0.5
        found = [complex(whole[0].mean())]
        for harmonic in HARMONICS:
            turn = 2.0 * np.pi * harmonic / period
            blur = math.exp(-0.5 * (turn * self._rig.projection.blur_px) ** 2)
            pixel = float(np.sinc(harmonic / period))
            found.append(complex(np.mean(whole[0] * np.exp(-1j * turn * u)) * blur * pixel))
        return found

    def _complex_answers(self) -> list[NDArray[np.complex128]]:
        field = self._response.field
        return [field.fluence.sum(axis=0).astype(np.complex128), *field.modulated]

    def _on_pixels(self, cells: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return cell averages as values at the camera's pixels, linear in between."""
        field = self._response.field
        line = RegularGridInterpolator(
            (field.y_mm, field.x_mm), cells, bounds_error=False, fill_value=None
        )
        y, x = np.meshgrid(self._y_mm, self._x_mm, indexing="ij")
        return np.asarray(line((y, x)))

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
        side = self._rig.geometry.lit_side
        if side == "right":
            return tank[:, ::-1]
        if side == "top":
            return tank.T
        if side == "bottom":
            return tank.T[::-1]
        return tank

    def _refuse_bad_fit(self) -> None:
        x, y, width, height = self._region
        camera, tank = self._rig.camera, self._scene.tank
        if x + width > camera.cols or y + height > camera.rows:
            msg = f"region_px {list(self._region)} leaves {camera.cols} x {camera.rows} px."
            raise PlanError(msg)
        projection, beam = self._rig.projection, self._scene.beam
        reach = REACH * projection.blur_px * projection.mm_per_px
        first = projection.origin_mm
        last = first + self._rig.projector.cols * projection.mm_per_px
        if first > beam.from_mm - reach or last < beam.to_mm + reach:
            msg = (
                f"the projector lights {first:g} .. {last:g} mm, not the whole beam "
                f"{beam.from_mm:g} .. {beam.to_mm:g} mm and the reach of its blur; mend projection."
            )
            raise PlanError(msg)
        along, across = (width, height)
        if self._rig.geometry.lit_side in {"top", "bottom"}:
            along, across = (height, width)
        seen = (along * self._pixel_mm, across * self._pixel_mm)
        wanted = (tank.depth_mm, tank.width_mm)
        if max(abs(a - b) for a, b in zip(seen, wanted, strict=True)) > self._pixel_mm:
            msg = (
                f"the region shows {seen[0]:g} x {seen[1]:g} mm, the scene's tank is "
                f"{wanted[0]:g} x {wanted[1]:g} mm; mend region_px or the tank."
            )
            raise PlanError(msg)
