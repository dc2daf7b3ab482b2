"""Grey levels, black's leak, latency, and what makes a record valid."""

import dataclasses
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.latency import FlipFrame, fit_latency
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


def flips(n=200, latency_s=0.031, settle_s=0.01, seed=3):
    """Frames of 8 ms about flips at random phase; light rises exponentially to its end."""
    rng = np.random.default_rng(seed)
    fine = (np.arange(400) + 0.5) / 400
    frames = []
    for k in range(n):
        change = latency_s + rng.uniform(0.0, 1 / 60)
        for start in (rng.uniform(0.02, 0.05), rng.uniform(0.06, 0.12)):
            t = start + 0.008 * fine - change
            share = np.where(t > 0, 1.0 - np.exp(-t * 5.3 / settle_s), 0.0).mean()
            rising = bool(k % 2)
            level = share if rising else 1.0 - share
            frames.append(
                FlipFrame(
                    requested_s=100.0 + k,
                    start_s=100.0 + k + start,
                    end_s=100.008 + k + start,
                    brightness=20.0 + 180.0 * level + rng.normal(0.0, 0.05),
                    rising=rising,
                )
            )
    return frames


def test_latency_and_settle_time_of_flips_at_random_phase():
    found = fit_latency(flips(), black=20.0, white=200.0)
    # light rises over some ms, so that its mean change is 1.9 ms late: measured 40.6 ms where the
    # middle of latency and refresh is 39.3 ms
    assert found.latency_s == pytest.approx(0.031 + 1 / 120 + 0.0019, abs=0.002)
    assert 0.030 < found.earliest_s < found.latest_s < 0.031 + 1 / 60 + 0.006
    # measured 4.6 ms, of uniform 1/60 s
    assert found.jitter_s == pytest.approx(1 / 60 / np.sqrt(12), rel=0.2)
    # measured 9.1 ms, where light comes within 0.5 percent after 10 ms
    assert found.settle_s == pytest.approx(0.01, abs=0.003)


def test_flips_that_cannot_be_are_refused():
    early = [dataclasses.replace(f, requested_s=f.requested_s + 1.0) for f in flips()]
    for frames, levels, said in (
        (flips(4), (20.0, 200.0), "20 are needed"),
        (flips(), (200.0, 20.0), "no brighter"),
        (early, (20.0, 200.0), "before it was asked"),
    ):
        with pytest.raises(CalibrationError, match=said):
            fit_latency(frames, black=levels[0], white=levels[1])


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
