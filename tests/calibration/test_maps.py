"""Dark maps, flat fields, and brackets merged with them."""

import tracemalloc

import numpy as np
import pytest

from calibration.dark import fit_dark
from calibration.errors import CalibrationError
from calibration.flat import fit_flat
from calibration.hdr import merge
from calibration.model import CameraModel
from calibration.photon_transfer import measure_level

CAMERA = CameraModel(
    bits=12, black_level_dn=0.0, white_level_dn=4095.0, gain_dn_per_e=0.28, read_noise_e=10.9
)
SHAPE = (60, 80)
RNG = np.random.default_rng(8)
OFFSET = 20.0 + RNG.normal(0.0, 2.0, SHAPE)
CURRENT = 30.0 + RNG.normal(0.0, 5.0, SHAPE)
CURRENT[5, 7] = 2000.0
RESPONSE = 1.0 + RNG.normal(0.0, 0.03, SHAPE)
RESPONSE[20, 30] = 0.1


def frame(rate, exposure_s, seed):
    rng = np.random.default_rng(seed)
    electrons = rng.poisson((rate * RESPONSE + CURRENT) * exposure_s / 0.28)
    counts = OFFSET + 0.28 * (electrons + rng.normal(0.0, 10.9, SHAPE))
    return np.clip(np.rint(counts), 0, 4095).astype(np.uint16)


def darks(exposures=(0.01, 0.5, 1.0), n=12):
    return [(t, frame(0.0, t, 100 * k + j)) for k, t in enumerate(exposures) for j in range(n)]


@pytest.fixture(scope="module")
def dark():
    return fit_dark(iter(darks()), bits=12, white_level_dn=4095.0)


def test_every_pixels_offset_and_current_are_found(dark):
    sane = ~dark.hot
    pull = (dark.at(0.5) - OFFSET - 0.5 * CURRENT)[sane] / np.sqrt(dark.variance_at(0.5))
    # measured -0.0005 and 0.996
    assert abs(pull.mean()) < 0.06
    assert pull.std() == pytest.approx(1.0, abs=0.04)
    assert np.median(dark.current_dn_per_s) == pytest.approx(30.0, rel=0.03)
    assert dark.hot[5, 7]
    assert dark.hot.sum() < 10  # measured 1


def test_one_exposure_knows_no_dark_current():
    single = fit_dark(darks((0.5,)), bits=12, white_level_dn=4095.0)
    assert single.current_dn_per_s is None
    assert single.at(0.5).mean() == pytest.approx((OFFSET + 0.5 * CURRENT).mean(), abs=0.1)
    with pytest.raises(CalibrationError, match="dark current is unknown"):
        single.at(0.1)


def test_response_of_every_pixel_is_found_and_dead_ones_masked(dark):
    flats = [(0.5, frame(4000.0, 0.5, k)) for k in range(16)]
    found = fit_flat(iter(flats), dark, CAMERA)
    usable = found.usable
    assert not usable[20, 30]
    assert not usable[5, 7]
    pull = ((found.relative - RESPONSE / np.median(RESPONSE)) / np.sqrt(found.variance))[usable]
    # measured -0.08, the median that norms them, and 0.991
    assert abs(pull.mean()) < 0.15
    assert pull.std() == pytest.approx(1.0, abs=0.05)
    # measured 0.0299
    assert found.nonuniformity == pytest.approx(0.03, rel=0.1)


def test_merge_with_maps_is_even_and_states_its_variance(dark):
    flats = [(0.5, frame(4000.0, 0.5, k)) for k in range(16)]
    flat = fit_flat(flats, dark, CAMERA)
    exposures = (0.1, 0.4)
    taken = [frame(2000.0, t, 500 + k) for k, t in enumerate(exposures)]
    found = merge(taken, exposures, [dark.at(t) for t in exposures], CAMERA, flat)
    assert np.isnan(found.value[20, 30])
    assert not found.valid[20, 30]
    good = found.valid & ~dark.hot
    scale = np.median(RESPONSE)
    pull = ((found.value - 2000.0 * scale) / np.sqrt(found.variance))[good]
    # measured 0.02 and 1.019
    assert abs(pull.mean()) < 0.1
    assert pull.std() == pytest.approx(1.0, abs=0.06)


