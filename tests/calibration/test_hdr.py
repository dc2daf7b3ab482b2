"""The merge of a bracket: unbiased, as sharp as the noise allows, and honest about clipping."""

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.hdr import merge
from calibration.model import CameraModel

CAMERA = CameraModel(
    bits=12, black_level_dn=16.0, white_level_dn=4095.0, gain_dn_per_e=0.28, read_noise_e=10.9
)
BRACKET = (0.01, 0.04, 0.16)


def frames(rate_dn_per_s: np.ndarray, exposures=BRACKET, camera=CAMERA, seed=1):
    rng = np.random.default_rng(seed)
    taken = []
    for t in exposures:
        electrons = rng.poisson(rate_dn_per_s * t / camera.gain_dn_per_e)
        noisy = electrons + rng.normal(0, camera.read_noise_e, electrons.shape)
        counts = np.rint(camera.black_level_dn + camera.gain_dn_per_e * noisy)
        taken.append(np.clip(counts, 0, camera.white_level_dn).astype(np.uint16))
    return taken


@pytest.mark.parametrize("rate", [300.0, 3_000.0, 30_000.0, 200_000.0])
def test_merge_is_unbiased_and_states_its_variance(rate):
    found = merge(frames(np.full((200, 200), rate)), BRACKET, (16.0,) * 3, CAMERA)
    pull = (found.value - rate) / np.sqrt(found.variance)
    # measured worst mean -0.025 (of 40 000 pixels, so 0.005 is noise) and deviation 0.998
    assert abs(pull.mean()) < 0.05
    assert pull.std() == pytest.approx(1.0, abs=0.03)


def test_merge_reaches_the_bound_of_cramer_and_rao():
    rate = 20_000.0
    found = merge(frames(np.full((300, 300), rate)), BRACKET, (16.0,) * 3, CAMERA)
    floor = CAMERA.floor_variance_dn2
    assert floor is not None
    bound = 1.0 / sum(t**2 / (0.28 * rate * t + floor) for t in BRACKET)
    # measured 0.9999
    assert found.value.std() / np.sqrt(bound) == pytest.approx(1.0, abs=0.01)


def test_a_frame_clipped_below_the_top_code_is_left_out():
    rate = np.full((100, 100), 60_000.0)  # 9600 DN in the longest exposure, clipped at 4095
    found = merge(frames(rate), BRACKET, (16.0,) * 3, CAMERA)
    # measured -6e-5
    assert found.value.mean() == pytest.approx(60_000.0, rel=1e-3)
    assert found.valid.all()


def test_pixels_clipped_in_every_frame_are_masked_and_never_invented():
    rate = np.full((10, 10), 3_000.0)
    rate[2:4] = 1e6
    found = merge(frames(rate), BRACKET, (16.0,) * 3, CAMERA)
    assert np.isnan(found.value[2:4]).all()
    assert not found.valid[2:4].any()
    assert found.valid[5:].all()


def test_saturated_pixels_do_not_spoil_others_of_the_same_columns():
    rate = np.full((40, 600), 3_000.0)
    rate[3, 7] = 1e6
    found = merge(frames(rate), BRACKET, (16.0,) * 3, CAMERA)
    assert (~found.valid).sum() == 1


def test_darkness_keeps_its_sign():
    found = merge(frames(np.zeros((200, 200))), BRACKET, (16.0,) * 3, CAMERA)
    assert (found.value < 0).mean() == pytest.approx(0.5, abs=0.05)
    # measured 0.13 standard errors
    assert abs(found.value.mean()) < 4 * found.value.std() / 200


def test_without_noise_figures_there_is_a_value_and_no_variance():
    unknown = CameraModel(bits=12, black_level_dn=16.0, white_level_dn=4095.0)
    taken = frames(np.full((50, 50), 3_000.0))
    found = merge(taken, BRACKET, (16.0,) * 3, unknown)
    expected = sum(f.astype(float) - 16.0 for f in taken) / sum(BRACKET)
    np.testing.assert_allclose(found.value, expected, rtol=1e-6)
    assert np.isnan(found.variance).all()


@pytest.mark.parametrize(
    ("taken", "exposures", "said"),
    [
        ([np.full((2, 2), 4095, np.uint16)], (0.1,), "is saturated"),
        ([np.full((2, 2), 5000, np.uint16)], (0.1,), "more than 12 bits"),
        ([np.zeros((2, 2), np.uint16)], (0.0,), "not positive"),
        ([np.zeros((2, 2), np.uint16)], (0.1, 0.2), "do not make a bracket"),
        (
            [np.zeros((2, 2), np.uint16), np.zeros((3, 2), np.uint16)],
            (0.1, 0.2),
            "cannot be merged",
        ),
    ],
)
def test_bad_brackets_are_refused_in_one_line(taken, exposures, said):
    with pytest.raises(CalibrationError, match=said) as caught:
        merge(taken, exposures, (16.0,) * len(exposures), CAMERA)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"black_level_dn": 4095.0},
        {"white_level_dn": 5000.0},
        {"gain_dn_per_e": -1.0},
        {"read_noise_e": float("nan")},
    ],
)
def test_a_camera_that_cannot_be_is_refused(wrong):
    given = {"bits": 12, "black_level_dn": 16.0, "white_level_dn": 4095.0, **wrong}
    with pytest.raises(CalibrationError):
        CameraModel(**given)
