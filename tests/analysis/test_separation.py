"""The separation's estimators on pictures whose direct and global light are known."""

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.separation import (
    as_if_white,
    separate_extrema,
    separate_harmonic,
    separate_known,
    square_contrast,
)
from analysis.separation_quality import closure, harmonic_ratio, stripe_residue
from calibration.projector import stripe_light

N = 6
PIXELS = 40_000


def pictures(direct_e: float, global_e: float, blur_px: float, seed: int = 1):
    """Noisy stripe pictures of a flat field at random phases, with pattern and true variance."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.0, 12.0, (1, PIXELS))
    pattern = stripe_light(
        position, period_px=12.0, duty=0.5, n_shifts=N, blur_px=blur_px, pixel_px=0.0
    )
    mean = direct_e * pattern + global_e * 0.5
    net = rng.poisson(mean) + rng.normal(0.0, 10.0, mean.shape)
    return net, mean + 100.0, pattern


@pytest.mark.parametrize("blur_px", [0.5, 2.0])
def test_known_pattern_is_unbiased_where_extremes_are_not(blur_px):
    net, variance, pattern = pictures(200.0, 2000.0, blur_px)
    known = separate_known(net, variance, pattern)
    # measured -0.07 % and +0.003 %, standard errors 0.08 % and 0.14 %
    assert known.single.mean() / 200.0 == pytest.approx(1.0, abs=0.005)
    assert known.multiple.mean() / 2000.0 == pytest.approx(1.0, abs=0.002)
    extrema = separate_extrema(net, variance)
    # measured +22 % (blur 0.5) and -16 % (blur 2.0): noise lifts, blur lowers
    assert abs(extrema.single.mean() / 200.0 - 1.0) > 0.1


def test_known_pattern_states_its_true_variance():
    net, variance, pattern = pictures(500.0, 2000.0, 1.0)
    known = separate_known(net, variance, pattern)
    pull = (known.single - 500.0) / np.sqrt(known.single_variance)
    # measured 1.001 and 1.002
    assert pull.std() == pytest.approx(1.0, abs=0.03)
    pull = (known.multiple - 2000.0) / np.sqrt(known.multiple_variance)
    assert pull.std() == pytest.approx(1.0, abs=0.03)


def test_extremes_are_the_papers_equations_without_noise():
    net, variance, _ = pictures(0.0, 0.0, 0.0)
    pattern = stripe_light(
        np.array([[3.0, 9.0]]), period_px=12.0, duty=0.5, n_shifts=N, blur_px=0.0, pixel_px=3.9
    )
    flat = 10.0 * np.round(pattern) + 0.5 * 4.0
    found = separate_extrema(flat, np.ones_like(flat))
    np.testing.assert_allclose(found.single, 10.0)
    np.testing.assert_allclose(found.multiple, 4.0)
    assert variance.shape == net.shape


def test_harmonic_finds_a_sinusoid_at_any_phase():
    phase = np.linspace(0.0, 2 * np.pi, 50)[None, :]
    k = np.arange(8).reshape(-1, 1, 1)
    net = 7.0 * (0.5 + 0.5 * np.cos(phase - 2 * np.pi * k / 8)) + 0.5 * 3.0
    found = separate_harmonic(net, np.full_like(net, np.nan), contrast=0.5, duty=0.5)
    # measured worst 9e-16
    np.testing.assert_allclose(found.single, 7.0, rtol=1e-12)
    np.testing.assert_allclose(found.multiple, 3.0, rtol=1e-12)
    assert found.detected.all()


def test_harmonic_removes_the_noise_floor():
    net, variance, _ = pictures(0.0, 2000.0, 0.5)
    found = separate_harmonic(net, variance, contrast=square_contrast(0.5), duty=0.5)
    # noise alone: measured 4.9 % above the limit of detection
    assert found.detected.mean() < 0.08
    extremes = separate_extrema(net, variance)
    # d2(6) = 2.53 standard deviations; measured 2.535
    assert extremes.single.mean() / np.sqrt(1100.0) == pytest.approx(2.53, abs=0.03)


def test_closure_of_a_perfect_separation_is_zero():
    net, variance, pattern = pictures(1e9, 3e9, 1.0)
    found = separate_known(net, variance, pattern)
    gap = closure(found, np.full(found.single.shape, 4e9))
    # measured worst 4e-5: the noise of 1e9 electrons
    assert np.abs(gap).max() < 1e-4


def test_stripes_between_two_levels_say_the_same_as_full_ones():
    pattern = stripe_light(
        np.linspace(0.0, 12.0, 40)[None],
        period_px=12.0,
        duty=0.5,
        n_shifts=N,
        blur_px=1.0,
        pixel_px=0,
    )
    low, high = 0.25, 0.8
    shown = low + (high - low) * pattern
    net = 70.0 * shown + 30.0 * (low + (high - low) * 0.5)
    found = separate_known(net, np.ones_like(net), pattern)
    white = as_if_white(found, low=low, high=high, duty=0.5)
    # measured worst 2.4e-15
    np.testing.assert_allclose(white.single, 70.0, rtol=1e-11)
    np.testing.assert_allclose(white.multiple, 30.0, rtol=1e-11)
    assert (white.single_variance > found.single_variance).all()
    with pytest.raises(AnalysisError, match="0 <= low < high"):
        as_if_white(found, low=0.8, high=0.8, duty=0.5)


def test_saturated_shifts_leave_a_hole_and_not_a_value():
    net, variance, pattern = pictures(500.0, 2000.0, 1.0)
    net[2, 0, :10] = np.nan
    for found in (
        separate_known(net, variance, pattern),
        separate_extrema(net, variance),
        separate_harmonic(net, variance, contrast=0.6, duty=0.5),
    ):
        assert np.isnan(found.single[0, :10]).all()
        assert np.isfinite(found.single[0, 10:]).all()
        assert not found.detected[0, :10].any()


def test_bad_stacks_are_refused_in_one_line():
    with pytest.raises(AnalysisError, match="at least 4"):
        separate_harmonic(np.ones((3, 2, 2)), np.ones((3, 2, 2)), contrast=0.6, duty=0.5)
    with pytest.raises(AnalysisError, match="a stack"):
        separate_extrema(np.ones((1, 2, 2)), np.ones((1, 2, 2)))
    with pytest.raises(AnalysisError, match="does not change"):
        separate_known(np.ones((4, 2, 2)), np.ones((4, 2, 2)), np.ones((4, 2, 1)))


def test_leak_of_black_is_nayars_with_b():
    leak = np.array([[0.0, 0.05, 0.2]])
    pattern = leak + (1.0 - leak) * np.array([1.0, 1.0, 0.0, 0.0]).reshape(4, 1, 1)
    net = 30.0 * pattern + 50.0 * (1.0 + leak) / 2.0
    found = separate_extrema(net, np.ones_like(net), leak=leak)
    # measured worst 4e-16
    np.testing.assert_allclose(found.single, 30.0, rtol=1e-12)
    np.testing.assert_allclose(found.multiple, 50.0, rtol=1e-12)
    # max of variance one: D carries 2/(1 - b)^2
    np.testing.assert_allclose(found.single_variance, 2.0 / (1.0 - leak) ** 2)
    with pytest.raises(AnalysisError, match="darker than white"):
        separate_extrema(net, np.ones_like(net), leak=1.0)


def test_chi2_of_a_right_pattern_is_one_and_of_a_wrong_one_is_not():
    net, variance, pattern = pictures(500.0, 2000.0, 1.0)
    right = separate_known(net, variance, pattern)
    assert (right.single / np.sqrt(right.single_variance)).mean() > 5.0
    # per pixel 4 degrees of freedom; measured mean 0.999
    assert right.chi2.mean() == pytest.approx(1.0, abs=0.1)
    wrong = separate_known(net, variance, np.roll(pattern, 1, axis=0))
    assert wrong.chi2.mean() > 5.0  # measured 34


def test_direct_light_a_tenth_of_global_is_unbiased_and_its_chi2_is_one_pixel_by_pixel():
    # D = G/10 and six shifts, bright enough for an SNR above 5; 1500 captures of 400 pixels
    direct_e, global_e, n_captures = 2000.0, 20_000.0, 1500
    rng = np.random.default_rng(6)
    position = rng.uniform(0.0, 12.0, (1, 400))
    kind = {"period_px": 12.0, "duty": 0.5, "n_shifts": N, "blur_px": 0.5, "pixel_px": 0.0}
    pattern = stripe_light(position, **kind)
    mean = direct_e * pattern + 0.5 * global_e
    every = np.broadcast_to(mean, (n_captures, *mean.shape)).transpose(1, 0, 2, 3)
    net = (rng.poisson(every) + rng.normal(0.0, 10.0, every.shape)).reshape(N, n_captures, 400)
    # variances and pictures as the pipeline has them, in single precision
    stack, variance = (a.astype(np.float32) for a in (net, np.repeat(mean + 100.0, n_captures, 1)))
    known_pattern = np.repeat(pattern, n_captures, axis=1)
    found = separate_known(stack, variance, known_pattern)
    # measured 19.0 at least
    assert (direct_e / np.sqrt(found.single_variance)).min() > 5.0
    # measured bias +0.010 % (known pattern) and +0.43 % (harmonic); six extremes +5.9 %
    assert found.single.mean() / direct_e == pytest.approx(1.0, abs=0.01)
    c1 = square_contrast(0.5) * np.exp(-2.0 * (np.pi * 0.5 / 12.0) ** 2)
    harmonic = separate_harmonic(stack, variance, contrast=c1, duty=0.5)
    assert harmonic.single.mean() / direct_e == pytest.approx(1.0, abs=0.01)
    # of every pixel, over its captures: standard error 1.8 %; measured 0.940 to 1.050
    chi2 = found.chi2.mean(axis=0)
    assert np.abs(chi2 - 1.0).max() < 0.1
    pull2 = ((found.single - direct_e) ** 2 / found.single_variance).mean(axis=0)
    # the answer's own: standard error 3.7 %; measured 0.869 to 1.118
    assert np.abs(pull2 - 1.0).max() < 0.15


def test_single_precision_changes_nothing_that_noise_would_not_hide():
    # a thousandth of the light is direct: where sums of large numbers would lose it
    double = pictures(200.0, 200_000.0, 1.0)
    single = tuple(a.astype(np.float32) for a in double)
    for separate in (
        separate_known,
        lambda net, variance, _: separate_harmonic(net, variance, contrast=0.6, duty=0.5),
        lambda net, variance, _: separate_extrema(net, variance),
    ):
        wanted, found = separate(*double), separate(*single)
        assert found.single.dtype == found.multiple_variance.dtype == np.float32
        for name in ("single", "multiple"):
            spread = getattr(wanted, f"{name}_variance")
            off = getattr(found, name) - getattr(wanted, name)
            # measured worst 8e-4 standard deviations (harmonic), variances 2.4e-6 (known pattern)
            assert np.abs(off / np.sqrt(spread)).max() < 0.005
            np.testing.assert_allclose(getattr(found, f"{name}_variance"), spread, rtol=2e-5)
        if found.method != "extrema":
            np.testing.assert_allclose(found.chi2, wanted.chi2, atol=5e-4)  # measured 5.3e-5


def test_blur_at_period_six_is_corrected_with_c1_known():
    rng = np.random.default_rng(3)
    position = rng.uniform(0.0, 6.0, (1, PIXELS))
    kind = {"period_px": 6.0, "duty": 0.5, "n_shifts": N, "blur_px": 1.0, "pixel_px": 0.0}
    pattern = stripe_light(position, **kind)
    mean = 2000.0 * pattern + 4000.0 * 0.5
    net = rng.poisson(mean) + rng.normal(0.0, 10.0, mean.shape)
    c1 = square_contrast(0.5) * np.exp(-2.0 * (np.pi / 6.0) ** 2)
    found = separate_harmonic(net, mean + 100.0, contrast=c1, duty=0.5)
    # measured -0.11 % and +0.06 %; with the c1 of sharp stripes -42 %
    assert found.single.mean() == pytest.approx(2000.0, rel=0.01)
    assert found.multiple.mean() == pytest.approx(4000.0, rel=0.01)


def test_contrast_may_differ_from_column_to_column():
    k = np.arange(6).reshape(-1, 1, 1)
    c1 = np.array([0.3, 0.5, 0.6])
    net = 7.0 * (0.5 + c1 * np.cos(1.0 - 2 * np.pi * k / 6)) + 0.5 * 3.0 + np.zeros((6, 2, 3))
    found = separate_harmonic(net, np.full_like(net, np.nan), contrast=c1, duty=0.5)
    # measured worst 9e-16
    np.testing.assert_allclose(found.single, 7.0, rtol=1e-12)
    with pytest.raises(AnalysisError, match="not positive"):
        separate_harmonic(net, net, contrast=0.0, duty=0.5)


def test_gamma_shows_in_the_second_harmonic():
    phase = np.linspace(0.0, 2 * np.pi, 30)[None, :]
    k = np.arange(6).reshape(-1, 1, 1)
    turn = phase - 2 * np.pi * k / 6
    net = 5.0 + np.cos(turn) + 0.14 * np.cos(2 * turn)
    # measured worst 1e-15
    np.testing.assert_allclose(harmonic_ratio(net), 0.14, rtol=1e-9)
    with pytest.raises(AnalysisError, match="5 are needed"):
        harmonic_ratio(net[:4])


def test_stripes_left_in_direct_light_show_and_slow_changes_do_not():
    x = np.arange(200)
    smooth = np.broadcast_to(np.exp(-x / 80.0), (60, 200))
    assert stripe_residue(smooth) < 0.015  # measured 0.008, all of it at the edges
    striped = smooth + 0.1 * np.sin(2 * np.pi * x / 6.0)
    # 0.1/sqrt(2), and what little the window leaves of it; measured 0.0686
    assert stripe_residue(striped) == pytest.approx(0.0707, rel=0.05)
    assert np.isnan(stripe_residue(np.full((5, 5), np.nan)))


def test_negative_global_light_is_not_clipped():
    net = 10.0 * np.array([1.0, 1.0, 0.0, 0.0]).reshape(4, 1, 1) - 2.0 + np.zeros((4, 3, 3))
    pattern = np.array([1.0, 1.0, 0.0, 0.0]).reshape(4, 1, 1) + np.zeros((4, 3, 3))
    for found in (
        separate_known(net, np.ones_like(net), pattern),
        separate_extrema(net, np.ones_like(net)),
    ):
        np.testing.assert_allclose(found.multiple, -4.0)
