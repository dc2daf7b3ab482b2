"""All bounces at once against their series, against closed forms and against invariances."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.light_field import equal_angles
from analysis.medium import Medium
from analysis.transport.eigenmodes import plane_light
from analysis.transport.plane import PlaneGrid, solve_plane

DEPTH_MM = 60.0
X_MM = np.array([0.5, 1.0, 2.0, 5.0, 10.0, 20.0])


def series(medium: Medium, q: float, angle_deg: float, n_theta: int, n_bounces: int) -> np.ndarray:
    """Sum the orders of the depth solver, on the same directions and a fine grid."""
    graded = PlaneGrid.graded(
        DEPTH_MM, sigma_t_per_mm=medium.sigma_t_per_mm, n_x=300, n_theta=n_theta
    )
    grid = PlaneGrid(
        x_mm=graded.x_mm,
        theta_rad=equal_angles(n_theta),
        weight_rad=np.full(n_theta, 2.0 * np.pi / n_theta),
    )
    field = solve_plane(medium, grid, n_bounces=n_bounces, wavenumber_per_mm=q, angle_deg=angle_deg)
    decay = np.exp(-medium.sigma_t_per_mm * grid.x_mm)
    total = field.weighted(medium.sigma_s_per_mm).sum(axis=0) / decay
    return CubicSpline(grid.x_mm, total)(X_MM) * np.exp(-medium.sigma_t_per_mm * X_MM)


@pytest.mark.parametrize("q", [0.0, 0.17, 3.49])
@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
@pytest.mark.parametrize(
    ("albedo", "g", "phase"),
    [
        (0.5, 0.4, "hg-plane"),
        (0.5, 0.4, "hg-paper"),
        (0.9, 0.7, "hg-plane"),
        (0.3, -0.3, "hg-plane"),
    ],
)
def test_the_modes_are_the_sum_of_the_series(albedo, g, phase, angle_deg, q):
    medium = Medium(sigma_t_per_mm=0.25, sigma_s_per_mm=0.25 * albedo, g=g, phase=phase)
    summed = series(medium, q, angle_deg, 64, 40 if albedo < 0.8 else 150)
    found = plane_light(
        medium,
        X_MM,
        depth_mm=DEPTH_MM,
        wavenumber_per_mm=q,
        angle_deg=angle_deg,
        n_theta=64,
        equal_steps=True,
    )
    # measured worst 3.5e-4, where stripes oscillate between the nodes of the series' grid
    assert np.abs(found / summed - 1.0).max() < 1e-3


@pytest.mark.parametrize("q", [0.0, 0.25])
@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
@pytest.mark.parametrize("g", [-0.8, 0.0, 0.7, 0.9, 0.95])
def test_few_directions_say_what_many_say(g, angle_deg, q):
    """Points of Gauss with a forward spike against eight times as many equal steps."""
    medium = Medium(sigma_t_per_mm=0.25, sigma_s_per_mm=0.2375, g=g)
    at = {"depth_mm": DEPTH_MM, "wavenumber_per_mm": q, "angle_deg": angle_deg}
    few = plane_light(medium, X_MM, **at)
    many = plane_light(medium, X_MM, **at, n_theta=512, equal_steps=True)
    # measured worst 2.5e-4, at g = 0.95; 9.2e-5 below
    assert np.abs(few / many - 1.0).max() < 1e-3


@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.9])
def test_the_face_of_a_half_space_is_chandrasekhars(albedo):
    """Flatland, isotropic, normal incidence: face fluence is the H-function at mu = 1.

    It solves ``1/H(mu) = 1 - (albedo mu / pi) int H(mu') / ((mu + mu') sqrt(1 - mu'^2)) dmu'``,
    which is iterated here over directions between the axes.
    """
    node, share = np.polynomial.legendre.leggauss(200)
    angle, weight = 0.25 * np.pi * (node + 1.0), 0.25 * np.pi * share
    mu, h = np.cos(angle), np.ones(200)
    for _ in range(400):
        kernel = (h * weight)[None, :] / (mu[:, None] + mu[None, :])
        h = 1.0 / (1.0 - albedo / np.pi * mu * kernel.sum(axis=1))
    at_one = 1.0 / (1.0 - albedo / np.pi * float(np.sum(h * weight / (1.0 + mu))))
    medium = Medium(sigma_t_per_mm=1.0, sigma_s_per_mm=albedo, g=0.0)
    found = plane_light(medium, np.array([0.0]), depth_mm=200.0)
    # measured worst 1.2e-8
    assert found[0].real == pytest.approx(at_one, rel=1e-7)


def test_everything_depends_on_optical_lengths_only():
    medium = Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=0.24, g=0.6)
    double = Medium(sigma_t_per_mm=0.6, sigma_s_per_mm=0.48, g=0.6)
    one = plane_light(medium, X_MM, depth_mm=40.0, wavenumber_per_mm=1.3, angle_deg=20.0)
    two = plane_light(double, 0.5 * X_MM, depth_mm=20.0, wavenumber_per_mm=2.6, angle_deg=20.0)
    # measured worst 2e-16
    assert np.abs(two / one - 1.0).max() < 1e-9


def test_without_scattering_only_the_beam_is_left():
    medium = Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=0.0, g=0.6)
    light = plane_light(medium, X_MM, depth_mm=40.0, wavenumber_per_mm=2.0, angle_deg=25.0)
    beam = np.exp(-0.3 * X_MM / np.cos(np.radians(25.0)))
    # measured worst 2e-16
    assert np.abs(light - beam).max() < 1e-12


def test_an_albedo_of_one_is_the_limit():
    """Two modes are the same there; what stands in for them must not show."""
    medium = Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=0.3, g=0.4)
    thick = plane_light(medium, X_MM, depth_mm=40.0).real
    almost = plane_light(
        Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=0.3 * (1 - 1e-7), g=0.4), X_MM, depth_mm=40.0
    ).real
    # measured worst 3.1e-6
    assert np.abs(thick / almost - 1.0).max() < 2e-5


@pytest.mark.parametrize("n_theta", [0, 12, 66])
def test_directions_are_a_multiple_of_four(n_theta):
    medium = Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=0.1, g=0.0)
    with pytest.raises(AnalysisError, match="multiple of four"):
        plane_light(medium, X_MM, depth_mm=40.0, n_theta=n_theta)
