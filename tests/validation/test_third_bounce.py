"""L_3 at single points and directions, against adaptive quadrature of the closed second bounce.

Nothing of the solver's is used: L_2 is written out here, and its kinks are given as break points.
"""

import itertools
import math

import pytest
from scipy.integrate import quad

from analysis.medium import Beam, Medium, Tank
from analysis.transport.solve import solve

TANK = Tank(depth_mm=20.0, width_mm=16.0)
SIGMA_T, SIGMA_S, G = 0.25, 0.2, 0.4
POINTS = ((0.1, 0.5), (0.4, 0.3), (0.7, 0.8))  # shares of depth and width
TURNS = (0.03, 0.3, 0.55, 0.8)  # of the circle


def phase(angle: float, paper: bool) -> float:
    denominator = 1.0 + G * G - 2.0 * G * math.cos(angle)
    if paper:
        return (1.0 - G * G) / (4.0 * math.pi * denominator**1.5)
    return (1.0 - G * G) / (2.0 * math.pi * denominator)


def to_wall(x: float, y: float, theta: float) -> float:
    """Return the way back along a ray to the wall."""
    cos_t, sin_t = math.cos(theta), math.sin(theta)
    along = (x if cos_t > 0.0 else x - TANK.depth_mm) / cos_t if cos_t else math.inf
    across = (y if sin_t > 0.0 else y - TANK.width_mm) / sin_t if sin_t else math.inf
    return min(along, across)


def once_scattered(x: float, y: float, theta: float, beam: Beam, paper: bool) -> float:
    """L_2: the beam, straight or aslant, over that part of the ray which it lights."""
    slant = math.radians(beam.angle_deg)
    entry, drift = y - x * math.tan(slant), math.sin(theta) - math.cos(theta) * math.tan(slant)
    if drift == 0.0:
        return 0.0
    cuts = sorted(((entry - beam.from_mm) / drift, (entry - beam.to_mm) / drift))
    begin, end = max(cuts[0], 0.0), min(cuts[1], to_wall(x, y, theta))
    if end <= begin:
        return 0.0
    rate = SIGMA_T * (1.0 - math.cos(theta) / math.cos(slant))
    length = end - begin
    lit = length if abs(rate * length) < 1e-12 else -math.expm1(-rate * length) / rate
    dimmed = math.exp(-SIGMA_T * x / math.cos(slant) - rate * begin)
    return SIGMA_S * phase(theta - slant, paper) * dimmed * lit


def twice_scattered(x: float, y: float, theta: float, beam: Beam, paper: bool) -> float:
    """L_3: what L_2 of all directions scatters into the ray, integrated back along it."""
    slope = math.tan(math.radians(beam.angle_deg))
    corners = [(a, b) for a in (0.0, TANK.depth_mm) for b in (0.0, TANK.width_mm)]
    for edge in (beam.from_mm, beam.to_mm):
        corners += [(0.0, edge), (TANK.depth_mm, edge + slope * TANK.depth_mm)]

    def source(s: float) -> float:
        here = (x - s * math.cos(theta), y - s * math.sin(theta))
        kinks = sorted(math.atan2(here[1] - b, here[0] - a) % (2.0 * math.pi) for a, b in corners)
        kinks = [0.0, *kinks, 2.0 * math.pi]
        total = 0.0
        for low, high in itertools.pairwise(kinks):
            if high - low > 1e-9:
                total += quad(
                    lambda t: phase(theta - t, paper) * once_scattered(*here, t, beam, paper),
                    low,
                    high,
                    epsabs=1e-8,
                    epsrel=1e-4,
                )[0]
        return math.exp(-SIGMA_T * s) * SIGMA_S * total

    drift = math.sin(theta) - math.cos(theta) * slope
    end = to_wall(x, y, theta)
    edges = [(y - x * slope - edge) / drift for edge in (beam.from_mm, beam.to_mm)]
    breaks = [s for s in edges if 1e-9 < s < end - 1e-9]
    found = quad(source, 0.0, end, points=breaks or None, epsabs=1e-6, epsrel=1e-4, limit=60)
    return float(found[0])


@pytest.mark.parametrize(
    ("phase_name", "angle_deg"), [("hg-plane", 0.0), ("hg-paper", 0.0), ("hg-plane", 30.0)]
)
def test_orders_two_and_three_at_points_and_directions(phase_name, angle_deg):
    medium = Medium(sigma_t_per_mm=SIGMA_T, sigma_s_per_mm=SIGMA_S, g=G, phase=phase_name)
    beam = Beam(from_mm=5.0, to_mm=10.0, angle_deg=angle_deg)
    field = solve(medium, TANK, beam, orders=3, tolerance=1e-3)
    grid, paper = field.grid, phase_name == "hg-paper"
    second, third = (float(field.light_field[k].max()) for k in (0, 1))
    worst = [0.0, 0.0]
    for share_x, share_y in POINTS:
        i, j = round(share_x * (grid.n_x - 1)), round(share_y * (grid.n_y - 1))
        x, y = float(grid.x_mm[i]), float(grid.y_mm[j])
        for turn in TURNS:
            n = int(turn * grid.n_theta)
            theta = float(grid.theta_rad[n])
            found = [float(field.light_field[k, j, i, n]) for k in (0, 1)]
            miss = abs(found[0] - once_scattered(x, y, theta, beam, paper)) / second
            worst[0] = max(worst[0], miss)
            miss = abs(found[1] - twice_scattered(x, y, theta, beam, paper)) / third
            worst[1] = max(worst[1], miss)
    # measured worst 8.3e-8: single precision
    assert worst[0] < 1e-7
    # measured worst 6.1e-4, 6.8e-4 and 6.8e-4 in the three cases
    assert worst[1] < 8e-4
