"""Geometry of the picture: a camera that looks aslant, and a lens that distorts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import map_coordinates

from labrig.models.effects import DistortionConfig, ObliqueConfig
from labrig.scene.effects.base import Bound, Effect, Situation
from labrig.scene.effects.lens import radius
from labrig.scene.parts import Array, Parts

NEWTON = 20  # steps to the inverse of the distortion; at k1 = -0.14 all are needed


class Oblique(Effect[ObliqueConfig]):
    """The camera is turned about the picture's vertical axis: one side is nearer than the other.

    A point at (X, Y) of the tank's plane, from the axis, is seen at
    ``D (X cos t, Y) / (D + X sin t)``.
    """

    cost = "an interpolation for each pixel"

    def bound(self, about: Situation) -> Bound:
        """Return what the largest displacement of a pixel of the region changes."""
        return _displacement(about, self._map(about), "it")

    def onto(self, parts: Parts) -> Parts:
        """Resample the picture."""
        return replace(parts, optics=(*parts.optics, Resampled(*self._map(parts))))

    def _map(self, about: Situation | Parts) -> tuple[Array, Array]:
        camera, pixel_mm = about.rig.camera, about.rig.geometry.mm_per_px or 1.0
        y, x = radius(camera.rows, camera.cols)
        half = 0.5 * math.hypot(camera.rows, camera.cols)
        found_y, found_x = seen_from(
            y * half * pixel_mm,
            x * half * pixel_mm,
            self.parameters.tilt_deg,
            self.parameters.distance_mm,
        )
        return _pixels(found_y / pixel_mm, found_x / pixel_mm, camera.rows, camera.cols)


class Distortion(Effect[DistortionConfig]):
    """What is at r is seen at r (1 + k1 r^2), in half diagonals from the sensor's middle."""

    cost = "an interpolation for each pixel"

    def bound(self, about: Situation) -> Bound:
        """Return what the largest displacement of a pixel of the region changes."""
        return _displacement(about, self._map(about), "it")

    def onto(self, parts: Parts) -> Parts:
        """Resample the picture."""
        return replace(parts, optics=(*parts.optics, Resampled(*self._map(parts))))

    def _map(self, about: Situation | Parts) -> tuple[Array, Array]:
        camera = about.rig.camera
        y, x = radius(camera.rows, camera.cols)
        half = 0.5 * math.hypot(camera.rows, camera.cols)
        scale = undistorted(np.hypot(x, y), self.parameters.k1)
        return _pixels(half * y * scale, half * x * scale, camera.rows, camera.cols)


class Resampled:
    """A picture taken elsewhere: (rows, cols) of where each pixel looks, by cubic splines."""

    def __init__(self, rows: Array, cols: Array) -> None:
        self._places = np.stack(np.broadcast_arrays(rows, cols))

    def __call__(self, seen: Array) -> Array:
        """Return the picture at these places; beyond its border it goes on as at the border."""
        found = map_coordinates(seen, self._places, order=3, mode="nearest")
        return np.asarray(np.maximum(found, 0.0))  # a spline may swing below dark


def seen_from(y_mm: Array, x_mm: Array, tilt_deg: float, distance_mm: float) -> tuple[Array, Array]:
    """Return the places (Y, X) in the tank's plane that a camera turned by an angle sees."""
    sine, cosine = math.sin(math.radians(tilt_deg)), math.cos(math.radians(tilt_deg))
    x = x_mm * distance_mm / (distance_mm * cosine - x_mm * sine)
    return np.asarray(y_mm * (distance_mm + x * sine) / distance_mm), np.asarray(x)


def undistorted(seen: Array, k1: float) -> Array:
    """Return the factor that takes a distorted radius back: u / r, with u (1 + k1 u^2) = r."""
    u = np.array(seen, dtype=np.float64)
    for _ in range(NEWTON):
        u -= (u * (1.0 + k1 * u**2) - seen) / (1.0 + 3.0 * k1 * u**2)
    return np.asarray(np.divide(u, seen, out=np.ones_like(u), where=seen > 0.0))


def _pixels(y: Array, x: Array, rows: int, cols: int) -> tuple[Array, Array]:
    return y + 0.5 * (rows - 1), x + 0.5 * (cols - 1)


def _displacement(about: Situation, places: tuple[Array, Array], what: str) -> Bound:
    camera, pixel_mm = about.rig.camera, about.rig.geometry.mm_per_px or 1.0
    rows, cols = np.broadcast_arrays(*places)
    x, y, width, height = about.rig.geometry.region_px or (0, 0, camera.cols, camera.rows)
    moved = np.hypot(
        rows - np.arange(camera.rows)[:, None], cols - np.arange(camera.cols)[None, :]
    )[y : y + height, x : x + width]
    most_px = float(moved.max())
    sigma_t = max(about.scene.medium.sigma_t_per_mm, 1.0 / about.scene.tank.depth_mm)
    # Edges of stripes and beam, then the decay and the face, which move along the depth.
    change = about.of_shift(most_px * pixel_mm) + 2.0 * math.sqrt(
        min(2.0 * sigma_t * most_px * pixel_mm, 1.0)
    )
    scale = 1.0 + about.multiple_at_most
    return Bound(
        scale * change if most_px > 1e-9 else 0.0, f"{what} moves {most_px:.3g} px at most"
    )
