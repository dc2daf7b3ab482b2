"""Brackets of a real CCD merged, against the mean of twenty frames."""

import numpy as np
import pytest

from calibration.hdr import merge
from calibration.model import CameraModel

BRACKETS = [(0.32, 1.18, 4.6, 13.72), (0.32, 0.9, 2.32, 6.32), (0.04, 0.32, 0.62, 1.18)]
CAMERA = CameraModel(
    bits=12,
    black_level_dn=0.0,
    white_level_dn=4095.0,
    gain_dn_per_e=0.2816,
    read_noise_e=10.87,
    shutter_offset_s=2.57e-6,
)


@pytest.fixture(scope="module")
def truth(ccd):
    bright, dark = (np.stack(ccd.read(kind, 5.16, 20)).astype(float) for kind in "bd")
    seconds = 5.16e-3 + CAMERA.shutter_offset_s
    value = (bright.mean(axis=0) - dark.mean(axis=0)) / seconds
    variance = (bright.var(axis=0, ddof=1) + dark.var(axis=0, ddof=1)) / 20 / seconds**2
    return value, variance, dark.mean()


@pytest.mark.parametrize("bracket_ms", BRACKETS)
def test_real_brackets_reach_the_bound_of_cramer_and_rao(ccd, truth, bracket_ms):
    value, variance, dark = truth
    exposures = [t * 1e-3 for t in bracket_ms]
    taken = [ccd.read("b", t)[0] for t in bracket_ms]
    found = merge(taken, exposures, [dark] * 4, CAMERA)
    seconds = np.array(exposures) + CAMERA.shutter_offset_s
    seen = np.stack([frame < CAMERA.saturation_dn for frame in taken])
    floor = CAMERA.floor_variance_dn2
    weights = [s * t**2 / (0.2816 * value * t + floor) for s, t in zip(seen, seconds, strict=True)]
    bound = np.sqrt(np.mean(1.0 / np.sum(weights, axis=0) / value**2))
    ratio = found.value / value
    rms = np.sqrt((ratio / ratio.mean()).var() - np.mean(variance / value**2))
    # measured 1.006, 1.002 and 1.005
    assert rms / bound <= 1.03
    stated = np.sqrt(np.mean(found.variance / value**2))
    # measured within 0.3 %
    assert stated == pytest.approx(bound, rel=0.01)


def test_a_real_frame_clipped_at_4095_does_not_pull(ccd, truth):
    _, _, dark = truth
    whole = [ccd.read("b", t)[0] for t in (0.32, 1.18, 4.6)]
    clipped = ccd.read("b", 13.72)[0]
    assert (clipped == 4095).all()
    exposures = [0.32e-3, 1.18e-3, 4.6e-3, 13.72e-3]
    without = merge(whole, exposures[:3], [dark] * 3, CAMERA)
    with_it = merge([*whole, clipped], exposures, [dark] * 4, CAMERA)
    # measured equal to the bit
    np.testing.assert_array_equal(with_it.value, without.value)
