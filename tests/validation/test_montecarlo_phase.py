"""The Monte Carlo's phase functions: exact draws, hg-paper, and g up to one."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipe, ellipeinc

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import phase_function, power_removed
from analysis.transport import montecarlo, montecarlo_kernels
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import solve_on

SIGMA_T, SIGMA_S = 0.2, 0.16
TANK = Tank(depth_mm=30.0, width_mm=20.0)
BEAM = Beam(from_mm=5.0, to_mm=15.0)


def medium_of(g: float, phase: str = "hg-plane", **changed: float) -> Medium:
    """A medium, also at the limits that a Medium may not admit."""
    medium = Medium(sigma_t_per_mm=SIGMA_T, sigma_s_per_mm=SIGMA_S, g=0.0, phase=phase)
    for name, value in {"g": g, **changed}.items():
        object.__setattr__(medium, name, value)
    return medium


def rms_pull(
    found: np.ndarray, error: np.ndarray, exact: np.ndarray, *, above: float = 1e-2
) -> float:
    """The rms of difference over error, where that share of the peak or more is expected."""
    bright = exact > above * exact.max()
    return float(np.sqrt(np.mean(((found - exact)[bright] / error[bright]) ** 2)))


@pytest.mark.parametrize("g", [0.0, 0.4, -0.5, 0.9, 0.999999])
def test_hg_paper_is_drawn_from_its_elliptic_integral(g):
    stretched = montecarlo._stretched_phase_function(medium_of(g, "hg-paper"))
    share = np.linspace(1e-4, 1 - 1e-4, 501)
    psi = np.array([montecarlo_kernels.draw(*stretched, part) for part in share])
    k2 = 4 * abs(g) / (1 + abs(g)) ** 2
    # measured worst 5.8e-9, at g = 0.9
    np.testing.assert_allclose(0.5 + 0.5 * ellipeinc(psi, k2) / ellipe(k2), share, atol=2e-8)


@pytest.mark.parametrize("phase", ["hg-plane", "hg-paper"])
@pytest.mark.parametrize("g", [0.3, -0.5, 0.9])
def test_deflections_follow_the_phase_function_as_printed(g, phase):
    stretched = montecarlo._stretched_phase_function(medium_of(g, phase))
    start = -np.pi if g >= 0 else 0.0
    for share in (0.05, 0.4, 0.7):
        turn = montecarlo_kernels.deflect(share, g, stretched)
        end = (turn - start) % (2 * np.pi) + start
        below = quad(
            lambda t: float(phase_function(np.array(t), g, phase)),
            start,
            end,
            points=[start + np.pi],
            epsabs=1e-12,
        )[0]
        # counted from the back if g >= 0, from the front otherwise
        expected = share if g >= 0 else (share + 0.5) % 1.0
        # measured worst 5.1e-9
        assert below / power_removed(g, phase) == pytest.approx(expected, abs=2e-8)


@pytest.mark.parametrize(("g", "n_theta"), [(0.4, 64), (-0.5, 64), (0.9, 128)])
def test_hg_paper_agrees_with_ordinates_also_where_a_bounce_brings_light(g, n_theta):
    """At g = 0.9 a bounce multiplies the light by 3.2 * 0.8."""
    medium = medium_of(g, "hg-paper")
    grid = Grid(tank=TANK, n_x=121, n_y=81, n_theta=n_theta)
    field = solve_on(medium, BEAM, grid, n_bounces=6)
    sampled = simulate(medium, TANK, BEAM, n_bounces=6, n_paths=160_000, cell_mm=2.5, seed=4)
    nodes = field.fluence[1:]
    cells = 0.25 * (nodes[:, 1:, 1:] + nodes[:, :-1, 1:] + nodes[:, 1:, :-1] + nodes[:, :-1, :-1])
    expected = cells.reshape(5, 8, 10, 12, 10).mean(axis=(2, 4))
    for order, mc, error in zip(expected, sampled.fluence, sampled.std_error, strict=True):
        # measured worst 1.29, at order 2, where beside the beam the average of nodes errs by 5e-3
        assert rms_pull(mc, np.hypot(error, 5e-3 * order), order, above=0.1) < 1.5
        # measured worst 5.0e-3, the noise of order 4 at g = 0.4
        assert mc.sum() == pytest.approx(order.sum(), rel=1e-2)


@pytest.mark.parametrize("g", [1.0, 0.999999])
def test_forward_scattering_stays_in_the_beam(g):
    """phi_k = exp(-sigma_t x) (sigma_s x)^(k-1) / (k-1)! inside the beam, 0 outside."""
    sampled = simulate(medium_of(g), TANK, BEAM, n_bounces=5, n_paths=200_000, cell_mm=1.0, seed=2)
    x = (np.arange(3000) + 0.5) / 100
    for k in range(2, 6):
        exact = np.exp(-SIGMA_T * x) * (SIGMA_S * x) ** (k - 1) / math.factorial(k - 1)
        exact = np.tile(exact.reshape(30, 100).mean(axis=1), (10, 1))
        inside, error = sampled.fluence[k - 2, 5:15], sampled.std_error[k - 2, 5:15]
        # measured worst 1.26, where 1.07 is expected of sixteen batches
        assert rms_pull(inside, error, exact) < 1.5
        # measured worst 1.1e-3, the noise of order 3
        assert inside.sum() == pytest.approx(exact.sum(), rel=3e-3)
        outside = np.delete(sampled.fluence[k - 2], np.s_[5:15], axis=0)
        # measured worst 3.2e-5: the tails of the wrapped Cauchy
        assert outside.mean() < 1e-4 * inside.mean()


@pytest.mark.parametrize("g", [-1.0, -0.999999])
def test_backward_scattering_is_the_rod_model(g):
    sampled = simulate(medium_of(g), TANK, BEAM, n_bounces=3, n_paths=200_000, cell_mm=1.0, seed=2)
    x, far = (np.arange(3000) + 0.5) / 100, TANK.depth_mm
    back = np.exp(-SIGMA_T * x) - np.exp(-SIGMA_T * (2 * far - x))
    again = x * np.exp(-SIGMA_T * x) - np.exp(-SIGMA_T * (2 * far + x)) * np.expm1(
        2 * SIGMA_T * x
    ) / (2 * SIGMA_T)
    half = SIGMA_S / (2 * SIGMA_T)
    for k, exact in ((2, half * back), (3, half * SIGMA_S * again)):
        inside, error = sampled.fluence[k - 2, 5:15], sampled.std_error[k - 2, 5:15]
        expected = np.tile(exact.reshape(30, 100).mean(axis=1), (10, 1))
        # measured worst 1.20
        assert rms_pull(inside, error, expected) < 1.5
        # measured worst 2.6e-4
        assert inside.sum() == pytest.approx(expected.sum(), rel=3e-3)


def test_without_extinction_order_two_is_the_potential_of_the_rectangle():
    """phi_2 = sigma_s / (2 pi) * sum over the corners of a asinh(b/a) + b asinh(a/b)."""
    medium = medium_of(0.0, sigma_t_per_mm=0.0, sigma_s_per_mm=1.0)
    beam = Beam(from_mm=0.0, to_mm=20.0)
    sampled = simulate(medium, TANK, beam, n_bounces=4, n_paths=80_000, cell_mm=2.5, seed=2)
    x, y = np.meshgrid((np.arange(240) + 0.5) / 8, (np.arange(160) + 0.5) / 8)
    exact = sum(
        a * np.arcsinh(b / a) + b * np.arcsinh(a / b) for a in (x, 30.0 - x) for b in (y, 20.0 - y)
    ) / (2 * np.pi)
    expected = exact.reshape(8, 20, 12, 20).mean(axis=(1, 3))
    # measured 0.87
    assert rms_pull(sampled.fluence[0], sampled.std_error[0], expected) < 1.3
    # measured 9e-5
    assert sampled.fluence[0].sum() == pytest.approx(expected.sum(), rel=1e-3)
    thin = medium_of(0.0, sigma_t_per_mm=1e-12, sigma_s_per_mm=1e-12)
    tiny = simulate(thin, TANK, beam, n_bounces=4, n_paths=80_000, cell_mm=2.5, seed=2)
    for k in range(3):
        # measured worst 4.4e-11: the same paths, and a thickness of 1e-11 that is forgotten
        np.testing.assert_allclose(
            tiny.fluence[k] / 1e-12 ** (k + 1), sampled.fluence[k], rtol=1e-5
        )
