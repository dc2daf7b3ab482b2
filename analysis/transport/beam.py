"""The ballistic beam L_1 and the closed form of the second bounce L_2.

Along the ray that arrives at (x, y) in direction theta, the part that lies in a lit strip is one
interval, and the light set out on it is a linear function times an exponential. So L_2 has no
spatial error at all, at any point and for any width, slant and profile of the beam.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.light_field import Grid
from analysis.medium import Beam, Tank
from analysis.phase_function import Array

Ray = tuple[float, float, float, float, float, float]
F2, F3, F4, F5, F6, F7, F8, F9, F10, F11, F12 = (1.0 / math.factorial(n) for n in range(2, 13))
THIN = 0.02  # optical depth
Strip = tuple[float, float, float, float]  # from, to (mm) and the irradiance at either


def ballistic_fluence(
    x_mm: Array, y_mm: Array, *, sigma_t_per_mm: float, beam: Beam
) -> NDArray[np.float64]:
    """Return phi_1 = E exp(-sigma_t d) in the lit strip, zero outside, (n_y, n_x).

    ``d = x / cos(theta_0)`` is the path inside the medium, E the irradiance where the light
    entered. A node on the strip's edge gets one half, the mean of both sides.
    """
    angle = math.radians(beam.angle_deg)
    entry = y_mm[:, None] - x_mm[None, :] * math.tan(angle)
    lit = np.heaviside(entry - beam.from_mm, 0.5) * np.heaviside(beam.to_mm - entry, 0.5)
    lit *= np.interp(entry, *beam.profile_points())
    return np.asarray(lit * np.exp(-sigma_t_per_mm * x_mm[None, :] / math.cos(angle)))


def second_bounce(
    grid: Grid,
    beam: Beam,
    theta_rad: Array,
    *,
    sigma_t_per_mm: float,
    weight: Array,
    lines_of_x: bool = False,
) -> NDArray[np.float64]:
    """Return weight(theta) times the beam integral at every node, (n, n_y, n_x).

    The beam integral is exp(-sigma_t s) L_1 integrated backwards along the ray, in mm; with
    ``weight = sigma_s p(theta - theta_0)`` this is L_2 exactly. ``lines_of_x`` returns it as
    (n, n_x, n_y).
    """
    places = places_of(grid, lines_of_x=lines_of_x)
    out = np.zeros((theta_rad.size, places[0].size, places[1].size))
    beam_integrals(places, theta_rad, beam, grid.tank, sigma_t_per_mm, out)
    out *= weight[:, None, None]
    return out


def places_of(grid: Grid, *, lines_of_x: bool = False) -> tuple[Array, Array, Array, Array]:
    """Return x of each line and of each node on it, y of each line and of each node, mm.

    The point (p, q) is at (x_line[p] + x_node[q], y_line[p] + y_node[q]); one of either is zero.
    """
    x, y = grid.x_mm, grid.y_mm
    if lines_of_x:
        return x, np.zeros(grid.n_y), np.zeros(grid.n_x), y
    return np.zeros(grid.n_y), x, y, np.zeros(grid.n_x)


def beam_integrals(
    places: tuple[Array, Array, Array, Array],
    theta_rad: Array,
    beam: Beam,
    tank: Tank,
    sigma_t_per_mm: float,
    out: Array,
) -> None:
    """Add the integral of exp(-sigma_t s) L_1 backwards along rays to ``out``.

    Parameters
    ----------
    places : see `places_of`
    theta_rad : (n,), directions
    out : (n, n_lines, n_nodes), mm

    Notes
    -----
    Over one linear piece of the profile the integrand is exp(-base - rate s) times a linear
    function. It is counted from the brighter end, with base + rate s and tau = abs(rate) length
    there: the other end may underflow where the beam is grazing.
    """
    slant_rad = math.radians(beam.angle_deg)
    slant = (math.cos(slant_rad), math.tan(slant_rad))
    profile = np.stack(beam.profile_points(), axis=1)
    walls = (tank.depth_mm, tank.width_mm)
    directions = zip(np.cos(theta_rad).tolist(), np.sin(theta_rad).tolist(), out, strict=True)
    for cos_t, sin_t, one in directions:
        ray = describe_ray(cos_t, sin_t, slant, sigma_t_per_mm)
        _add_strips(*places, ray, walls, profile, one)


@njit(cache=True, nogil=True)
def describe_ray(
    cos_t: float, sin_t: float, slant: tuple[float, float], sigma_t_per_mm: float
) -> Ray:
    """Return what the rays of one direction share; ``slant`` is cosine and tangent of the beam's.

    1/cos and 1/sin of the direction (1e300 along an axis); the beam's slope; by how much the
    height of entry falls per mm back along the ray; the beam's extinction per mm of depth, and
    that of ray and beam together per mm back along the ray.
    """
    cos_0, slope = slant
    drift = sin_t - cos_t * slope
    return (
        1.0 / cos_t if cos_t else 1e300,
        1.0 / sin_t if sin_t else 1e300,
        slope,
        drift if abs(drift) > 1e-14 else 0.0,
        sigma_t_per_mm / cos_0,
        sigma_t_per_mm * (1.0 - cos_t / cos_0),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _add_strips(
    x_line: Array,
    x_node: Array,
    y_line: Array,
    y_node: Array,
    ray: Ray,
    tank: tuple[float, float],
    profile: Array,
    out: Array,
) -> None:
    """Add one direction's integral over every linear piece of the profile (n, 2) to ``out``."""
    for k in range(profile.shape[0] - 1):
        strip = (profile[k, 0], profile[k + 1, 0], profile[k, 1], profile[k + 1, 1])
        for p in range(np.uint64(out.shape[0])):
            for q in range(np.uint64(out.shape[1])):
                x, y = x_line[p] + x_node[q], y_line[p] + y_node[q]
                dimming, tau, bright, dark = cut_ray(x, y, ray, tank, strip)
                left = fading(tau)
                e1 = 0.5 - tau * (1 / 3 - tau * (1 / 8 - tau * (1 / 30 - tau / 144)))
                # The closed forms lose their digits where tau is small; the series does not.
                e0 = 1.0 - tau * (1 / 2 - tau * (1 / 6 - tau * (1 / 24 - tau / 120)))
                thick = tau if tau > THIN else 1.0
                e0 = (1.0 - left) / thick if tau > THIN else e0
                e1 = (e0 - left) / thick if tau > THIN else e1
                out[p, q] += fading(dimming) * (bright * (e0 - e1) + dark * e1)