def test_neighbours_of_a_bloomed_pixel_are_left_out():
    rate = np.full((20, 20), 5000.0)
    long = np.clip(np.rint(rate * 0.4), 0, 4095).astype(np.uint16)
    short = np.rint(rate * 0.1).astype(np.uint16)
    long[10, 10] = 4095
    long[9:12, 9:12] += np.where(long[9:12, 9:12] < 4095, 900, 0).astype(np.uint16)
    found = merge([short, long], (0.1, 0.4), (0.0, 0.0), CAMERA)
    # the bloomed neighbours read 45 % high; only the short frame serves there
    np.testing.assert_allclose(found.value[9:12, 9:12], 5000.0, rtol=1e-6)
    assert (found.variance[9, 9] > 3 * found.variance[0, 0]).all()


def test_repeats_are_streamed_and_count_like_one_long_list():
    taken = [frame(2000.0, t, 900 + k) for k, t in enumerate((0.1, 0.4, 0.1, 0.4, 0.1))]
    exposures = (0.1, 0.4, 0.1, 0.4, 0.1)
    found = merge(iter(taken), exposures, (20.0,) * 5, CAMERA)
    floor, estimate = CAMERA.floor_variance_dn2, found.value.astype(float)
    for _ in range(4):
        weights = [t / (0.28 * np.maximum(estimate, 0) * t + floor) for t in exposures]
        above = sum(w * (f - 20.0) for w, f in zip(weights, taken, strict=True))
        estimate = above / sum(w * t for w, t in zip(weights, exposures, strict=True))
    # measured worst 3e-7, the precision of float32
    np.testing.assert_allclose(found.value, estimate, rtol=1e-5)


def test_memory_does_not_grow_with_the_stack():
    def taken(n, brightest):
        rng = np.random.default_rng(1)
        return (rng.integers(20, brightest, (300, 400), dtype=np.uint16) for _ in range(n))

    def peak(n):
        times, camera = (0.1, 0.4) * (n // 2), {"bits": 12, "white_level_dn": 4095.0}
        tracemalloc.start()
        merge(taken(n, 3000), times, (20.0,) * n, CAMERA)
        measure_level(taken(n, 3000), 0.1, **camera)
        fit_dark(zip(times, taken(n, 60), strict=True), **camera)
        found = tracemalloc.get_traced_memory()[1] / (2 * 300 * 400)
        tracemalloc.stop()
        return found

    peak(4)  # compiles
    few, many = peak(4), peak(60)
    # in frames of 16 bits; measured 42.5 both, most of them sums in double precision
    assert many < few + 1.0
    assert few < 60.0


def test_bad_darks_and_flats_are_refused_in_one_line(dark):
    bright = [(0.5, np.full(SHAPE, 2000, np.uint16))] * 2
    for frames, said in (
        (bright, "capped"),
        (darks()[:1], "take 2 or more"),
        ([(0.5, np.full(SHAPE, 5000, np.uint16))], "more than 12 bits"),
        ([(0.5, np.full(SHAPE, np.nan))], "NaN"),
    ):
        with pytest.raises(CalibrationError, match=said) as caught:
            fit_dark(frames, bits=12, white_level_dn=4095.0)
        assert "\n" not in str(caught.value)
    for counts, said in ((0, "darker than the dark"), (60, "half"), (4095, "saturated")):
        with pytest.raises(CalibrationError, match=said):
            fit_flat([(0.5, np.full(SHAPE, counts, np.uint16))], dark, CAMERA)
    with pytest.raises(CalibrationError, match="no frame of role flat"):
        fit_flat([], dark, CAMERA)
    with pytest.raises(CalibrationError, match="one size"):
        fit_flat([(0.5, np.full((4, 4), 2000, np.uint16))], dark, CAMERA)
