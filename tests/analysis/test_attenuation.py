"""Depth profiles and the fit of Eq. 9 on light whose decay is known."""

import numpy as np
import pytest

from analysis.attenuation import fit_attenuation
from analysis.errors import AnalysisError
from analysis.medium import Beam
from analysis.profile import DepthProfile, depth_profile, measure_beam


def profile_of(value: np.ndarray, std: float, depth: np.ndarray) -> DepthProfile:
    return DepthProfile(
        depth_mm=depth,
        value=value,
        std=np.full(depth.size, std),
        n_rows=np.full(depth.size, 100),
        detected_share=np.ones(depth.size),
        rows=np.full((4, depth.size), np.nan, dtype=np.float32),
    )


@pytest.mark.parametrize("sigma_t", [0.02, 0.2051, 1.0])
def test_an_exponential_is_found_exactly(sigma_t):
    depth = (np.arange(400) + 0.5) * 0.1
    found = fit_attenuation(profile_of(500.0 * np.exp(-sigma_t * depth), 0.01, depth))
    # measured worst 3e-16
    assert found.sigma_t_per_mm == pytest.approx(sigma_t, rel=1e-10)
    assert found.scale_c == pytest.approx(500.0, rel=1e-10)


def test_stated_deviations_are_those_of_repetition():
    rng = np.random.default_rng(3)
    depth = (np.arange(300) + 0.5) * 0.1
    truth = 100.0 * np.exp(-0.2 * depth)
    fits = [
        fit_attenuation(profile_of(truth + rng.normal(0, 0.5, depth.size), 0.5, depth), (0.0, 20.0))
        for _ in range(200)
    ]
    pull = [(f.sigma_t_per_mm - 0.2) / np.sqrt(f.covariance[1, 1]) for f in fits]
    # measured mean -0.11, deviation 0.97; 200 repetitions know them to 0.07 and 5 %
    assert np.std(pull) == pytest.approx(1.0, abs=0.2)
    assert abs(np.mean(pull)) < 0.25
    assert np.mean([f.chi2_per_dof for f in fits]) == pytest.approx(1.0, abs=0.05)


def test_the_fit_ends_where_the_signal_does():
    depth = (np.arange(1000) + 0.5) * 0.1
    found = fit_attenuation(profile_of(100.0 * np.exp(-0.2 * depth), 1e-6, depth))
    # one percent of the first value is reached at ln(100) / 0.2 = 23.0 mm
    assert found.depth_range_mm[1] == pytest.approx(23.0, abs=0.2)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.zeros_like, "no signal"),
        (lambda d: np.exp(0.1 * d), "does not decay"),
        (lambda d: np.exp(-50.0 * d), "depths are left"),
    ],
)
def test_light_that_is_no_decay_is_refused(value, said):
    depth = (np.arange(100) + 0.5) * 0.1
    with pytest.raises(AnalysisError, match=said):
        fit_attenuation(profile_of(value(depth), 1e-4, depth))


@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
def test_a_slanted_beam_is_followed(angle_deg):
    y, x = (np.arange(200) + 0.5)[:, None] * 0.1, (np.arange(100) + 0.5)[None, :] * 0.1
    slope = np.tan(np.radians(angle_deg))
    path = x / np.cos(np.radians(angle_deg))
    lit = (y - x * slope > 4.0) & (y - x * slope < 10.0)
    picture = np.where(lit, np.exp(-0.3 * path), 0.0)
    beam = Beam(from_mm=4.0, to_mm=10.0, angle_deg=angle_deg)
    found = fit_attenuation(
        depth_profile(picture, np.full_like(picture, 1e-6), 0.1, beam, margin_mm=0.5)
    )
    # measured worst 2e-16
    assert found.sigma_t_per_mm == pytest.approx(0.3, rel=1e-9)


def test_unknown_variance_is_taken_from_the_scatter_of_rows():
    rng = np.random.default_rng(1)
    picture = 10.0 + rng.normal(0.0, 2.0, (400, 50))
    found = depth_profile(
        picture, np.full_like(picture, np.nan), 0.1, Beam(from_mm=0.0, to_mm=40.0), margin_mm=0.0
    )
    # 2 / sqrt(400) = 0.1; measured 0.093 .. 0.107
    np.testing.assert_allclose(found.std, 0.1, rtol=0.15)


def test_the_beam_is_measured_at_the_face():
    white = np.zeros((300, 200))
    white[100:201] = np.exp(-0.01 * np.arange(200))
    beam = measure_beam(white, 0.1)
    assert (beam.from_mm, beam.to_mm) == (10.0, 20.1)
    with pytest.raises(AnalysisError, match="dark at the entry face"):
        measure_beam(np.zeros((30, 20)), 0.1)


@pytest.mark.parametrize(("uneven", "ratio"), [(0.0, (0.7, 1.4)), (0.02, (2.0, 50.0))])
def test_the_scatter_of_rows_agrees_with_the_noise_where_nothing_else_differs(uneven, ratio):
    rng = np.random.default_rng(6)
    x = (np.arange(300) + 0.5) * 0.1
    rates = 0.2 * (1.0 + uneven * np.repeat(rng.standard_normal(40), 8))[:, None]
    picture = 100.0 * np.exp(-rates * x) + rng.normal(0.0, 0.5, (320, 300))
    beam = Beam(from_mm=0.0, to_mm=32.0)
    found = fit_attenuation(
        depth_profile(picture, np.full_like(picture, 0.25), 0.1, beam, margin_mm=0.0)
    )
    by_noise = float(np.sqrt(found.covariance[1, 1]))
    # measured 0.97 and 29; forty blocks of rows know it to 11 percent
    assert ratio[0] < found.row_std[1] / by_noise < ratio[1]


def test_light_that_first_rises_is_followed_to_its_end():
    """Sharply forward light of a layer is seen best some way in; that is no far wall's glare."""
    depth = np.arange(0.05, 30.0, 0.1)
    value = np.exp(-0.3 * depth) * (1.0 - 0.5 * np.exp(-depth))
    found = fit_attenuation(profile_of(value, 1e-4, depth))
    assert np.argmax(value) > 5
    assert found.depth_range_mm[1] > 10.0
    # the rise is in the fit: measured 22 % low; taken for glare, nothing decayed
    assert 0.2 < found.sigma_t_per_mm < 0.3
