"""Tanks whose walls give light back, and stripes that lose their sharpness, against exact sums."""

import math

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.medium import Beam, Medium, Tank
from analysis.transport.montecarlo import Walls, simulate
from analysis.transport.montecarlo_folded import turned_back
from analysis.transport.plane import PlaneGrid, solve_plane
from labrig.scene.fresnel import internal_reflectance

MEDIUM = Medium(sigma_t_per_mm=0.4, sigma_s_per_mm=0.3, g=0.4)
TANK = Tank(depth_mm=10.0, width_mm=8.0)
HALF = Beam(from_mm=2.0, to_mm=6.0, angle_deg=20.0)
ALL_MIRRORS = Walls(face_index=1e9, reflectance=1.0)


def sums(field) -> np.ndarray:
    return np.asarray(field.fluence.sum(axis=(1, 2))) * (10.0 / 20) * (8.0 / 16)


def run(walls: Walls | None, beam: Beam = HALF, **changes):
    given = {"n_bounces": 5, "n_paths": 64_000, "cell_mm": 0.5, "seed": 3, **changes}
    return simulate(changes.pop("medium", MEDIUM), TANK, beam, walls=walls, **given)


def test_black_walls_are_those_of_the_plain_kernel():
    one, other = run(None), run(Walls())
    # measured worst 0.6 %: the two follow other paths from the third collision on
    np.testing.assert_allclose(sums(other), sums(one), rtol=0.02)
    first = one.fluence[0], other.fluence[0]
    np.testing.assert_allclose(first[1].mean(axis=0), first[0].mean(axis=0), rtol=0.02)


def test_mirrors_all_around_lose_no_light():
    found = sums(run(ALL_MIRRORS))
    entering = 4.0 * math.cos(math.radians(20.0))
    albedo = 0.75
    # every order is absorbed or scattered in the liquid: sigma_t sum phi_k = sigma_s sum phi_(k-1)
    expected = entering / 0.4 * albedo ** np.arange(1, 6)
    # measured worst 0.4 %
    np.testing.assert_allclose(found[:4], expected[:4], rtol=0.01)


def test_side_mirrors_make_the_light_that_of_an_endless_slab():
    full = Beam(from_mm=0.0, to_mm=8.0)
    deep = Tank(depth_mm=10.0, width_mm=8.0)
    thick = Medium(sigma_t_per_mm=1.2, sigma_s_per_mm=0.9, g=0.4)
    found = simulate(
        thick,
        deep,
        full,
        n_bounces=4,
        n_paths=256_000,
        cell_mm=0.5,
        seed=5,
        walls=Walls(reflectance=1.0),
    )
    grid = PlaneGrid.graded(10.0, sigma_t_per_mm=1.2, n_x=160, n_theta=64)
    exact = solve_plane(thick, grid, n_bounces=4).weighted(0.9).real
    fine = (np.arange(2000) + 0.5) * 0.005
    for order in (2, 3, 4):
        mean = np.interp(fine, grid.x_mm, exact[order - 1]).reshape(20, 100).mean(axis=1)
        # to where the light is a tenth of the brightest, and the far mirror's is nothing
        got = found.fluence[order - 2].mean(axis=0)
        np.testing.assert_allclose(got[:8], mean[:8], rtol=0.03)  # measured 0.012


def test_stripes_that_blur_with_depth_lose_what_the_gaussian_takes():
    q, growth, blur = 2.0 * math.pi / 3.0, 0.06, 0.1
    wide = Tank(depth_mm=10.0, width_mm=40.0)
    found = simulate(
        MEDIUM,
        wide,
        Beam(from_mm=2.0, to_mm=38.0),
        n_bounces=2,
        n_paths=800_000,
        cell_mm=0.5,
        seed=7,
        stripe_wavenumber_per_mm=q,
        harmonics=(1,),
        walls=Walls(blur_mm=blur, growth=growth),
    )
    got = found.modulated[0][30:50].mean(axis=0)

    def wave(x: np.ndarray) -> np.ndarray:
        now = (blur + growth * x) ** 2 - blur**2
        return np.exp(-0.4 * x - 0.5 * q**2 * now)

    # the second bounce summed over directions and the way back along each
    theta = 2.0 * np.pi * (np.arange(720) + 0.5) / 720
    p = (1.0 - 0.16) / (2.0 * np.pi * (1.0 + 0.16 - 0.8 * np.cos(theta)))
    x = found.x_mm
    expected = np.zeros(x.size, dtype=complex)
    nodes, weights = np.polynomial.legendre.leggauss(160)
    for angle, density in zip(theta, p, strict=True):
        cosine, sine = math.cos(angle), math.sin(angle)
        reach = np.minimum(x / cosine if cosine > 0 else (10.0 - x) / -cosine, 40.0)
        way = 0.5 * reach[:, None] * (1.0 + nodes)
        light = wave(x[:, None] - way * cosine) * np.exp(-(0.4 + 1j * q * sine) * way)
        expected += density * (0.5 * reach * (light @ weights))
    expected *= 0.3 * 2.0 * np.pi / 720
    # measured 0.012 of the largest; the first cell's mean is not its middle
    worst = np.abs(got - expected)[1:].max() / np.abs(expected).max()
    assert worst < 0.03
    even = wave(x) * np.exp(0.4 * x)
    assert even[10] < 0.75  # the blur has taken something


@pytest.mark.parametrize("index", [1.0, 1.33, 1.6])
def test_the_kernels_fresnel_is_the_scenes(index):
    for cosine in np.linspace(0.01, 1.0, 40):
        twin = internal_reflectance(index, np.array([cosine]))[0]
        assert turned_back(index, float(cosine)) == pytest.approx(twin, abs=1e-14)


def test_a_light_field_of_folded_paths_is_refused():
    with pytest.raises(AnalysisError, match="not black is not sampled"):
        run(ALL_MIRRORS, angular_bounces=(2,))
