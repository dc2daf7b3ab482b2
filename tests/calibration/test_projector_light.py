"""Grey levels, black's leak, and what makes a record valid."""

import dataclasses
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.projector import black_leak, fit_gamma, stripe_light
from calibration.record import Conditions, Record, validity


def test_gamma_and_its_inverse():
    levels = np.linspace(0.0, 1.0, 18)
    rng = np.random.default_rng(1)
    light = 20.0 + 900.0 * levels**2.2 + rng.normal(0.0, 1.0, 18)
    found = fit_gamma(levels, light)
    # measured 2.18
    assert found.exponent == pytest.approx(2.2, abs=0.05)
    wanted = np.linspace(0.05, 1.0, 9)
    # one is the other's inverse; measured worst 2e-16
    np.testing.assert_allclose(found.light_at(found.level_for(wanted)), wanted, atol=1e-12)
    np.testing.assert_allclose(found.light, levels**2.2, atol=0.005)


@pytest.mark.parametrize(
    ("levels", "light", "said"),
    [
        ([0.0, 0.5, 1.0], [0, 1, 2], "4 or more"),
        ([0.1, 0.2, 0.5, 1.0], [0, 1, 2, 3], "black"),
        ([0.0, 0.3, 0.6, 1.0], [3, 2, 1, 0], "no brighter"),
    ],
)
def test_ramps_that_tell_nothing_are_refused(levels, light, said):
    with pytest.raises(CalibrationError, match=said):
        fit_gamma(levels, light)


def test_leak_is_black_over_white_where_white_is_bright():
    white = np.full((4, 6), 200.0)
    white[0] = 1.0
    leak = black_leak(white, 0.05 * white)
    assert np.isnan(leak[0]).all()
    np.testing.assert_allclose(leak[1:], 0.05)
    with pytest.raises(CalibrationError, match="swapped"):
        black_leak(0.05 * white, white)


def test_measured_transfer_stands_for_blur_and_pixel():
    u = np.linspace(0.0, 12.0, 50)
    kind = {"period_px": 12.0, "duty": 0.5, "n_shifts": 6}
    blurred = stripe_light(u, **kind, blur_px=0.7, pixel_px=0.0)
    by_transfer = stripe_light(
        u, **kind, transfer=lambda period: np.exp(-2.0 * (np.pi * 0.7 / period) ** 2)
    )
    # measured worst 1e-16
    np.testing.assert_allclose(by_transfer, blurred, atol=1e-12)


NOW = datetime(2026, 11, 22, 12, 0, tzinfo=UTC)
HERE = Conditions(camera="A 1", lens="16 mm", gain="0 dB", mode="Mono12", bits=12, roi=(480, 640))


def record(kind, **changes):
    return Record(
        kind=kind,
        created=NOW - timedelta(hours=1),
        conditions=dataclasses.replace(HERE, **changes),
        inputs="",
        n_frames=2,
        quantities={},
    )


@pytest.mark.parametrize(
    ("kind", "changes", "fatal", "told"),
    [
        ("dark", {}, set(), set()),
        ("dark", {"gain": "6 dB"}, {"gain"}, set()),
        ("dark", {"lens": "25 mm", "projector": "X"}, set(), set()),
        ("dark", {"roi": (240, 320)}, {"roi"}, set()),
        ("photon-transfer", {"roi": (240, 320), "camera": "B 2"}, {"camera"}, set()),
        ("flat", {"lens": None, "gain": "6 dB"}, set(), {"lens", "gain"}),
        ("geometry", {"lens": "25 mm", "bits": 8}, {"lens"}, set()),
        ("projector", {"projector_mode": "1080p"}, set(), {"projector mode"}),
    ],
)
def test_a_record_is_refused_for_what_it_depends_on_only(kind, changes, fatal, told):
    found = validity(record(kind, **changes), HERE, NOW)
    assert {d.what for d in found if d.fatal} == fatal
    assert {d.what for d in found if not d.fatal} == told


def test_an_old_record_is_told_and_not_refused():
    (found,) = validity(record("dark"), HERE, NOW + timedelta(days=2))
    assert (found.what, found.fatal) == ("age", False)
    assert "49 h" in found.text
