"""Shifts add up to even light whatever the medium and the lens do, and to nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from labrig.acquisition.shift_sums import Sums, add_up
from labrig.acquisition.thinned import Thinned

WIDTH, ROWS, GAIN, READ_DN = 1200, 16, 0.28, 3.0


def picture(light: np.ndarray, rng: np.random.Generator, gamma: float = 1.0) -> Thinned:
    """A picture of light, DN, with the noise of a camera, and its response if that is bent."""
    counts = light + rng.normal(size=light.shape) * np.sqrt(GAIN * light + READ_DN**2)
    bent = 4000.0 * np.maximum(counts / 4000.0, 0.0) ** (1.0 / gamma)
    return Thinned(
        counts=np.zeros(1, np.uint16),
        light=bent.ravel(),
        variance=(GAIN * bent + READ_DN**2).ravel(),
        clipped=np.zeros(light.size, bool),
        exposure_s=0.1,
        lamp=1.0,
    )


def seen(level: np.ndarray, single_share: float, blur_px: float) -> np.ndarray:
    """(rows, cols) DN of projector levels: single scattering that keeps them, multiple that blurs.

    The light falls with depth, and the field is no whole number of periods wide.
    """
    depth = np.exp(-np.arange(ROWS) / 8.0)[:, None]
    single = gaussian_filter1d(level, blur_px, mode="wrap") if blur_px else level
    multiple = gaussian_filter1d(level, 60.0, mode="wrap")
    return 20.0 + 2500.0 * depth * (single_share * single + (1.0 - single_share) * multiple)


def shown(shifts: int, period_px: int, single_share: float, blur_px: float):
    """The shifts, white and black, as light."""
    x = np.arange(WIDTH)
    step = period_px // shifts
    levels = [(((x - k * step) % period_px) < period_px // 2).astype(float) for k in range(shifts)]
    lit = [np.ones(WIDTH), np.zeros(WIDTH)]
    return [[seen(level, single_share, blur_px) for level in part] for part in (levels, lit)]


def sums(light, lit, *, gamma: float = 1.0, seed: int = 1) -> Sums:
    rng = np.random.default_rng(seed)
    found = add_up(
        [picture(one, rng, gamma) for one in light],
        tuple(picture(one, rng, gamma) for one in lit),
    )
    assert found is not None
    return found


@pytest.mark.parametrize(("shifts", "period_px"), [(2, 12), (3, 12), (4, 16), (5, 20), (9, 36)])
@pytest.mark.parametrize("single_share", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("blur_px", [0.0, 1.5])
def test_sound_shifts_add_up(shifts, period_px, single_share, blur_px) -> None:
    found = sums(*shown(shifts, period_px, single_share, blur_px))
    # measured: nothing above noise, and 4e-4
    assert found.residual < 0.005
    assert found.stripes == 0.0
    assert abs(found.brightness - 1.0) < 0.002


@pytest.mark.parametrize(("shifts", "period_px"), [(2, 12), (3, 12), (4, 16), (5, 20), (9, 36)])
@pytest.mark.parametrize("at", [0, 1])
def test_half_stale_picture_does_not_add_up(shifts, period_px, at) -> None:
    light, lit = shown(shifts, period_px, 0.5, 1.0)
    light[at] = 0.5 * (light[at] + light[at - 1])
    # measured 0.19 (two shifts), 0.15 (four), 0.059, 0.057 and 0.035 (three, five and nine)
    found = sums(light, lit)
    assert found.residual > 0.03
    # measured 0.19, 0.14 and 0.084 of the stripes for three, five and nine
    assert shifts % 2 == 0 or found.stripes > 0.08


@pytest.mark.parametrize("shifts", [2, 3, 4, 6])
@pytest.mark.parametrize("blur_px", [0.0, 1.5])
@pytest.mark.parametrize("single_share", [0.05, 0.5, 0.8])
def test_gamma_is_seen_wherever_light_is_shared(single_share, blur_px, shifts) -> None:
    """Where it is not black between lit stripes, they outshine what a bent white lets expect."""
    found = sums(*shown(shifts, 12, single_share, blur_px), gamma=2.2)
    # measured 1.15 to 1.28
    assert found.brightness > 1.12
