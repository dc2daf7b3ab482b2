"""Gain and noise from pairs of frames: on a real CCD, and where the truth is known."""

import dataclasses

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.photon_transfer import Level, fit_photon_transfer, measure_level

BITS, WHITE = 12, 4095.0


def frames(rate, exposure_s, n=2, seed=1, gain=0.28, noise_e=10.0, offset=16.0, t0_s=0.0):
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(rate * (exposure_s + t0_s) / gain, (n, 200, 200))
    counts = offset + gain * (electrons + rng.normal(0.0, noise_e, electrons.shape))
    return np.clip(np.rint(counts), 0, WHITE).astype(np.uint16)


def level(taken, exposure_s):
    return measure_level(taken, exposure_s, bits=BITS, white_level_dn=WHITE)


def simulated(exposures, n=2, **camera):
    lights = [level(frames(1e5, t, n, seed=k, **camera), t) for k, t in enumerate(exposures)]
    darks = [level(frames(0.0, t, n, seed=99 + k, **camera), t) for k, t in enumerate(exposures)]
    return lights, darks


RAMP = (1e-4, 1e-3, 4e-3, 8e-3, 1.2e-2, 1.6e-2, 2.2e-2, 3e-2, 3.6e-2, 5e-2)


@pytest.fixture(scope="module")
def real(ccd):
    levels = {
        kind: [level(ccd.read(kind, t), t * 1e-3) for t in ccd.exposures_ms()] for kind in "bd"
    }
    return levels, fit_photon_transfer(levels["b"], levels["d"])


def test_real_ccd_has_the_gain_and_noise_of_the_reference_program(real):
    _, found = real
    # emva1288 1.0.2 on the same frames; measured -0.002 % and -0.03 %
    assert found.gain_dn_per_e == pytest.approx(0.28160, rel=5e-3)
    assert found.dark_noise_e == pytest.approx(10.87, rel=1e-2)
    assert abs(found.gain_dn_per_e - 0.28160) < found.gain_std


def test_clipped_exposures_of_the_real_ccd_are_left_out(real):
    _, found = real
    clipped = found.exposures_s > 1.1e-2
    assert clipped.sum() == 4
    assert not found.fitted[clipped].any()
    assert np.isnan(found.deviation[clipped]).all()
    # EMVA 1288 gives 13 931 by its quantum efficiency; the mean at the largest variance 13 817
    assert found.saturation_e == pytest.approx(13_931, rel=0.02)


def test_a_clipped_frame_among_the_fitted_ones_does_not_pull(real):
    levels, found = real
    bad = [
        dataclasses.replace(x, clipped_share=0.5, mean_dn=4095.0, variance_dn2=3e6) if k == 8 else x
        for k, x in enumerate(levels["b"])
    ]
    again = fit_photon_transfer(bad, levels["d"])
    # measured -0.003 %: one level of thirteen is missing
    assert again.gain_dn_per_e == pytest.approx(found.gain_dn_per_e, rel=1e-3)


def test_shutter_offset_of_the_real_ccd_is_found_and_marked(real):
    _, found = real
    # measured 2.6 us +- 0.2 us; without it the shortest exposure is 6 % off its line
    assert 1e-6 < found.shutter_offset_s < 5e-6
    assert found.marked_exposures_s == (4e-5,)
    # emva1288 states -0.62 and +0.48 % over all exposures; measured -0.66 and +0.44 %
    assert -0.01 < found.linearity[0] < 0.0 < found.linearity[1] < 0.01


def test_simulated_camera_is_recovered():
    found = fit_photon_transfer(*simulated(RAMP, n=6, t0_s=2e-5))
    # measured -0.07 %, +0.13 % and -0.05 %
    assert found.gain_dn_per_e == pytest.approx(0.28, rel=5e-3)
    assert found.dark_noise_e == pytest.approx(10.0, rel=2e-2)
    assert found.shutter_offset_s == pytest.approx(2e-5, rel=0.1)
    assert found.marked_exposures_s == (1e-4, 1e-3)


def test_fixed_pattern_is_told_from_noise():
    rng = np.random.default_rng(5)
    pattern = rng.normal(1.0, 0.02, (200, 200))
    lights, darks = [], []
    for k, t in enumerate(RAMP):
        lights.append(level(frames(1e5 * pattern, t, 4, seed=k), t))
        darks.append(level(frames(0.0, t, 4, seed=50 + k), t))
    found = fit_photon_transfer(lights, darks)
    # measured 0.02004: the temporal noise of a pixel there is 0.6 % after four frames
    assert found.prnu == pytest.approx(0.02, rel=0.05)
    assert found.dsnu_e < 1.0


def flat_level(exposure_s, mean, variance):
    return Level(
        exposure_s=exposure_s,
        mean_dn=mean,
        variance_dn2=variance,
        spatial_variance_dn2=0.0,
        clipped_share=0.0,
        n_frames=2,
        n_pixels=100,
    )


def test_bad_ramps_are_refused_in_one_line():
    lights, darks = simulated((1e-3, 4e-3, 8e-3, 1.2e-2))
    bent = [
        flat_level(t, 16.0 + 3000.0 * (t / 0.05) ** 0.7, 10.0 + 840.0 * (t / 0.05) ** 0.7)
        for t in RAMP
    ]
    straight = [flat_level(t, 16.0, 10.0) for t in RAMP]
    for bad_lights, bad_darks, said in (
        (lights[:1] * 4, darks, "3 or more that differ"),
        (lights, darks[1:], "no dark frames at 0.001 s"),
        (darks, lights, "brighter than the light"),
        (bent, straight, "not linear"),
        ([dataclasses.replace(x, clipped_share=1.0) for x in lights], darks, "without clipping"),
    ):
        with pytest.raises(CalibrationError, match=said) as caught:
            fit_photon_transfer(bad_lights, bad_darks)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("taken", "said"),
    [
        ([np.zeros((4, 4), np.uint16)], "take a pair"),
        ([], "take a pair"),
        ([np.full((4, 4), 5000, np.uint16)] * 2, "more than 12 bits"),
        ([np.full((4, 4), np.nan)] * 2, "with NaN"),
        ([np.zeros((4, 4), np.uint16), np.zeros((5, 4), np.uint16)], "one size"),
    ],
)
def test_what_are_no_pairs_of_frames_is_refused(taken, said):
    with pytest.raises(CalibrationError, match=said):
        level(taken, 0.1)
