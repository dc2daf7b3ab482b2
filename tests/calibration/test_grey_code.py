"""Grey codes decoded and the contrast of their stripes: synthetic, and on real paper."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from analysis.separation import separate_extrema, separate_known
from analysis.separation_quality import closure
from calibration.contrast import fit_contrast, fit_transfer, measure_transfer
from calibration.errors import CalibrationError
from calibration.grey_code import decode_grey
from calibration.projector import stripe_light
from calibration.response import power_of_pairs

N_PX, COLS, ROWS = 256, 300, 80


def synthetic(blur_px=0.8, noise_dn=1.0):
    """Pictures of a Grey code on a slanted white card, with the true position of each pixel."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    true = 20.0 + 0.7 * x + 0.05 * y
    fine = (np.arange(N_PX * 32) + 0.5) / 32
    grey = fine.astype(int) ^ (fine.astype(int) >> 1)

    def shown(line):
        light = gaussian_filter1d(line.astype(float), 32 * blur_px, mode="nearest")
        seen = 10.0 + 180.0 * np.interp(true, fine, light)
        return np.rint(seen + rng.normal(0.0, noise_dn, seen.shape)).astype(np.uint16)

    bits = [(grey >> b) & 1 for b in reversed(range(8))]
    plain, inverse = [shown(b) for b in bits], [shown(1 - b) for b in bits]
    flat = np.ones_like(fine)
    return plain, inverse, shown(flat), shown(0 * flat), true


def test_positions_between_projector_pixels_are_found():
    plain, inverse, white, black, true = synthetic()
    found = decode_grey(plain, inverse, white, black, axis="x", n_px=N_PX)
    off = (found.position_px - true)[found.valid]
    assert found.valid.mean() > 0.9  # measured 1.0
    # measured rms 0.019 and worst 0.07 projector px
    assert np.sqrt(np.mean(off**2)) < 0.04
    assert np.abs(off).max() < 0.2


def test_dark_corners_are_masked_and_nothing_is_invented():
    plain, inverse, white, black, _ = synthetic()
    for picture in (*plain, *inverse, white):
        picture[:30, :60] = black[:30, :60]
    found = decode_grey(plain, inverse, white, black, axis="x", n_px=N_PX)
    assert not found.valid[:30, :60].any()
    assert np.isnan(found.position_px[:20, :50]).all()


def test_bad_codes_are_refused_in_one_line():
    plain, inverse, white, black, _ = synthetic()
    for arguments, said in (
        ((plain[1:], inverse[1:], white, black), "need 8 of each"),
        ((plain, inverse, black, white), "nowhere brighter"),
    ):
        with pytest.raises(CalibrationError, match=said) as caught:
            decode_grey(*arguments, axis="x", n_px=N_PX)
        assert "\n" not in str(caught.value)


def test_contrast_of_a_gaussian_blur_is_recovered():
    plain, inverse, white, black, true = synthetic(blur_px=0.8, noise_dn=0.0)
    contrast = (white.astype(float) - black).ravel()
    measured = {}
    for bit in range(4):
        period = 4 * 2**bit
        difference = (plain[7 - bit].astype(float) - inverse[7 - bit]).ravel()
        measured[period] = measure_transfer(
            difference, contrast, true.ravel(), period_px=period, offset_px=period / 4
        )
        exact = np.exp(-2.0 * (np.pi * 0.8 / period) ** 2)
        # measured worst 0.006: periods that are cut at the picture's edge
        assert measured[period] == pytest.approx(exact, abs=0.02)
    found = fit_transfer({p: m for p, m in measured.items() if p >= 8})
    # extrapolated to half of the finest period; measured 1.0 %
    assert found.at(4.0) == pytest.approx(np.exp(-2.0 * (np.pi * 0.2) ** 2), rel=0.05)


@pytest.mark.parametrize(
    ("measured", "said"),
    [({4.0: 0.5, 8.0: 0.7}, "3 or more"), ({4.0: 0.9, 8.0: 0.7, 16.0: 0.5}, "more contrast")],
)
def test_contrasts_that_cannot_be_are_refused(measured, said):
    with pytest.raises(CalibrationError, match=said):
        fit_transfer(measured)


def test_contrast_against_depth_is_a_parabola_in_its_logarithm():
    depth = np.linspace(0.5, 99.5, 100)
    true = 0.6 * np.exp(-(((depth - 40.0) / 60.0) ** 2))
    rng = np.random.default_rng(4)
    white = np.full((60, 100), 1000.0)
    amplitude = white * true + rng.normal(0.0, 5.0, white.shape)
    found = fit_contrast(amplitude, white, depth, unit="mm", period_px=12.0)
    # measured worst 0.07 %
    np.testing.assert_allclose(found.at(depth), true, rtol=0.01)
    with pytest.raises(CalibrationError, match="over the whole depth"):
        found.at(np.array([150.0]))
    with pytest.raises(CalibrationError, match="columns of the white target"):
        fit_contrast(amplitude[:, :5], white[:, :5], depth[:5], unit="mm", period_px=12.0)


