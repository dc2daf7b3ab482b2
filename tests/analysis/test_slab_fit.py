"""The medium of a slab found again from stripes and white light."""

import math

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.medium import Medium, Slab
from analysis.slab_fit import fit_slab
from analysis.slab_profiles import SlabProfiles, summed
from analysis.slab_table import SlabTable
from analysis.transport.montecarlo_slab import simulate_slab
from analysis.transport.slab_resolution import depths

STRIPES = 2.0 * math.pi / 1.8
SLAB = Slab(depth_mm=24.0, height_mm=5.0, surface_index=1.33)
TRUTH = np.array([0.2051, 0.10255, 0.4])


@pytest.fixture(scope="module")
def light() -> SlabProfiles:
    """A slab's light by the 3-D Monte Carlo, with its own noise and that of a camera."""
    rng = np.random.default_rng(8)
    m = Medium(sigma_t_per_mm=TRUTH[0], sigma_s_per_mm=TRUTH[1], g=TRUTH[2])
    seen = simulate_slab(
        m,
        SLAB,
        n_bounces=14,
        n_paths=400_000,
        cell_mm=0.5,
        seed=3,
        wavenumber_per_mm=STRIPES,
        harmonics=(1,),
        n_threads=1,
    )
    half = 0.5 * TRUTH[0] * 0.5
    single = np.exp(-TRUTH[0] * seen.x_mm) * math.sinh(half) / half
    noise = (seen.modulated_std_error[0, :, 0] ** 2).sum(axis=0)
    white = single + seen.light[:, 0].sum(axis=0)
    camera = 9e-6 * white
    striped = single + seen.modulated[0, :, 0].real.sum(axis=0)
    striped = 3.0 * striped + rng.normal(size=white.size) * np.sqrt(camera)
    return SlabProfiles(
        depth_mm=seen.x_mm,
        bin_mm=0.5,
        wavenumbers_per_mm=np.array([STRIPES]),
        harmonics=striped[None],
        variance=(9.0 * noise + camera)[None],
        white=3.0 * white + rng.normal(size=white.size) * np.sqrt(camera),
        white_variance=9.0 * (seen.std_error[:, 0] ** 2).sum(axis=0) + camera,
    )


@pytest.fixture(scope="module")
def table() -> SlabTable:
    return SlabTable.build(
        SLAB,
        np.array([STRIPES, 0.0]),
        depths(TRUTH[0], SLAB, fineness=1.0),
        sigma_t_per_mm=(0.17, 0.25),
        g=(0.2, 0.6),
        n_nodes=(4, 4),
        fineness=1.0,
    )


def test_a_medium_is_found_again_without_a_table(light):
    found = fit_slab(light, SLAB, unknown_walls=True)
    std = np.sqrt(np.diag(found.covariance))
    values = np.array([found.sigma_t_per_mm, found.sigma_s_per_mm, found.g])
    # measured pulls -0.9, 0.7, -0.5
    assert np.abs((values - TRUTH) / std).max() < 3.0
    assert std[0] < 0.005 * TRUTH[0]
    assert not found.at_limit
    assert 0.5 < found.chi2_per_dof < 1.6
    np.testing.assert_allclose(found.scales, 3.0, rtol=0.01)
    # 5 % of height is 1.9 % of sigma_s (design), and next to nothing of sigma_t
    assert 0.25 * abs(found.by_height[1]) / TRUTH[1] == pytest.approx(0.019, abs=0.006)
    assert (0.25 * found.by_height[1]) ** 2 > 0.5 * found.covariance[1, 1]


def test_a_table_gives_the_same_answer(light, table):
    direct, looked_up = fit_slab(light, SLAB), fit_slab(light, SLAB, table=table)
    assert looked_up.n_solved == 0
    std = np.sqrt(np.diag(direct.covariance))
    off = np.array(
        [
            direct.sigma_t_per_mm - looked_up.sigma_t_per_mm,
            direct.sigma_s_per_mm - looked_up.sigma_s_per_mm,
            direct.g - looked_up.g,
        ]
    )
    # measured worst 0.4 standard deviations
    assert np.abs(off / std).max() < 1.0


def test_a_table_is_kept_with_its_error(table, tmp_path):
    checked = table.checked(n=2, seed=1)
    # measured 0.011, in faint light; finer tables state less
    assert 0.0 < checked.error < 0.02
    checked.save(tmp_path / "table.npz")
    again = SlabTable.load(tmp_path / "table.npz")
    assert again.error == checked.error
    assert again.slab == table.slab
    for kept, read in zip(table.coefficients, again.coefficients, strict=True):
        np.testing.assert_array_equal(kept, read)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_pulls_are_those_of_the_noise(light, table, correlation):
    """Realisations of noise about one model: their spread is the one that is stated.

    So it is where stripes and white light share much of it, as they do in the same frames.
    """
    at_truth = fit_slab(light, SLAB, table=table)
    rng = np.random.default_rng(7)
    variance = np.array([light.variance[0], light.white_variance])
    found = []
    for _ in range(120):
        draws = rng.normal(size=variance.shape)
        draws[0] = correlation * draws[1] + math.sqrt(1.0 - correlation**2) * draws[0]
        noisy = at_truth.model + draws * np.sqrt(variance)
        one = fit_slab(
            SlabProfiles(
                depth_mm=light.depth_mm,
                bin_mm=0.5,
                wavenumbers_per_mm=light.wavenumbers_per_mm,
                harmonics=noisy[:1],
                variance=light.variance,
                white=noisy[1],
                white_variance=light.white_variance,
                shared=correlation * np.sqrt(light.variance * light.white_variance),
            ),
            SLAB,
            table=table,
        )
        std = np.sqrt(np.diag(one.covariance))
        found.append(
            [
                (one.sigma_t_per_mm - at_truth.sigma_t_per_mm) / std[0],
                (one.sigma_s_per_mm - at_truth.sigma_s_per_mm) / std[1],
                (one.g - at_truth.g) / std[2],
            ]
        )
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    # measured 1.03, 1.06, 1.04, and 1.00, 1.06, 1.07 with correlation; 120 draws know a spread
    # to 6.5 %, thirty only to 13 %
    assert (rms > 0.8).all()
    assert (rms < 1.25).all()


def test_orders_beyond_the_last_go_on_with_their_ratio():
    orders = (0.6 ** np.arange(6))[:, None] * np.ones(3)
    np.testing.assert_allclose(summed(orders, 0.9), 1.0 / (1.0 - 0.54))


def test_unfit_profiles_are_refused_in_one_line(light, table):
    def with_harmonics(values):
        return SlabProfiles(
            depth_mm=light.depth_mm,
            bin_mm=0.5,
            wavenumbers_per_mm=light.wavenumbers_per_mm,
            harmonics=values,
            variance=light.variance,
            white=None,
            white_variance=None,
        )

    with pytest.raises(AnalysisError, match="fewer than"):
        fit_slab(with_harmonics(np.full_like(light.harmonics, np.nan)), SLAB)
    with pytest.raises(AnalysisError, match="does not fall"):
        fit_slab(with_harmonics(light.harmonics[:, ::-1]), SLAB)
    with pytest.raises(AnalysisError, match="differ in shape"):
        fit_slab(with_harmonics(light.harmonics[:, 1:]), SLAB)
    with pytest.raises(AnalysisError, match="wave numbers"):
        fit_slab(with_harmonics(light.harmonics), SLAB, table=table)
    with pytest.raises(AnalysisError, match="another"):
        fit_slab(light, Slab(depth_mm=24.0, height_mm=4.0, surface_index=1.33), table=table)
