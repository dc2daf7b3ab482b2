"""Bounces of a slab against the 3-D Monte Carlo, a plane-parallel code, and what must hold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from slabs import binned, solved

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Slab, Tank
from analysis.slab_field import slab_bounces
from analysis.transport.fresnel import reflectance
from analysis.transport.montecarlo_slab import SlabSample, simulate_slab
from analysis.transport.slab import solve_slab
from analysis.transport.slab_grid import bearings_of
from analysis.transport.slab_resolution import depths, directions
from analysis.transport.slab_second import second_order
from analysis.transport.slab_tolerance import solve_to

STRIPES = 2.0 * math.pi / 1.8  # wave number of 1.8 mm, 1/mm
SLAB = Slab(depth_mm=30.0, height_mm=5.0, surface_index=1.33)


def medium(sigma_t: float, g: float) -> Medium:
    return Medium(sigma_t_per_mm=sigma_t, sigma_s_per_mm=sigma_t, g=g)


@pytest.fixture(scope="module")
def sample() -> SlabSample:
    m = Medium(sigma_t_per_mm=0.35, sigma_s_per_mm=0.85 * 0.35, g=0.7)
    return simulate_slab(
        m,
        SLAB,
        n_bounces=7,
        n_paths=400_000,
        cell_mm=1.0,
        seed=5,
        wavenumber_per_mm=STRIPES,
        harmonics=(1,),
        n_threads=1,
    )


def test_second_order_is_the_monte_carlo_bin_by_bin(sample):
    edges = np.arange(15.0)
    x = np.linspace(0.0, 14.0, 281)
    for q, seen, noise in (
        (0.0, sample.light, sample.std_error),
        (STRIPES, sample.modulated[0].real, sample.modulated_std_error[0]),
    ):
        closed = 0.85 * second_order(x, medium(0.35, 0.7), SLAB, wavenumber_per_mm=q)
        pull = (seen[0, 0, :14] - binned(closed, x, 0.35, edges)) / noise[0, 0, :14]
        # measured rms 0.66 and 0.92; an error known to 18 % and 14 bins allow 0.5 to 1.6
        assert 0.5 < np.sqrt(np.mean(pull**2)) < 1.6


def test_later_orders_are_the_monte_carlo(sample):
    field = solved(medium(0.35, 0.7), SLAB, fineness=1.2)
    model = binned(field.camera, field.x_mm, 0.35, np.arange(15.0))
    model *= 0.85 ** np.arange(6)[:, None]
    for k in range(3, 7):
        seen, noise = sample.light[k - 2, 0, :14], sample.std_error[k - 2, 0, :14]
        weight = model[k - 1] / noise**2
        ratio = (seen @ weight) / (model[k - 1] @ weight)
        error = 1.0 / math.sqrt(model[k - 1] @ weight)
        # measured 0.02 to 0.11 %, of a noise of 0.16 to 0.39 %
        assert abs(ratio - 1.0) < 0.005 + 3.0 * error
    total, seen = model[1:].sum(axis=0), sample.light[:5, 0, :14].sum(axis=0)
    noise = np.sqrt((sample.std_error[:5, 0, :14] ** 2).sum(axis=0))
    ratio = (seen @ (total / noise**2)) / (total @ (total / noise**2))
    # measured 0.08 %
    assert ratio == pytest.approx(1.0, abs=0.003)


def test_fluence_is_the_monte_carlo():
    m = Medium(sigma_t_per_mm=0.2051, sigma_s_per_mm=0.10255, g=0.4)
    seen = simulate_slab(
        m, SLAB, n_bounces=4, n_paths=100_000, cell_mm=2.0, seed=6, scored="fluence", n_threads=1
    )
    field = solved(medium(0.2051, 0.4), SLAB, orders=4)
    model = binned(field.fluence, field.x_mm, 0.2051, np.arange(0.0, 22.0, 2.0))
    model *= 0.5 ** np.arange(4)[:, None]
    pull = (seen.light[:, 0, :10] - model[1:]) / np.hypot(
        seen.std_error[:, 0, :10], 0.003 * model[1:]
    )
    # measured rms 1.0
    assert np.sqrt(np.mean(pull**2)) < 1.6


@pytest.mark.parametrize(
    ("g", "albedo", "by_disort"),
    [
        (0.4, 0.5, [0.14065688, 0.223225839, 0.332376293, 0.323787806, 0.111217247, 0.000397365]),
        (0.7, 0.9, [0.387114784, 0.558302036, 0.952450041, 1.178127117, 1.040950034, 0.0930269]),
    ],
)
def test_a_high_slab_is_plane_parallel(g, albedo, by_disort):
    """Diffuse fluence at optical depths 0, 0.1, 0.5, 1, 3 and 10 of 10 by PythonicDISORT 1.8.

    64 streams, 64 moments, normal incidence, a beam of unit flux.
    """
    slab = Slab(depth_mm=10.0, height_mm=1e6)
    grid = directions(
        g,
        slab,
        depths(1.0, replace(slab, height_mm=5.0), fineness=1.5),
        wavenumber_per_mm=0.0,
        fineness=1.3,
    )
    field = solve_slab(medium(1.0, g), slab, replace(grid, n_z=2), n_bounces=120)
    orders = field.fluence * albedo ** np.arange(120)[:, None] * np.exp(-field.x_mm)
    found = CubicSpline(field.x_mm, orders[1:].sum(axis=0))([0.0, 0.1, 0.5, 1.0, 3.0, 10.0])
    # measured worst 3e-4
    np.testing.assert_allclose(found[:5], by_disort[:5], rtol=1e-3)
    # At the far wall, whose boundary layer the depths do not resolve: measured 4e-3.
    assert found[5] == pytest.approx(by_disort[5], rel=8e-3)


@pytest.mark.parametrize(("g", "index"), [(0.0, 1.0), (0.4, 1.33), (0.7, 1.33)])
def test_every_order_keeps_its_energy(g, index):
    """sigma_t int phi_k + what leaves by any wall = sigma_t int phi_(k-1)."""
    slab = replace(SLAB, surface_index=index)
    field = solved(medium(0.35, g), slab, fineness=1.5)
    decay = np.exp(-0.35 * field.x_mm)
    inside = 0.35 * CubicSpline(field.x_mm, field.fluence * decay, axis=1).integrate(0.0, 30.0)
    lost = CubicSpline(field.x_mm, field.escape * decay, axis=1).integrate(0.0, 30.0)
    lost += field.ends @ [1.0, decay[-1]]
    # measured worst 1.2e-3
    np.testing.assert_allclose((inside + lost)[1:], inside[:-1], rtol=2e-3)


def test_scaling_and_the_shape_of_the_first_order():
    one = solved(medium(0.35, 0.4), SLAB, q=STRIPES)
    small = Slab(depth_mm=15.0, height_mm=2.5, surface_index=1.33)
    half = solved(medium(0.7, 0.4), small, q=2.0 * STRIPES)
    # measured 2e-13
    np.testing.assert_allclose(half.camera, one.camera, rtol=1e-10, atol=1e-13)
    assert (one.camera[0] == 1.0).all()


def test_a_surface_of_index_one_reflects_nothing_and_a_dark_one_all():
    assert reflectance(0.7, 1.0) == 0.0
    assert reflectance(0.5, 1.33) == 1.0
    # ((n - 1) / (n + 1))^2, and the textbook's 45 degrees from glass of 1.33: 0.0527
    assert reflectance(1.0, 1.33) == pytest.approx((0.33 / 2.33) ** 2)
    brighter = solved(medium(0.2051, 0.4), SLAB).camera
    plain = solved(medium(0.2051, 0.4), replace(SLAB, surface_index=1.0)).camera
    nearly = solved(medium(0.2051, 0.4), replace(SLAB, surface_index=1.0 + 1e-9)).camera
    assert (brighter[1:] > plain[1:]).all()
    # measured 1.2e-7: grazing light is reflected by any step of the index
    np.testing.assert_allclose(nearly, plain, rtol=1e-4)


def test_closed_second_order_is_settled_in_its_angles():
    """Three times as many change nothing that matters."""
    m = medium(0.2051, 0.4)
    x = np.array([0.2, 1.0, 4.0, 12.0])
    fine = second_order(x, m, SLAB, wavenumber_per_mm=STRIPES, n_angles=60)
    found = second_order(x, m, SLAB, wavenumber_per_mm=STRIPES)
    # measured worst 2.9e-4
    np.testing.assert_allclose(found, fine, rtol=3e-3)


@pytest.mark.parametrize(
    ("height", "index", "word"),
    [
        (0.0, 1.0, "height 0.0"),
        (-2.0, 1.0, "height -2.0"),
        (5.0, 0.9, "below one"),
        (math.nan, 1.0, "finite"),
        (5.0, math.nan, "finite"),
    ],
)
def test_an_impossible_slab_is_refused_in_one_line(height, index, word):
    with pytest.raises(AnalysisError, match=word) as raised:
        Slab(depth_mm=10.0, height_mm=height, surface_index=index)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("sigma_t", "height", "word"),
    [
        (0.0, 5.0, "0 mean free paths in depth"),
        (0.2, 1e300, "2e[+]299 in height"),
        (0.2, 1e-300, "1e[+]301 times as deep"),
        (1e3, 0.5, "1e[+]04 mean free paths deep"),
    ],
)
def test_a_layer_beyond_all_numbers_is_refused(sigma_t, height, word):
    with pytest.raises(AnalysisError, match=word):
        depths(sigma_t, Slab(depth_mm=10.0, height_mm=height), fineness=1.0)


def test_what_cannot_be_solved_or_sampled_is_refused():
    grid = directions(
        0.0, SLAB, depths(1.0, SLAB, fineness=0.5), wavenumber_per_mm=0.0, fineness=0.5
    )
    with pytest.raises(AnalysisError, match="extinction"):
        solve_slab(medium(0.0, 0.0), SLAB, grid, n_bounces=3)
    with pytest.raises(AnalysisError, match="two"):
        solve_slab(medium(1.0, 0.0), SLAB, grid, n_bounces=1)
    with pytest.raises(AnalysisError, match="ends at"):
        solve_slab(medium(1.0, 0.0), replace(SLAB, depth_mm=9.0), grid, n_bounces=3)
    with pytest.raises(AnalysisError, match="cell_mm"):
        simulate_slab(medium(1.0, 0.0), SLAB, n_bounces=3, n_paths=160, cell_mm=0.0, seed=1)


def test_light_by_bearing_adds_up_to_the_fluence_and_looks_ahead():
    m = medium(0.35, 0.7)
    x = depths(0.35, SLAB, fineness=0.8)
    grid = directions(0.7, SLAB, x, wavenumber_per_mm=STRIPES, fineness=0.8)
    for q in (0.0, STRIPES):
        field = solve_slab(m, SLAB, grid, n_bounces=4, wavenumber_per_mm=q, n_bearings=32)
        total = field.bearing.sum(axis=2) * 2.0 * np.pi / 32
        # measured 2e-15; under stripes left and right are conjugates, and add up to what is real
        np.testing.assert_allclose(total[1:], field.fluence[1:], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(field.bearing[:, :, ::-1], field.bearing.conj(), atol=1e-12)
    plain = solve_slab(m, SLAB, grid, n_bounces=4, n_bearings=32).bearing.real
    ahead = np.cos(2.0 * np.pi * (np.arange(32) + 0.5) / 32)
    middle = x.size // 2
    mean = (plain[1:, middle] @ ahead) / plain[1:, middle].sum(axis=1)
    # light forgets its direction bounce by bounce: measured 0.74, 0.55, 0.41
    assert (np.diff(mean) < -0.05).all()
    assert mean[0] > 0.5


def test_no_direction_is_without_a_bearing_on_the_finest_grid():
    x = depths(0.35, SLAB, fineness=1.0)
    grid = directions(0.9, SLAB, x, wavenumber_per_mm=0.0, fineness=5.0)
    shares = bearings_of(grid, 64)
    whole = np.pi * np.outer(grid.phi_weight, grid.weight)
    np.testing.assert_allclose(shares.sum(axis=0) * 2.0 * np.pi / 64, whole, rtol=1e-12)


def test_a_stated_error_is_no_less_than_the_true_one():
    m = medium(0.35, 0.7)
    fine = solve_to(m, SLAB, tolerance=3e-4, n_bounces=5)
    for tolerance in (1e-2, 3e-3):
        found = solve_to(m, SLAB, tolerance=tolerance, n_bounces=5)
        assert found.reached
        assert found.error.max() <= tolerance
        x = np.linspace(0.0, 15.0, 100)
        one, other = (
            CubicSpline(f.field.x_mm, f.field.camera, axis=1)(x) * np.exp(-0.35 * x)
            for f in (found, fine)
        )
        off = np.sqrt(((one - other) ** 2).mean(axis=1) / (other**2).mean(axis=1))
        # measured up to 0.9 of what is stated, the finer solution's own error included
        assert (off <= 1.5 * found.error + 1e-4).all()


def test_bounces_over_the_picture_are_the_monte_carlo():
    m = Medium(sigma_t_per_mm=0.35, sigma_s_per_mm=0.2, g=0.4)
    slab = Slab(depth_mm=12.0, height_mm=3.0, surface_index=1.33)
    tank, beam = Tank(depth_mm=12.0, width_mm=24.0), Beam(from_mm=8.0, to_mm=16.0)
    grid = Grid.covering(tank, cell_mm=1.0, n_theta=16)
    found = slab_bounces(m, slab, beam, grid, n_bounces=4, fineness=0.6)
    for scored, mine in (("camera", found.seen.fluence), ("fluence", found.fluence)):
        sample = simulate_slab(
            m,
            slab,
            n_bounces=4,
            n_paths=40_000,
            cell_mm=1.0,
            seed=2,
            width_mm=24.0,
            beam=beam,
            scored=scored,
            n_threads=1,
        )
        # sums over the rows, between the nodes, behind the face's steep rise
        rows = mine.sum(axis=1)
        between = 0.5 * (rows[:, 1:] + rows[:, :-1])[1:, 2:9]
        noise = np.sqrt((sample.std_error**2).sum(axis=1))[:, 2:9]
        pull = (sample.light.sum(axis=1)[:, 2:9] - between) / np.hypot(noise, 0.01 * between)
        # measured rms 0.6 and 0.7
        assert np.sqrt(np.mean(pull**2)) < 1.6
