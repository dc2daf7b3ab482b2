"""Responses: by name, checked for linearity, and fitted where a camera is not linear."""

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.hdr import merge
from calibration.model import CameraModel
from calibration.response import (
    LINEAR,
    Ramp,
    fit_response,
    linearity_of,
    power_of_pairs,
    sample_ramp,
    srgb_response,
    table_response,
)

EXPOSURES = np.array([0.01, 0.02, 0.04, 0.08, 0.16, 0.32])


def scene():
    y, x = np.mgrid[:120, :160]
    return 60.0 * np.exp(-x / 40.0) * (1.0 + 0.2 * np.sin(y / 9.0))


def encoded(light):
    share = np.clip(light, 0.0, 1.0)
    high = 1.055 * np.maximum(share, 1e-9) ** (1 / 2.4) - 0.055
    return 255.0 * np.where(share <= 0.0031308, 12.92 * share, high)


def pictures(*, linear):
    rng = np.random.default_rng(6)
    taken = []
    for t in EXPOSURES:
        light = scene() * t
        counts = 255.0 * np.clip(light, 0, 1) if linear else encoded(light)
        noisy = counts + rng.normal(0.0, 0.7, counts.shape)
        taken.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint16))
    return taken


def ramp(taken):
    return Ramp(
        counts=sample_ramp(taken),
        exposures_s=EXPOSURES,
        bits=8,
        black_level_dn=0.0,
        white_level_dn=255.0,
    )


def test_a_linear_camera_is_seen_to_be_linear_and_is_given_no_response():
    straight = ramp(pictures(linear=True))
    assert linearity_of(straight) < 0.01  # measured 0.0004
    with pytest.raises(CalibrationError, match="no response is fitted where linearity holds"):
        fit_response(straight)


def test_response_of_an_srgb_camera_is_fitted_from_its_ramp():
    bent = ramp(pictures(linear=False))
    assert linearity_of(bent) > 0.2  # measured 0.57
    found, true = fit_response(bent).table, srgb_response(8).table
    assert (np.diff(found) >= 0.0).all()
    known = slice(20, 240)
    ratio = found[known] / true[known]
    # measured 1.6 % rms about its mean: scale is the one thing a ramp does not tell
    assert (ratio / ratio.mean()).std() < 0.04


def test_merge_undoes_a_response_by_name():
    taken = pictures(linear=False)
    camera = CameraModel(bits=8, black_level_dn=0, white_level_dn=255, response=srgb_response(8))
    found = merge(taken, list(EXPOSURES), [0.0] * 6, camera)
    bright = scene() > 1.0
    ratio = found.value[bright] / (255.0 * scene()[bright])
    # measured mean -0.01 % and std 0.6 %
    assert ratio.mean() == pytest.approx(1.0, abs=0.005)
    assert ratio.std() < 0.03
    assert np.isnan(found.variance).all()


def test_srgb_ends_where_it_should():
    table = srgb_response(8).table
    assert table[0] == 0.0
    assert table[255] == pytest.approx(255.0)
    # IEC 61966-2-1 at the join, and the well-known 0.2140 at one half
    assert table[128] / 255.0 == pytest.approx(0.21586, abs=1e-5)
    assert LINEAR.linear(8)[200] == 200.0


@pytest.mark.parametrize(
    ("table", "said"),
    [([0.0, 1.0, 0.5], "does not rise"), ([0.0, np.nan], "finite"), ([1.0, 1.0], "does not rise")],
)
def test_tables_that_are_no_response_are_refused(table, said):
    with pytest.raises(CalibrationError, match=said):
        table_response("mine", table)


def test_bad_ramps_are_refused_in_one_line():
    taken = pictures(linear=False)
    with pytest.raises(CalibrationError, match="3 or more of unchanged"):
        Ramp(
            counts=sample_ramp(taken),
            exposures_s=np.full(6, 0.1),
            bits=8,
            black_level_dn=0.0,
            white_level_dn=255.0,
        )
    with pytest.raises(CalibrationError, match="more than 7 bits"):
        Ramp(
            counts=sample_ramp(taken),
            exposures_s=EXPOSURES,
            bits=7,
            black_level_dn=0.0,
            white_level_dn=127.0,
        )
    black = Ramp(
        counts=np.zeros((6, 50), np.uint16),
        exposures_s=EXPOSURES,
        bits=8,
        black_level_dn=0.0,
        white_level_dn=255.0,
    )
    with pytest.raises(CalibrationError, match="unclipped at two exposures"):
        fit_response(black)
    with pytest.raises(CalibrationError, match="table of 256"):
        srgb_response(8).linear(12)


def test_a_pattern_and_its_inverse_tell_the_power_of_a_camera():
    rng = np.random.default_rng(8)
    white, black = rng.uniform(0.5, 0.9, 500), np.full(500, 0.03)
    pairs = []
    for _ in range(4):
        share = rng.uniform(0.0, 1.0, 500)
        lit = black + share * (white - black)
        pairs.append((255.0 * lit**1.1, 255.0 * (white + black - lit) ** 1.1))
    found = power_of_pairs(pairs, 255.0 * white**1.1, 255.0 * black**1.1, bits=8)
    # measured 1.1000000
    assert found.power == pytest.approx(1.1, abs=1e-5)
    # measured 9e-8; half the light gives 6.7 % fewer counts than half
    assert np.abs(found.closures(pairs, 255.0 * white**1.1, 255.0 * black**1.1)).max() < 1e-6
    assert found.at_half == pytest.approx(0.5**1.1 / 0.5 - 1.0, abs=1e-6)
    with_black = found.response(8, black_level_dn=16.0)
    assert with_black.name == "power 1.100"
    # the table keeps white and black, and noise below black stays below it
    np.testing.assert_allclose(with_black.table[[16, 255]], [16.0, 255.0], atol=1e-9)
    assert with_black.table[8] < 16.0
    with pytest.raises(CalibrationError, match="8 bits or fewer"):
        power_of_pairs(pairs, white, black, bits=12)
    with pytest.raises(CalibrationError, match="under no power"):
        power_of_pairs([(white, white)], white, black, bits=8)
