"""L_2 and phi_2 against the closed forms of a half-space, and their limits."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import k0, k1

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import phase_function
from analysis.transport.beam import beam_integral, second_bounce
from analysis.transport.ordinates import solve_on

WIDE = Tank(depth_mm=60.0, width_mm=400.0)
FULL = Beam(from_mm=0.0, to_mm=400.0)
MIDDLE = 200.0


def strip(x: float, theta: float, beam: Beam = FULL, tank: Tank = WIDE, y: float = MIDDLE) -> float:
    """The closed form at one point and direction, sigma_t = 1 / mm."""
    out = np.zeros((1, 1, 1))
    places = (np.array([x]), np.zeros(1), np.array([y]), np.zeros(1))
    beam_integral(places, np.array([theta]), np.ones(1), beam, tank, 1.0, out)
    return float(out.item())


@pytest.mark.parametrize("tau", [0.01, 0.3146631336, 1.0, 5.0])
@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
def test_l2_is_the_half_space_formula(tau, angle_deg):
    mu0 = math.cos(math.radians(angle_deg))
    beam = Beam(from_mm=0.0, to_mm=400.0, angle_deg=angle_deg)
    for theta in np.linspace(0.05, 1.4, 9):
        mu = math.cos(theta)
        forward = (math.exp(-tau / mu0) - math.exp(-tau / mu)) / (mu * (1 / mu - 1 / mu0))
        backward = math.exp(-tau / mu0) / (mu * (1 / mu0 + 1 / mu))
        # measured worst 8e-12: the formula cancels where mu nears mu0
        assert strip(tau, theta, beam) == pytest.approx(forward, rel=1e-10)
        assert strip(tau, math.pi - theta, beam) == pytest.approx(backward, rel=1e-10)


def test_phi2_of_isotropic_scattering_is_the_bessel_formula_and_peaks_where_it_should():
    def phi2(tau: float) -> float:
        return 2 * quad(lambda t: strip(tau, t) / (2 * np.pi), 0, np.pi, points=[np.pi / 2])[0]

    for tau in (0.05, 0.3146631336, 1.0, 4.0):
        exact = tau * (k0(tau) + k1(tau)) / np.pi
        # measured worst 1.2e-11
        assert phi2(tau) == pytest.approx(exact, rel=1e-9)
    peak = phi2(0.3146631336)
    assert peak > phi2(0.31)
    assert peak > phi2(0.32)


@pytest.mark.parametrize("g", [0.0, 0.4, -0.5, 0.9])
def test_face_fluence_of_order_two_at_any_g(g):
    exact = ((1 + g) / (1 - g) - 4 * g / (1 - g) ** 2 * math.atan((1 - g) / (1 + g))) / np.pi

    def emitted(theta: float) -> float:
        return float(phase_function(np.array(theta), g, "hg-plane")) * strip(1e-12, theta)

    found = 2 * quad(emitted, np.pi / 2, np.pi)[0]
    # measured worst 1.0e-12
    assert found == pytest.approx(exact, rel=1e-10)


def test_grazing_incidence_gives_the_arccosh_formula_and_stays_finite():
    angle_deg = 89.0
    mu0 = math.cos(math.radians(angle_deg))
    tank = Tank(depth_mm=60.0, width_mm=100_000.0)
    beam = Beam(from_mm=0.0, to_mm=100_000.0, angle_deg=angle_deg)
    found = quad(
        lambda t: strip(1e-12, t, beam, tank, 50_000.0) / (2 * np.pi), np.pi / 2, 1.5 * np.pi
    )[0]
    exact = mu0 * math.acosh(1 / mu0) / (np.pi * math.sqrt(1 - mu0**2))
    # measured worst 6e-11
    assert found == pytest.approx(exact, rel=1e-9)
    steep = Beam(from_mm=10.0, to_mm=11.0, angle_deg=89.9)
    values = [
        strip(x, t, steep, WIDE, y)
        for x in (0.0, 0.1, 30.0)
        for y in (0.0, 10.5, 400.0)
        for t in np.linspace(0, 2 * np.pi, 97)
    ]
    assert np.isfinite(values).all()
    assert min(values) >= 0.0


def test_strips_add_up_to_the_beam():
    whole = Beam(from_mm=150.0, to_mm=250.0, angle_deg=20.0)
    halves = (
        Beam(from_mm=150.0, to_mm=190.0, angle_deg=20.0),
        Beam(from_mm=190.0, to_mm=250.0, angle_deg=20.0),
    )
    for theta in np.linspace(0.0, 2 * np.pi, 41):
        for x, y in ((0.5, 149.0), (3.0, 200.0), (7.0, 255.0)):
            parts = sum(strip(x, theta, half, y=y) for half in halves)
            # measured worst 7e-18
            assert parts == pytest.approx(strip(x, theta, whole, y=y), abs=1e-13)


def test_mirroring_the_tank_mirrors_the_light():
    tank = Tank(depth_mm=8.0, width_mm=6.0)
    grid = Grid(tank=tank, n_x=17, n_y=13, n_theta=16)
    beam = Beam(from_mm=1.0, to_mm=3.0, angle_deg=25.0)
    mirrored = Beam(from_mm=3.0, to_mm=5.0, angle_deg=-25.0)
    medium = Medium(sigma_t_per_mm=0.7, sigma_s_per_mm=0.6, g=0.5)
    one = solve_on(medium, beam, grid, n_bounces=5)
    other = solve_on(medium, mirrored, grid, n_bounces=5)
    # measured worst 2e-16; the beam's edges fall between nodes
    np.testing.assert_allclose(one.fluence, other.fluence[:, ::-1], atol=1e-13)


def test_scaling_lengths_and_coefficients_together_changes_nothing():
    small = Grid(tank=Tank(depth_mm=8.0, width_mm=6.0), n_x=17, n_y=13, n_theta=16)
    large = Grid(tank=Tank(depth_mm=16.0, width_mm=12.0), n_x=17, n_y=13, n_theta=16)
    dense = Medium(sigma_t_per_mm=0.8, sigma_s_per_mm=0.6, g=0.5)
    thin = Medium(sigma_t_per_mm=0.4, sigma_s_per_mm=0.3, g=0.5)
    one = solve_on(dense, Beam(from_mm=1.2, to_mm=3.1), small, n_bounces=6)
    other = solve_on(thin, Beam(from_mm=2.4, to_mm=6.2), large, n_bounces=6)
    # measured equal to the bit
    np.testing.assert_allclose(one.fluence, other.fluence, atol=1e-14)


def test_second_bounce_fills_the_grid_with_the_same_integral():
    grid = Grid(tank=Tank(depth_mm=8.0, width_mm=6.0), n_x=5, n_y=4, n_theta=8)
    beam = Beam(from_mm=1.0, to_mm=3.5, angle_deg=10.0)
    for lines_of_x in (False, True):
        light = second_bounce(
            grid,
            beam,
            grid.theta_rad,
            sigma_t_per_mm=1.0,
            weight=np.ones(8),
            lines_of_x=lines_of_x,
        )
        for n, theta in enumerate(grid.theta_rad):
            for j, y in enumerate(grid.y_mm):
                for i, x in enumerate(grid.x_mm):
                    found = light[n, i, j] if lines_of_x else light[n, j, i]
                    assert found == strip(x, theta, beam, grid.tank, y)


def test_a_profile_is_the_sum_of_its_narrow_strips():
    """A linear piece against many flat ones: the closed forms of either share little."""
    tank = Tank(depth_mm=8.0, width_mm=6.0)
    points = ((1.0, 0.2), (2.0, 1.0), (3.5, 0.0), (4.0, 0.6))
    beam = Beam(from_mm=1.0, to_mm=4.0, angle_deg=10.0, profile=points)
    heights = np.linspace(1.0, 4.0, 2401)
    middle = 0.5 * (heights[1:] + heights[:-1])
    irradiance = np.interp(middle, *beam.profile_points())
    for theta in (0.02, 0.7, 2.0, 3.1, 5.0):
        for x, y in ((0.3, 1.5), (4.0, 3.0), (7.5, 5.9)):
            parts = sum(
                e * strip(x, theta, Beam(from_mm=a, to_mm=b, angle_deg=10.0), tank, y)
                for a, b, e in zip(heights[:-1], heights[1:], irradiance, strict=True)
            )
            # measured worst 5e-7: steps that stand for slopes
            assert parts == pytest.approx(strip(x, theta, beam, tank, y), abs=2e-6)
