"""Compiled kernels against their own bodies run as plain Python, at toy size."""

import numpy as np
import pytest

from analysis.light_field import Grid
from analysis.medium import Beam, Tank
from analysis.transport import beam as beam_kernels
from analysis.transport import montecarlo, ordinates
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


def test_monte_carlo_path():
    def run(kernel):
        scores, modulated = np.zeros((3, 4, 5)), np.zeros((4, 5, 2), dtype=np.complex128)
        kernel(
            np.array([0.7, 0.8, 0.4]),
            np.array([5.0, 4.0]),
            np.array([1.0, 2.5, 0.3]),
            200,
            np.random.default_rng(3),
            montecarlo._lattice(5),
            2.0,
            np.array([1, 3]),
            scores,
            modulated,
        )
        return scores, modulated

    fast, slow = run(montecarlo._follow), run(montecarlo._follow.py_func)
    # measured equal to the bit: the same random numbers, sums in the same order
    np.testing.assert_allclose(fast[0], slow[0], atol=1e-10)
    np.testing.assert_allclose(fast[1], slow[1], atol=1e-10)


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
