"""Stripes as they arrive in the tank."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calibration.errors import CalibrationError
from calibration.projector import stripe_light

KIND = {"period_px": 12.0, "duty": 0.5, "n_shifts": 6}


def test_blurred_stripes_are_a_blurred_square_wave():
    fine = 200
    u = (np.arange(36 * fine) + 0.5) / fine
    for shift in range(6):
        square = ((u - 2 * shift) % 12 < 6).astype(float)
        boxed = np.convolve(
            np.r_[square[-fine:], square, square[:fine]], np.ones(fine) / fine, "same"
        )
        exact = gaussian_filter1d(boxed[fine:-fine], 0.5 * fine, mode="wrap")
        found = stripe_light(u, **KIND, blur_px=0.5, pixel_px=1.0)[shift]
        # measured worst 1.7e-3: half a sample of the sampled box
        np.testing.assert_allclose(found, exact, atol=2.5e-3)


def test_shifts_together_are_the_uniform_light():
    u = np.linspace(0.0, 12.0, 97)
    light = stripe_light(u, **KIND, blur_px=0.3, pixel_px=0.5)
    # measured worst 3e-16
    np.testing.assert_allclose(light.mean(axis=0), 0.5, atol=1e-13)
    # shift k has moved the pattern by k/6 of its period
    moved = stripe_light(u - 2.0, **KIND, blur_px=0.3, pixel_px=0.5)
    np.testing.assert_allclose(light[1], moved[0], atol=1e-13)


@pytest.mark.parametrize("wrong", [{"duty": 1.0}, {"period_px": 0.0}])
def test_unphysical_stripes_are_refused(wrong):
    with pytest.raises(CalibrationError, match="not physical"):
        stripe_light(np.zeros(3), **{**KIND, **wrong}, blur_px=0.5, pixel_px=0.5)
