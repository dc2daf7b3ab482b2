"""Compiled kernels against their own bodies run as plain Python, at toy size."""

import numpy as np
import pytest

from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.transport import beam as beam_kernels
from analysis.transport import montecarlo, montecarlo_kernels, ordinates
from calibration import hdr

TANK = Tank(depth_mm=5.0, width_mm=4.0)
GRID = Grid(tank=TANK, n_x=6, n_y=5, n_theta=8)


def test_second_bounce():
    tank_beam = beam_kernels._tank_and_beam(TANK, Beam(from_mm=1.0, to_mm=2.5, angle_deg=20.0))
    arguments = (GRID.x_mm, GRID.y_mm, GRID.theta_rad, tank_beam, 0.7, np.ones(8))
    fast, slow = np.empty((8, 5, 6)), np.empty((8, 5, 6))
    beam_kernels._fill_second_bounce(*arguments, fast)
    beam_kernels._fill_second_bounce.py_func(*arguments, slow)
    # measured equal to the bit
    np.testing.assert_allclose(fast, slow, atol=1e-14)


@pytest.mark.parametrize("point", [(1.0, 2.0, 0.3), (4.9, 0.1, 3.0), (0.0, 1.5, 1.571)])
def test_strip_integral(point):
    x, y, theta = point
    rest = (np.cos(theta), np.sin(theta), 5.0, 4.0, 1.0, 2.5, np.cos(0.3), np.sin(0.3), 0.7)
    fast = beam_kernels.integrate_strip(x, y, *rest)
    assert fast == pytest.approx(beam_kernels.integrate_strip.py_func(x, y, *rest), rel=1e-12)


def test_sweep():
    source = np.random.default_rng(1).random((8, 30))
    fast, slow = np.empty((8, 30)), np.empty((8, 30))
    for kernel, out in ((ordinates._sweep, fast), (ordinates._sweep.py_func, slow)):
        kernel(source, GRID.theta_rad, (5, 6), (1.0, 1.0), 0.7, out)
    for n in range(8):
        march = np.empty(30)
        ordinates._march.py_func(source[n], 0, (1, 6), (6, 5), 0.4, 1.1, 0.7, march)
        compiled = np.empty(30)
        ordinates._march(source[n], 0, (1, 6), (6, 5), 0.4, 1.1, 0.7, compiled)
        # measured equal to the bit
        np.testing.assert_allclose(march, compiled, atol=1e-14)
    np.testing.assert_allclose(fast, slow, atol=1e-14)
    assert (fast >= 0.0).all()


@pytest.mark.parametrize("tau", [0.0, 1e-8, 0.29, 0.31, 5.0])
def test_exponential_moments(tau):
    x = (np.arange(20_000) + 0.5) / 20_000
    exact = [np.mean(x**k * np.exp(-tau * x)) for k in range(3)]
    found = ordinates._exponential_moments.py_func(tau)
    # measured worst 3e-9: the sum that stands for the integral
    np.testing.assert_allclose(found, exact, rtol=1e-7)
    np.testing.assert_allclose(found, ordinates._exponential_moments(tau), rtol=1e-13)


@pytest.mark.parametrize("phase", ["hg-plane", "hg-paper"])
def test_monte_carlo_path(phase):
    medium = Medium(sigma_t_per_mm=0.7, sigma_s_per_mm=0.56, g=0.4, phase=phase)

    def run(kernel):
        scores, modulated = np.zeros((3, 4, 5)), np.zeros((4, 5, 2), dtype=np.complex128)
        lobes = np.zeros((1, 8, 4, 5))
        rng = np.random.default_rng(3)
        kernel(
            np.array([0.7, 0.56, 0.4, 1.1]),
            np.array([5.0, 4.0]),
            0.3,
            montecarlo._with_cumulative(np.array([1.0, 1.5, 2.5]), np.array([0.0, 2.0, 1.0])),
            montecarlo._stretched_phase_function(medium),
            (0, 200),
            rng,
            rng.random(5),
            montecarlo._lattice(5),
            2.0,
            np.array([1, 3]),
            np.array([-1, 0, -1]),
            scores,
            lobes,
            modulated,
        )
        return scores, lobes, modulated

    for fast, slow in zip(
        run(montecarlo_kernels.follow), run(montecarlo_kernels.follow.py_func), strict=True
    ):
        # measured worst 1.0e-13: the same random numbers, sums in the same order
        np.testing.assert_allclose(fast, slow, atol=1e-10)
        assert np.abs(slow).max() > 1.0


@pytest.mark.parametrize("g", [0.4, -0.6, 1.0, -1.0])
def test_draw_and_deflect(g):
    nodes, density = np.array([1.0, 1.5, 2.0, 2.5]), np.array([0.0, 2.0, 1.0, 0.0])
    entry = montecarlo._with_cumulative(nodes, density)
    fine = np.linspace(1.0, 2.5, 200_001)
    for share in (0.0, 0.2, 0.5, 0.99):
        found = montecarlo_kernels.draw.py_func(*entry, share)
        assert found == montecarlo_kernels.draw(*entry, share)
        below = np.interp(fine[fine <= found], nodes, density).sum() * (fine[1] - fine[0])
        # measured worst 1.5e-5: the sum that stands for the integral
        assert below / 1.5 == pytest.approx(share, abs=3e-5)
        uniform = (np.empty(0), np.empty(0), np.empty(0))
        turned = montecarlo_kernels.deflect.py_func(share, g, uniform)
        assert turned == pytest.approx(montecarlo_kernels.deflect(share, g, uniform), abs=1e-14)
        if abs(g) == 1.0:
            assert turned == pytest.approx(0.0 if g > 0 else np.pi, abs=1e-15)


def test_merge():
    counts = np.random.default_rng(2).integers(0, 4096, (3, 40)).astype(np.uint16)
    counts[:, 0] = 4095
    results = []
    for kernel in (hdr._merge, hdr._merge.py_func):
        value, variance = np.empty(40, np.float32), np.empty(40, np.float32)
        noise = (0.28, 9.4)
        kernel(
            counts, np.array([0.1, 0.2, 0.4]), np.full(3, 16.0), 3890.0, noise, 3, value, variance
        )
        results.append((value, variance))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])
    assert np.isnan(results[0][0][0])
