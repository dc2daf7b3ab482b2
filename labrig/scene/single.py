"""Light scattered once: the projected stripes, blurred, carried along the beam and attenuated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from labrig.scene.fresnel import internal_reflectance
from labrig.scene.parts import Parts

Array = NDArray[np.float64]

REACH = 6.0  # standard deviations beyond which a blurred edge is flat, to 1e-9
SUBPIXELS = 8  # samples of a camera row, across the stripes
FOLDS = 4  # mirrored tanks on each side, at most
FAINT = 1e-5  # share of the light that is not followed further
FINE = 32  # samples of a projector pixel
BLURS = 33  # amounts of a growing blur that are computed; those between are interpolated


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """Camera pixels in the tank: depths (n_x,) and heights (n_y,) of their centres, and pitch."""

    x_mm: Array
    y_mm: Array
    pixel_mm: float


def single_scattering(parts: Parts, levels: Array, places: Places) -> Array:
    """Return I_1 under light of each projector pixel, for a peak of one: (n_y, n_x).

    Walls that are mirrors show the beam again, in tanks unfolded around this one.
    """
    total = _once(parts, levels, places)
    for share, mirrored in _mirrored(parts, places):
        total = total + share * _once(parts, levels, mirrored)
    return total


def _mirrored(parts: Parts, places: Places) -> list[tuple[float, Places]]:
    """Return the places behind the walls from which mirrors bring light, and their share of it."""
    wall, tank = parts.wall_reflectance, parts.scene.tank
    if wall == 0.0:
        return []
    angle = math.radians(parts.scene.beam.angle_deg)
    face = 0.0
    if parts.face_index != 1.0:
        face = float(internal_reflectance(parts.face_index, np.array([math.cos(angle)]))[0])
    sigma_t, found = parts.scene.medium.sigma_t_per_mm, []
    for m in range(FOLDS):
        x = m * tank.depth_mm + places.x_mm if m % 2 == 0 else (m + 1) * tank.depth_mm - places.x_mm
        for j in range(-FOLDS, FOLDS + 1) if angle else (0,):
            y = j * tank.width_mm + places.y_mm
            if j % 2:
                y = (j + 1) * tank.width_mm - places.y_mm
            share = wall ** ((m + 1) // 2 + abs(j)) * face ** (m // 2)
            place = Places(x_mm=np.asarray(x), y_mm=np.asarray(y), pixel_mm=places.pixel_mm)
            least_mm = _least_path_mm(parts, place)
            if (m or j) and share * math.exp(-sigma_t * least_mm) > FAINT:
                found.append((share, place))
    return found


def _least_path_mm(parts: Parts, places: Places) -> float:
    """Return the shortest way of the beam to places; infinite where it does not come.

    Height of entry and path run one way along either axis, so that corners tell.
    """
    y = np.array([places.y_mm.min() - places.pixel_mm, places.y_mm.max() + places.pixel_mm])
    ray = rays(parts, y, np.array([places.x_mm.min(), places.x_mm.max()]))
    beam = parts.scene.beam
    if ray.entry_mm.min() > beam.to_mm or ray.entry_mm.max() < beam.from_mm:
        return math.inf
    return float(ray.path_mm.min())


def _once(parts: Parts, levels: Array, places: Places) -> Array:
    """Return the beam's light at places, as if no wall were there."""
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    fine_y = (places.y_mm[:, None] + offsets * places.pixel_mm).ravel()
    beam, sigma_t = parts.scene.beam, parts.scene.medium.sigma_t_per_mm
    ray = rays(parts, fine_y, places.x_mm)
    lit = (ray.entry_mm > beam.from_mm) & (ray.entry_mm < beam.to_mm)
    profile = np.interp(ray.entry_mm, *beam.record().profile_points())
    shown = lit * profile * _projected(parts, levels, ray.entry_mm, places.x_mm) * ray.dilution
    half = 0.5 * places.pixel_mm * sigma_t * ray.path_mm / places.x_mm
    # The mean over a pixel's depth, which is more than the exponential at its middle.
    decay = np.exp(-sigma_t * ray.path_mm) * (np.sinh(half) / half if sigma_t else 1.0)
    if decay.shape[0] > 1:
        return np.asarray((shown * decay).reshape(places.y_mm.size, SUBPIXELS, -1).mean(axis=1))
    return np.asarray(shown.reshape(places.y_mm.size, SUBPIXELS, -1).mean(axis=1) * decay)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rays:
    """Where the light at a place came in, how far it went, and how much it has spread.

    ``entry_mm`` is (n_y, n_x), or (n_y, 1) where depth does not matter; ``path_mm`` is
    (n_y, n_x), or (1, n_x) where height does not; ``dilution`` is (1, n_x).
    """

    entry_mm: Array
    path_mm: Array
    dilution: Array