def bright_paper(pictures):
    white, black = pictures[40].astype(float), pictures[41].astype(float)
    contrast = white - black
    return white, black, (white < 242) & (contrast > 0.2 * np.percentile(contrast, 99.0))


def test_closure_of_real_paper_is_its_additivity(stripes_on_paper):
    white, black, bright = (p[::2, ::2] for p in bright_paper(stripes_on_paper))
    means = {}
    for first in range(2, 40, 2):
        pair = np.stack([p[::2, ::2].astype(float) for p in stripes_on_paper[first : first + 2]])
        found = separate_extrema(pair, np.ones_like(pair), leak=black / white)
        nayar = (found.single + found.multiple) / white - 1.0
        net = separate_extrema(pair - black, np.ones_like(pair))
        subtracted = closure(net, white - black, black)
        additivity = pair.sum(axis=0) / (white + black) - 1.0
        # measured worst 4e-16: the estimator adds no error of its own
        np.testing.assert_allclose(nayar[bright], additivity[bright], atol=1e-3)
        np.testing.assert_allclose(subtracted[bright], additivity[bright], atol=1e-3)
        means[first] = float(additivity[bright].mean())
    # Periods of 8 px and more, along x and y: measured -0.95 % together. One by one they run from
    # +0.1 % (coarse) to -1.8 % (8 px): the camera's response, see the next test
    coarse = [mean for first, mean in means.items() if first not in (18, 38)]
    assert abs(np.mean(coarse)) <= 0.01
    assert max(map(abs, coarse)) < 0.02


def test_every_period_of_real_paper_closes_with_a_response_from_the_other_half(stripes_on_paper):
    pictures = [p[::2, ::2].astype(float) for p in stripes_on_paper]
    white, black, bright = bright_paper(pictures)
    half = np.arange(white.shape[1]) < white.shape[1] // 2
    coarse = [first for first in range(2, 38, 2) if first != 18]  # periods of 8 px and more
    here, there = bright & half, bright & ~half
    pairs = [(pictures[first][here], pictures[first + 1][here]) for first in coarse]
    table = power_of_pairs(pairs, white[here], black[here], bits=8).response(8, 0.0).table
    linear = [table[p[there].astype(int)] for p in pictures]
    whole = linear[40] + linear[41]
    means = [np.mean((linear[n] + linear[n + 1]) / whole - 1.0) for n in coarse]
    # counts = light^1.06; measured worst 0.62 % (the coarsest), without it -1.7 % (8 px)
    assert np.abs(means).max() <= 0.01
    as_it_is = [
        np.mean((pictures[n] + pictures[n + 1])[there] / (white + black)[there] - 1.0)
        for n in coarse
    ]
    assert np.abs(as_it_is).max() > 0.015


def test_direct_share_of_real_paper_with_contrast_from_coarser_stripes(stripes_on_paper):
    pictures = stripes_on_paper
    white, black, bright = bright_paper(pictures)
    found = decode_grey(
        pictures[0:20:2], pictures[1:20:2], pictures[40], pictures[41], axis="x", n_px=1024
    )
    # 0.29 is the rounding to whole pixels; measured 0.318
    assert found.residual_px < 0.35
    sure = found.valid & bright
    left = sure & (np.arange(1280) < 640)
    measured = {}
    for bit in range(1, 6):
        plain, inverse = (pictures[2 * (9 - bit) + k].astype(float)[left] for k in (0, 1))
        measured[4.0 * 2**bit] = measure_transfer(
            plain - inverse,
            (white - black)[left],
            found.position_px[left].astype(float),
            period_px=4 * 2**bit,
            offset_px=2**bit,
        )
    transfer = fit_transfer(measured)
    # the finest period is none of the fitted; measured 0.454 against 0.453 on the right half
    assert transfer.at(4.0) == pytest.approx(0.453, abs=0.02)
    net = np.stack([pictures[k].astype(float) - black for k in (18, 19)])
    pattern = stripe_light(
        found.position_px.astype(float) - 1.0,
        period_px=4.0,
        duty=0.5,
        n_shifts=2,
        transfer=transfer.at,
    )
    parts = separate_known(net, np.ones_like(net), pattern)
    right = sure & (np.arange(1280) >= 640)
    share = (parts.single / (parts.single + parts.multiple))[right]
    # measured 1.10; by extremes 0.41: the middle of the picture is sharper than its mean
    assert np.nanmedian(share) >= 0.9
    assert np.nanmedian(share) < 1.15