@njit(cache=True, nogil=True, error_model="numpy")
def fading(tau: float) -> float:
    """Return exp(-tau) for tau >= 0 to rounding, as a loop on the vector unit can."""
    power = -tau * math.log2(math.e)
    power = power if power > -1021.0 else -1021.0
    whole = np.floor(power + 0.5)
    f = (power - whole) * math.log(2.0)
    p = f * (F8 + f * (F9 + f * (F10 + f * (F11 + f * F12))))
    p = 1.0 + f * (1.0 + f * (F2 + f * (F3 + f * (F4 + f * (F5 + f * (F6 + f * (F7 + p)))))))
    scale = np.int64((np.int64(whole) + np.int64(1023)) << np.int64(52)).view(np.float64)
    found: float = p * scale
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def cut_ray(
    x: float, y: float, ray: Ray, tank: tuple[float, float], strip: Strip
) -> tuple[float, float, float, float]:
    """Find the piece of the ray that arrives at a point which lies in one strip of the beam.

    Its ends have the optical depths ``dimming`` and dimming + ``tau``; ``bright`` and ``dark``
    are the irradiance that entered there times the piece's length, zero for a ray that misses.
    """
    inverse_cos, inverse_sin, slope, drift, beam_rate, rate = ray
    low, high, at_low, at_high = strip
    rise = (at_high - at_low) / (high - low)
    wall_x = 0.0 if inverse_cos > 0.0 else tank[0]
    wall_y = 0.0 if inverse_sin > 0.0 else tank[1]
    per_entry = 1.0 / drift if drift != 0.0 else 0.0
    far_x = (x - wall_x) * inverse_cos
    far_y = (y - wall_y) * inverse_sin
    far = far_x if far_x < far_y else far_y
    entry = y - x * slope
    along, inside = drift == 0.0, low <= entry <= high
    s_low = (-1e300 if inside else 0.0) if along else (entry - low) * per_entry
    s_high = (1e300 if inside else 0.0) if along else (entry - high) * per_entry
    # A ray along the strip's edge sees the mean of both sides.
    share = 0.5 if along and (entry - low) * (entry - high) == 0.0 else 1.0
    first, last = (s_low, s_high) if s_low < s_high else (s_high, s_low)
    # Comparisons in place of min and max, which keep a loop off the vector unit.
    begin = first if first > 0.0 else 0.0
    end = last if last < far else far
    end = end if end > begin else begin
    span = end - begin
    near, deep = (begin, end) if rate >= 0.0 else (end, begin)
    bright = at_low + rise * (entry - drift * near - low)
    dark = at_low + rise * (entry - drift * deep - low)
    return (
        beam_rate * x + rate * near,
        abs(rate) * span,
        share * span * (bright if bright > 0.0 else 0.0),
        share * span * (dark if dark > 0.0 else 0.0),
    )
