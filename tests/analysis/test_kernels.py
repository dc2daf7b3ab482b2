"""Compiled kernels against their own bodies run as plain Python, at toy size."""

import numpy as np
import pytest

from analysis import separation
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
    counts = np.random.default_rng(2).integers(0, 4096, (3, 6, 7)).astype(np.uint16)
    counts[:, 0, 0] = 4095
    results = []
    for add, solve in ((hdr._add, hdr._solve), (hdr._add.py_func, hdr._solve.py_func)):
        sums, counted = np.zeros((3, 42), np.float32), np.zeros((3, 42), np.uint16)
        table, offset = np.arange(4096, dtype=np.float32), np.full(1, 16.0, np.float32)
        for k in range(3):
            add(counts[k], table, offset, (3890.0, 4095.0), sums[k], counted[k])
        value, variance = np.empty(42, np.float32), np.empty(42, np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            solve(sums, counted, np.array([0.1, 0.2, 0.4]), (0.28, 9.4), 3, value, variance)
        results.append((sums, value, variance))
    for fast, slow in zip(*results, strict=True):
        # measured equal to the bit
        np.testing.assert_array_equal(fast, slow)
    assert np.isnan(results[0][1][0])


def separation_by_numpy(net, variance, pattern, duty):
    """The literal equations: least squares pixel by pixel with numpy's own solver."""
    n, rows, cols = net.shape
    found = np.empty((5, rows, cols))
    for y in range(rows):
        for x in range(cols):
            p = np.stack([pattern[:, y, x], np.full(n, duty)], axis=1)
            inverse = np.linalg.inv(p.T @ p) @ p.T
            answer = inverse @ net[:, y, x]
            covariance = inverse @ np.diag(variance[:, y, x]) @ inverse.T
            rest = net[:, y, x] - p @ answer
            chi2 = (rest @ rest) / variance[:, y, x].mean() / (n - 2)
            found[:, y, x] = *answer, *np.diag(covariance), chi2
    return found


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_known_pattern(dtype):
    rng = np.random.default_rng(4)
    net, variance = rng.random((6, 5, 4)).astype(dtype), rng.random((6, 5, 4)).astype(dtype) + 1
    pattern = rng.random((6, 5, 4))
    found = separation.separate_known(net, variance, pattern, 0.4)
    literal = separation_by_numpy(net.astype(float), variance.astype(float), pattern, 0.4)
    parts = (found.single, found.multiple, found.single_variance, found.multiple_variance)
    # measured worst 2e-13
    np.testing.assert_allclose(np.stack([*parts, found.chi2]), literal, rtol=1e-9)


@pytest.mark.parametrize("kernel", ["_known", "_harmonic", "_extrema"])
def test_separation_kernels(kernel):
    rng = np.random.default_rng(5)
    net, variance = rng.random((6, 5, 4)), rng.random((6, 5, 4))
    net[2, 0, 0] = np.nan
    turn = 2.0 * np.pi * np.arange(6) / 6
    own = {
        "_known": (rng.random((6, 5, 1)), 0.5, 1e-4),
        "_harmonic": (np.stack([np.cos(turn), -np.sin(turn)]) / 3.0, np.full(4, 1.6), 0.5),
        "_extrema": (0.5,),
    }[kernel]
    fast, slow = np.empty((5, 5, 4)), np.empty((5, 5, 4))
    seen = np.empty((2, 5, 4), np.uint8)
    compiled = getattr(separation, kernel)
    with np.errstate(invalid="ignore"):
        compiled(net, variance, *own, *fast[:4], seen[0], fast[4])
        compiled.py_func(net, variance, *own, *slow[:4], seen[1], slow[4])
    # measured worst 3e-16
    np.testing.assert_allclose(fast, slow, rtol=1e-12)
    np.testing.assert_array_equal(seen[0], seen[1])
    assert np.isnan(fast[:4, 0, 0]).all()