def rays(parts: Parts, y_mm: Array, x_mm: Array) -> Rays:
    """Follow the beam back to the face from each place.

    A beam that spreads from a point at ``divergence_mm`` before the face has the slope
    ``tan(theta_0) + (y_0 - m) / L`` at height y_0, m being its middle; its tubes widen as
    ``1 + x / L``.
    """
    beam, far = parts.scene.beam, parts.divergence_mm
    slope = math.tan(math.radians(beam.angle_deg))
    x, y = x_mm[None, :], y_mm[:, None]
    if math.isinf(far):
        entry = y - slope * x if slope else y
        return Rays(entry_mm=entry, path_mm=x * math.hypot(1.0, slope), dilution=np.ones_like(x))
    middle, widening = 0.5 * (beam.from_mm + beam.to_mm), 1.0 + x / far
    entry = middle + (y - middle - slope * x) / widening
    path = x * np.hypot(1.0, slope + (entry - middle) / far)
    return Rays(entry_mm=entry, path_mm=path, dilution=1.0 / widening)


def _projected(parts: Parts, levels: Array, entry_mm: Array, x_mm: Array) -> Array:
    """Return the projected light of rays that came in at heights, sharper or not by depth."""
    projection = parts.rig.projection
    u = (entry_mm - projection.origin_mm) / projection.mm_per_px
    if parts.defocus_px_per_mm == 0.0:
        return blurred(levels, parts.blur_px)(u)
    deepest = float(x_mm.max())
    blurs = parts.blur_px + parts.defocus_px_per_mm * np.linspace(0.0, deepest, BLURS)
    profiles = [blurred(levels, float(blur)) for blur in blurs]
    place = x_mm / deepest * (BLURS - 1)
    first = np.minimum(place.astype(int), BLURS - 2)
    found = np.empty((u.shape[0], x_mm.size))
    for n, (k, share) in enumerate(zip(first, place - first, strict=True)):
        column = u[:, n] if u.shape[1] > 1 else u[:, 0]
        found[:, n] = (1.0 - share) * profiles[k](column) + share * profiles[k + 1](column)
    return found


def blurred(levels: Array, blur_px: float) -> Callable[[Array], Array]:
    """Return projected light as a function of place, in projector pixels, (n,) levels blurred."""
    if blur_px == 0.0:

        def sharp(u: Array) -> Array:
            index = np.floor(u).astype(int)
            inside = (index >= 0) & (index < levels.size)
            return np.asarray(np.where(inside, levels[np.clip(index, 0, levels.size - 1)], 0.0))

        return sharp
    # A Gaussian over steps is a sum of error functions, one for each change of level.
    reach = REACH * blur_px
    fine = np.arange(-reach - 8.0, levels.size + reach + 8.0, 1.0 / FINE)
    change = np.diff(levels, prepend=0.0, append=0.0)
    profile = np.zeros_like(fine)
    scale = 1.0 / (math.sqrt(2.0) * blur_px)
    for edge in np.flatnonzero(change):
        first, last = np.searchsorted(fine, (edge - reach, edge + reach))
        profile[first:last] += 0.5 * change[edge] * (1.0 + erf((fine[first:last] - edge) * scale))
        profile[last:] += change[edge]
    return lambda u: np.asarray(np.interp(u, fine, profile))
