"""Higher orders against exact values, energy balance, and the independent Monte Carlo."""

import numpy as np
import pytest
from scipy.special import k0, k1

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import phase_function, power_removed
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import solve_on

TANK = Tank(depth_mm=100.0, width_mm=75.0)
BEAM = Beam(from_mm=25.0, to_mm=50.0)
SIGMA_T = 0.2051


def wide_half_space(g: float, n_x: int, n_theta: int) -> tuple[np.ndarray, np.ndarray]:
    """Orders in the middle of a beam so wide that its edges do not matter (sigma_t = 1 / mm)."""
    tank = Tank(depth_mm=12.0, width_mm=60.0)
    grid = Grid(tank=tank, n_x=n_x, n_y=61, n_theta=n_theta)
    medium = Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=1.0, g=g)
    field = solve_on(medium, Beam(from_mm=0.0, to_mm=60.0), grid, n_bounces=5)
    return grid.x_mm, field.fluence[:, 30]


def test_face_fluence_of_isotropic_scattering_is_the_h_function():
    _, orders = wide_half_space(0.0, n_x=481, n_theta=256)
    exact = [1.0, 1 / np.pi, 1 / 8 + 1 / (2 * np.pi**2), 0.115900, 0.083964]
    # measured relative errors 0, 2.5e-5, 6.8e-5, 1.03e-4, 1.04e-4
    np.testing.assert_allclose(orders[:, 0], exact, rtol=2e-4)


def test_peaks_move_inward_and_order_three_peaks_where_it_should():
    x, orders = wide_half_space(0.0, n_x=481, n_theta=256)
    peaks = [x[np.argmax(order)] for order in orders]
    assert peaks[0] == 0.0
    assert peaks == sorted(peaks)
    # nodes are 0.025 apart; measured 0.325 and 0.625
    assert peaks[1] == pytest.approx(0.3146631336, abs=0.026)
    assert peaks[2] == pytest.approx(0.618132, abs=0.026)


def test_phi2_follows_the_bessel_formula_with_depth():
    x, orders = wide_half_space(0.0, n_x=241, n_theta=256)
    inside = (x > 0.2) & (x < 8.0)
    exact = x[inside] * (k0(x[inside]) + k1(x[inside])) / np.pi
    # measured worst 1.2e-5, at the deepest node: 256 angles
    np.testing.assert_allclose(orders[1][inside], exact, rtol=3e-5)


@pytest.mark.parametrize(("g", "phase"), [(0.4, "hg-plane"), (0.0, "hg-plane"), (0.4, "hg-paper")])
def test_every_order_keeps_its_energy(g, phase):
    """sigma_t int phi_k + escape_k = f0 sigma_s int phi_(k-1), orders 2 to 6."""
    medium = Medium(sigma_t_per_mm=SIGMA_T, sigma_s_per_mm=0.9 * SIGMA_T, g=g, phase=phase)
    grid = Grid(tank=TANK, n_x=401, n_y=301, n_theta=64)
    field = solve_on(medium, BEAM, grid, n_bounces=6)
    wx, wy = trapezoid(grid.x_mm), trapezoid(grid.y_mm)
    integrals = [float(wy @ order @ wx) for order in field.fluence]
    integrals[0] = 25.0 * -np.expm1(-SIGMA_T * 100.0) / SIGMA_T
    cos, sin = np.cos(grid.theta_rad), np.sin(grid.theta_rad)
    for k in range(2, 7):
        light = field.light_field[k - 2]
        escape = (2 * np.pi / grid.n_theta) * (
            wy @ (light[:, -1] @ np.maximum(cos, 0) + light[:, 0] @ np.maximum(-cos, 0))
            + wx @ (light[-1] @ np.maximum(sin, 0) + light[0] @ np.maximum(-sin, 0))
        )
        scattered = power_removed(g, phase) * medium.sigma_s_per_mm * integrals[k - 2]
        # measured worst 3.2e-4 at order 2 (trapezoid beside the beam's edges), then 2.8e-4, 6e-5
        assert SIGMA_T * integrals[k - 1] + escape == pytest.approx(scattered, rel=1e-3)


def trapezoid(nodes: np.ndarray) -> np.ndarray:
    weights = np.full(nodes.size, nodes[1] - nodes[0])
    weights[[0, -1]] /= 2
    return weights


