"""Light in depth alone against closed forms, the tank's solver, and the Monte Carlo's stripes."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.special import k0e, k1e

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import phase_function, power_removed
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import solve_on
from analysis.transport.plane import PlaneField, PlaneGrid, solve_plane


def unit_medium(g: float = 0.0, sigma_s: float = 1.0, phase: str = "hg-plane") -> Medium:
    return Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=sigma_s, g=g, phase=phase)


def half_space(g: float, n: int, *, depth_mm: float = 40.0, orders: int = 5) -> PlaneField:
    grid = PlaneGrid.graded(depth_mm, sigma_t_per_mm=1.0, n_x=n + 1, n_theta=n)
    return solve_plane(unit_medium(g), grid, n_bounces=orders)


def log_phi2(tau: np.ndarray) -> np.ndarray:
    """The logarithm of tau (K0 + K1) / pi."""
    return np.log(tau * (k0e(tau) + k1e(tau)) / np.pi) - tau


def test_the_bessel_formula_is_met_from_the_face_to_where_numbers_end():
    assert log_phi2(np.array(1000.0)) == pytest.approx(-996.7717887443855, abs=1e-12)
    near = half_space(0.0, 256, orders=2)
    x = near.grid.x_mm
    shallow = (x > 1e-3) & (x < 20.0)
    found = np.log(near.weighted(1.0)[1, shallow].real)
    # measured worst 1.1e-8
    np.testing.assert_allclose(found, log_phi2(x[shallow]), atol=1e-7)
    thick = half_space(0.0, 256, depth_mm=2000.0, orders=3)
    x = thick.grid.x_mm
    deep = (x > 5.0) & (x < 690.0)
    assert deep.sum() > 50
    # measured worst 3.4e-13; beyond 700 mean free paths no number is small enough for the light
    found = np.log(thick.weighted(1.0)[1, deep].real)
    np.testing.assert_allclose(found, log_phi2(x[deep]), atol=1e-7)
    assert np.isfinite(thick.fluence).all()
    assert (thick.fluence.real >= 0.0).all()


def test_face_fluence_of_isotropic_scattering_is_the_h_function():
    face = half_space(0.0, 256).weighted(1.0)[:, 0].real
    exact = [1.0, 1 / np.pi, 1 / 8 + 1 / (2 * np.pi**2), 0.115900, 0.083964]
    # measured relative errors 0, 1e-15, 2.6e-5, 1.0e-5, 5.5e-6 (the last two have six digits)
    np.testing.assert_allclose(face, exact, rtol=6e-5)


@pytest.mark.parametrize("g", [-0.9, -0.5, 0.0, 0.4, 0.9, 0.97])
def test_face_fluence_of_order_two_at_any_g(g):
    face = half_space(g, 256, orders=2).weighted(1.0)[1, 0].real
    exact = ((1 + g) / (1 - g) - 4 * g / (1 - g) ** 2 * math.atan((1 - g) / (1 + g))) / np.pi
    # measured worst 2e-13, at g = 0.97
    assert face == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize(
    ("g", "phase", "angle_deg"),
    [(0.4, "hg-plane", 0.0), (0.4, "hg-paper", 30.0), (-0.7, "hg-plane", 0.0)],
)
def test_every_order_keeps_its_energy(g, phase, angle_deg):
    """int phi_k + escape_k = f0 sigma_s int phi_(k-1) for sigma_t = 1, orders 2 to 6."""
    sigma_s, mu_0 = 0.9, math.cos(math.radians(angle_deg))
    grid = PlaneGrid.graded(10.0, sigma_t_per_mm=1.0, n_x=257, n_theta=256)
    medium = unit_medium(g, sigma_s, phase)
    field = solve_plane(medium, grid, n_bounces=6, angle_deg=angle_deg)
    fluence = field.weighted(sigma_s).real
    inside = [float(CubicSpline(grid.x_mm, order).integrate(0.0, 10.0)) for order in fluence]
    inside[0] = mu_0 * -math.expm1(-10.0 / mu_0)
    cos = np.cos(grid.theta_rad)
    weight = sigma_s ** np.arange(6) * np.exp(field.log_scale)
    for k in range(2, 7):
        light = field.radiance[k - 2].real * weight[k - 1]
        leaving = np.where(cos > 0.0, cos * light[:, -1], -cos * light[:, 0])
        escape = float(grid.weight_rad @ leaving)
        scattered = power_removed(g, phase) * sigma_s * inside[k - 2]
        # measured worst 1.3e-6, at order 3 and g = -0.7
        assert inside[k - 1] + escape == pytest.approx(scattered, rel=5e-6)


@pytest.mark.parametrize(
    ("period_mm", "striped", "within"), [(1.8, True, 3e-4), (20.0, False, 5e-9)]
)
def test_a_modulated_second_order_is_its_integral_over_directions(period_mm, striped, within):
    medium = Medium(sigma_t_per_mm=0.2051, sigma_s_per_mm=0.1, g=0.4)
    q, depth_mm = 2 * np.pi / period_mm, 100.0
    grid = PlaneGrid.graded(depth_mm, sigma_t_per_mm=0.2051, n_x=65, n_theta=512, striped=striped)
    field = solve_plane(medium, grid, n_bounces=2, wavenumber_per_mm=q)
    found = field.weighted(medium.sigma_s_per_mm)[1, :60:5]
    exact = [modulated_second_order(x, q, medium, depth_mm) for x in grid.x_mm[:60:5]]
    # measured worst 8.4e-5 and 3.1e-10 of the peak
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=within * np.abs(exact).max())


def modulated_second_order(depth: float, q: float, medium: Medium, far: float) -> complex:
    theta = (np.arange(20_000) + 0.5) * 2 * np.pi / 20_000
    p = phase_function(theta, medium.g, medium.phase)
    cos, sin = np.cos(theta), np.sin(theta)
    rate = medium.sigma_t_per_mm + 1j * q * sin
    length = np.where(cos > 0.0, depth, far - depth) / np.abs(cos)
    start = np.exp(-medium.sigma_t_per_mm * np.where(cos > 0.0, 0.0, far))
    light = (np.exp(-medium.sigma_t_per_mm * depth) - start * np.exp(-rate * length)) / (
        rate - medium.sigma_t_per_mm * cos
    )
    return complex((medium.sigma_s_per_mm * p * light).mean() * 2 * np.pi)


@pytest.mark.parametrize(("g", "angle_deg"), [(0.4, 0.0), (-0.3, 40.0)])
def test_the_middle_of_a_wide_beam_is_light_in_depth_alone(g, angle_deg):
    medium, tank = unit_medium(g, 0.9), Tank(depth_mm=8.0, width_mm=50.0)
    grid = Grid(tank=tank, n_x=129, n_y=51, n_theta=128)
    beam = Beam(from_mm=0.0, to_mm=50.0, angle_deg=angle_deg)
    wide = solve_on(medium, beam, grid, n_bounces=5, light_field=False).fluence[:, 25]
    nodes = PlaneGrid.graded(8.0, sigma_t_per_mm=1.0, n_x=129, n_theta=128)
    alone = solve_plane(medium, nodes, n_bounces=5, angle_deg=angle_deg).at(grid.x_mm, 0.9).fluence
    # measured worst 1.7e-3, at the far wall in the tank's uniform cells of 1/16 mm
    np.testing.assert_allclose(wide, alone, rtol=3e-3)


def test_stripes_of_every_order_are_what_the_monte_carlo_carries():
    medium = Medium(sigma_t_per_mm=0.2, sigma_s_per_mm=0.16, g=0.7)
    tank, q = Tank(depth_mm=30.0, width_mm=100.0), 2 * np.pi / 8.0
    sampled = simulate(
        medium,
        tank,
        Beam(from_mm=0.0, to_mm=100.0),
        n_bounces=6,
        n_paths=100_000,
        cell_mm=2.5,
        seed=5,
        stripe_wavenumber_per_mm=q,
        harmonics=(1,),
    )
    found = sampled.modulated[0, 14:26].mean(axis=0)
    nodes = PlaneGrid.graded(30.0, sigma_t_per_mm=0.2, n_x=129, n_theta=256)
    field = solve_plane(medium, nodes, n_bounces=6, wavenumber_per_mm=q)
    total = CubicSpline(nodes.x_mm, field.weighted(0.16)[1:].sum(axis=0)).antiderivative()
    exact = np.diff(total(np.linspace(0.0, 30.0, 13))) / 2.5
    assert np.abs(exact).max() > 0.1
    # measured worst 1.3e-2 of the peak, the noise of these paths
    np.testing.assert_allclose(found, exact, atol=3e-2 * np.abs(exact).max())


def spherical(depth_mm: float, n_x: int, n_mu: int) -> PlaneGrid:
    """Directions weighted by d mu as those of a sphere are, not by d theta."""
    node, weight = np.polynomial.legendre.leggauss(n_mu)
    v = 0.5 * (node + 1.0)
    theta = np.arccos(v**2 * (3.0 - 2.0 * v))
    return PlaneGrid(
        x_mm=PlaneGrid.graded(depth_mm, sigma_t_per_mm=1.0, n_x=n_x, n_theta=16).x_mm,
        theta_rad=np.concatenate([theta, np.pi - theta, np.pi + theta, 2.0 * np.pi - theta]),
        weight_rad=np.tile(0.5 * np.pi * 3.0 * v * (1.0 - v) * weight, 4),
    )


def test_with_the_weights_of_a_sphere_it_is_chandrasekhars_half_space():
    """Isotropic scattering knows no plane: only the weights tell flatland from three dimensions."""
    albedo = 0.9
    field = solve_plane(unit_medium(), spherical(40.0, 257, 32), n_bounces=90)
    face = field.weighted(albedo)[:, 0].real
    # measured 1e-15
    assert face[1] == pytest.approx(0.5 * albedo * math.log(2.0), rel=1e-12)
    # measured 5.8e-06 at 257 nodes
    assert face.sum() == pytest.approx(chandrasekhar_h(albedo), rel=5e-5)


def chandrasekhar_h(albedo: float) -> float:
    """H(1) of isotropic scattering, by iteration of 1/H = sqrt(1-c) + c/2 int mu' H/(mu+mu')."""
    node, weight = np.polynomial.legendre.leggauss(100)
    mu, weight = 0.5 * (node + 1.0), 0.5 * weight
    h = np.ones_like(mu)
    for _ in range(200):
        kernel = mu * weight * h / (mu[:, None] + mu)
        h = 1.0 / (math.sqrt(1.0 - albedo) + 0.5 * albedo * kernel.sum(axis=1))
    last = (mu * weight * h / (mu + 1.0)).sum()
    return float(1.0 / (math.sqrt(1.0 - albedo) + 0.5 * albedo * last))


@pytest.mark.parametrize(
    ("albedo", "cosine", "by_disort"),
    [
        (
            0.5,
            1.0,
            [0.251259562, 0.324224853, 0.362795015, 0.300770902, 0.0748076475, 1.22931498e-4],
        ),
        (0.9, 1.0, [0.85007727, 1.09831644, 1.40754258, 1.39570159, 0.69395252, 0.0092693]),
        (0.9, 0.5, [0.55602804, 0.71748931, 0.78666339, 0.6504311, 0.22179392, 0.00252774]),
    ],
)
def test_with_the_weights_of_a_sphere_it_is_pythonic_disort(albedo, cosine, by_disort):
    """Diffuse fluence at optical depths 0, 0.1, 0.5, 1, 3 and 10 of 10 by PythonicDISORT 1.8.

    128 streams, isotropic scattering, a beam of unit flux and this cosine of incidence.
    """
    angle_deg = math.degrees(math.acos(cosine))
    grid = spherical(10.0, 513, 32)
    field = solve_plane(unit_medium(), grid, n_bounces=120, angle_deg=angle_deg)
    depths = np.array([0.0, 0.1, 0.5, 1.0, 3.0, 10.0])
    found = field.at(depths, albedo).fluence[1:].sum(axis=0)
    # measured worst 9.4e-7, at the far wall
    np.testing.assert_allclose(found, by_disort, rtol=1e-5)
