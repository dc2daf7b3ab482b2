"""Compiled kernels against their own bodies run as plain Python, at toy size."""

import numpy as np
import pytest

from analysis import separation, separation_kernels
from analysis.light_field import Grid
from analysis.medium import Medium, Tank
from analysis.transport import beam as beam_kernels
from analysis.transport import montecarlo, montecarlo_kernels, plane, sweep
from calibration import hdr

TANK = Tank(depth_mm=5.0, width_mm=4.0)
GRID = Grid(tank=TANK, n_x=6, n_y=5, n_theta=8)


@pytest.mark.parametrize("theta", [0.3, 1.9, 3.5, 5.9])
def test_cut_rays(theta):
    """Both orders of lines, and rays that miss."""
    places = beam_kernels.places_of(GRID)
    rays = beam_kernels._describe_rays(np.array([theta]), 0.3, 0.7)
    results = []
    for kernel in (beam_kernels._cut_rays, beam_kernels._cut_rays.py_func):
        found = np.empty((4, 1, 5, 6))
        kernel(*places, rays, np.array([0.3]), (5.0, 4.0), (1.0, 2.5, 0.5, 1.0), *found)
        results.append(found)
    # measured equal to the bit
    np.testing.assert_allclose(results[0], results[1], atol=1e-14)
    assert (results[0][2] == 0.0).any()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("cos_sign", [1.0, -1.0])
def test_sweep(dtype, cos_sign):
    source = np.random.default_rng(1).random((4, 6, 9)).astype(dtype)
    cos_t, sin_t = cos_sign * np.cos([0.1, 0.7, -0.3, -0.6]), np.sin([0.1, 0.7, -0.3, -0.6])
    fast, slow = np.empty_like(source), np.empty_like(source)
    for kernel, out in ((sweep._march, fast), (sweep._march.py_func, slow)):
        for n in range(4):
            ray = sweep._describe(sin_t[n] / abs(cos_t[n]), 1.1, 0.5)
            kernel(source[n], bool(cos_t[n] > 0.0), ray, out[n])
    # measured equal to the bit in double; single rounds once more in the interpreter
    tolerance = 1e-14 if dtype is np.float64 else 1e-6
    np.testing.assert_allclose(fast, slow, atol=tolerance)
    assert (fast >= 0.0).all()
    whole = np.empty_like(source)
    sweep.sweep(source, cos_t, sin_t, (1.1, 1.1), 0.5, whole)
    again = np.empty_like(source)
    sweep.sweep.py_func(source, cos_t, sin_t, (1.1, 1.1), 0.5, again)
    np.testing.assert_allclose(whole, again, atol=tolerance)


def test_plane_sweep():
    rng = np.random.default_rng(1)
    source = rng.random((4, 9)) + 1j * rng.random((4, 9))
    cos_t = np.array([0.9, 0.2, -0.4, -1.0])
    steps = plane.node_steps(np.linspace(0.0, 3.0, 9) ** 1.3, cos_t, 0.7 + 1j * cos_t)
    fast = plane.carry(source, cos_t > 0.0, *steps)
    slow = plane.carry.py_func(source, cos_t > 0.0, *steps)
    # measured equal to the bit
    np.testing.assert_allclose(fast, slow, atol=1e-14)


@pytest.mark.parametrize("tau", [0.0, 1e-8, 0.29, 0.31, 0.49, 0.51, 5.0])
def test_exponential_moments(tau):
    x = (np.arange(20_000) + 0.5) / 20_000
    exact = [np.mean(x**k * np.exp(-tau * x)) for k in range(3)]
    found = sweep.exponential_moments.py_func(tau)
    # measured worst 3e-9: the sum that stands for the integral
    np.testing.assert_allclose(found, exact, rtol=1e-7)
    np.testing.assert_allclose(found, sweep.exponential_moments(tau), rtol=1e-13)
    # measured worst 6e-15
    complex_ones = plane._moments(np.array([tau + 0j]))
    np.testing.assert_allclose(np.ravel(complex_ones).real, found, rtol=1e-12)


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
            montecarlo.with_cumulative(np.array([1.0, 1.5, 2.5]), np.array([0.0, 2.0, 1.0])),
            montecarlo._stretched_phase_function(medium),
            (0, 200),
            rng,
            rng.random(5),
            montecarlo.lattice_steps(5),
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
    entry = montecarlo.with_cumulative(nodes, density)
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
    # measured worst 2e-13, and 1.9e-5 of sums in single precision
    np.testing.assert_allclose(
        np.stack([*parts, found.chi2]), literal, rtol=1e-9 if dtype is np.float64 else 1e-4
    )


@pytest.mark.parametrize("kernel", ["known", "harmonic", "extrema"])
def test_separation_kernels(kernel):
    rng = np.random.default_rng(5)
    net, variance = rng.random((6, 5, 4)), rng.random((6, 5, 4))
    net[2, 0, 0] = np.nan
    turn = 2.0 * np.pi * np.arange(6) / 6
    own = {
        "known": (rng.random((6, 5, 1)), 0.5, 1e-4),
        "harmonic": (np.stack([np.cos(turn), -np.sin(turn)]) / 3.0, np.full(4, 1.6), 0.5),
        "extrema": (0.5,),
    }[kernel]
    fast, slow = np.empty((5, 5, 4)), np.empty((5, 5, 4))
    seen = np.empty((2, 5, 4), np.uint8)
    compiled = getattr(separation_kernels, kernel)
    with np.errstate(invalid="ignore"):
        compiled(net, variance, *own, *fast[:4], seen[0], fast[4])
        compiled.py_func(net, variance, *own, *slow[:4], seen[1], slow[4])
    # measured worst 3e-16
    np.testing.assert_allclose(fast, slow, rtol=1e-12)
    np.testing.assert_array_equal(seen[0], seen[1])
    assert np.isnan(fast[:4, 0, 0]).all()