@pytest.mark.parametrize(
    ("albedo", "g", "angle_deg"), [(0.5, 0.4, 0.0), (0.9, 0.7, 30.0), (0.8, -0.3, 0.0)]
)
def test_ordinates_agree_with_monte_carlo(albedo, g, angle_deg):
    """Two routes with nothing in common but the equation."""
    medium = Medium(sigma_t_per_mm=SIGMA_T, sigma_s_per_mm=albedo * SIGMA_T, g=g)
    beam = Beam(from_mm=25.0, to_mm=50.0, angle_deg=angle_deg)
    grid = Grid(tank=TANK, n_x=201, n_y=151, n_theta=96)
    field = solve_on(medium, beam, grid, n_bounces=6)
    sampled = simulate(medium, TANK, beam, n_bounces=6, n_paths=1_000_000, cell_mm=2.5, seed=11)
    for order in range(2, 7):
        averaged = block_mean(field.fluence[order - 1], 5)
        mc, std = sampled.fluence[order - 2], sampled.std_error[order - 2]
        cells = averaged > 1e-2 * averaged.max()
        assert cells.sum() > 150
        difference = (averaged - mc)[cells]
        rms = np.sqrt(np.mean(difference**2) / np.mean(averaged[cells] ** 2))
        noise = np.sqrt(np.mean(std[cells] ** 2) / np.mean(averaged[cells] ** 2))
        # measured excess over the noise at most 5.4e-3, at order 2: the node values are averaged
        # over cells by the trapezoidal rule, also beside the beam's edges
        assert np.sqrt(max(rms**2 - noise**2, 0.0)) < 8e-3
        total = averaged[cells].sum() / mc[cells].sum()
        # measured worst 2.7e-3, at order 6
        assert total == pytest.approx(1.0, abs=5e-3)


def block_mean(nodes: np.ndarray, n: int) -> np.ndarray:
    """Average node values over blocks of n x n grid cells, by the trapezoidal rule."""
    cells = 0.25 * (nodes[1:, 1:] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[:-1, :-1])
    ny, nx = cells.shape
    return cells.reshape(ny // n, n, nx // n, n).mean(axis=(1, 3))


def test_monte_carlo_carries_stripes_as_the_closed_second_order_says():
    """A(d; q) of order 2 in the middle of a wide beam, against its integral over directions."""
    medium = Medium(sigma_t_per_mm=SIGMA_T, sigma_s_per_mm=0.5 * SIGMA_T, g=0.4)
    q = 2 * np.pi / 1.8
    sampled = simulate(
        medium,
        TANK,
        BEAM,
        n_bounces=2,
        n_paths=400_000,
        cell_mm=1.25,
        seed=5,
        stripe_wavenumber_per_mm=q,
        harmonics=(1,),
    )
    found = sampled.modulated[0, 24:36].mean(axis=0)
    depths = sampled.x_mm[1:9]
    exact = np.array([modulated_second_order(x, q, medium) for x in depths])
    # measured worst 2.9e-4 of a peak of 2.6e-2, which is the noise of 400 000 paths
    np.testing.assert_allclose(found[1:9], exact, atol=6e-4)


def modulated_second_order(depth: float, q: float, medium: Medium) -> complex:
    theta = (np.arange(20_000) + 0.5) * 2 * np.pi / 20_000
    p = phase_function(theta, medium.g, medium.phase)
    cos, sin = np.cos(theta), np.sin(theta)
    sigma_t, far = medium.sigma_t_per_mm, TANK.depth_mm
    rate = sigma_t + 1j * q * sin
    ahead = np.where(cos > 0, rate * depth / np.abs(cos), 0)
    behind = np.where(cos < 0, rate * (far - depth) / np.abs(cos), 0)
    start = np.exp(-sigma_t * depth)
    forward = (start - np.exp(-ahead)) / (rate - sigma_t * cos)
    backward = (start - np.exp(-sigma_t * far - behind)) / (rate + sigma_t * np.abs(cos))
    light = medium.sigma_s_per_mm * p * np.where(cos > 0, forward, backward)
    return complex(light.mean() * 2 * np.pi)


def test_monte_carlo_repeats_itself_bit_for_bit_whatever_the_threads():
    medium = Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=0.8, g=0.3)
    tank, beam = Tank(depth_mm=5.0, width_mm=4.0), Beam(from_mm=1.0, to_mm=2.0)
    runs = [
        simulate(medium, tank, beam, n_bounces=4, n_paths=3200, cell_mm=0.5, seed=7, n_threads=n)
        for n in (1, 2)
    ]
    np.testing.assert_array_equal(runs[0].fluence, runs[1].fluence)
