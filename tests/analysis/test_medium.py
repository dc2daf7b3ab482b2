"""Nonsense is refused in one line, by name."""

import math

import pytest

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.transport.montecarlo import simulate
from analysis.transport.ordinates import solve_on

GOOD = {"sigma_t_per_mm": 0.2, "sigma_s_per_mm": 0.1, "g": 0.4}


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"g": 1.1}, "g = 1.1"),
        ({"g": math.nan}, "g = nan"),
        ({"sigma_t_per_mm": -0.2}, "sigma_t = -0.2"),
        ({"sigma_t_per_mm": 0.0}, "sigma_t = 0.0"),
        ({"sigma_t_per_mm": math.inf}, "sigma_t_per_mm = inf"),
        ({"sigma_s_per_mm": 0.3}, "sigma_s = 0.3"),
        ({"phase": "mie"}, "phase = 'mie'"),
    ],
)
def test_a_medium_that_cannot_be_is_refused(wrong, named):
    with pytest.raises(AnalysisError, match=named) as caught:
        Medium(**{**GOOD, **wrong})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Tank(depth_mm=0.0, width_mm=1.0),
        lambda: Tank(depth_mm=math.nan, width_mm=1.0),
        lambda: Beam(from_mm=2.0, to_mm=1.0),
        lambda: Beam(from_mm=0.0, to_mm=1.0, angle_deg=90.0),
        lambda: Beam(from_mm=-1.0, to_mm=1.0).entering(Tank(depth_mm=1.0, width_mm=2.0)),
        lambda: Grid.covering(Tank(depth_mm=1.0, width_mm=1.0), cell_mm=0.0, n_theta=16),
        lambda: Grid(tank=Tank(depth_mm=1.0, width_mm=1.0), n_x=2, n_y=9, n_theta=16),
    ],
)
def test_geometry_that_cannot_be_is_refused(make):
    with pytest.raises(AnalysisError) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("profile", "named"),
    [
        (((1.0, 1.0),), "fewer than two"),
        (((1.0, 1.0), (1.0, 2.0), (2.0, 1.0)), "ascend"),
        (((1.0, 1.0), (math.nan, 2.0), (2.0, 1.0)), "ascend"),
        (((1.0, 1.0), (1.9, 1.0)), "not at 1.0 and 2.0"),
        (((1.0, 1.0), (2.0, -0.1)), "negative"),
        (((1.0, math.inf), (2.0, 1.0)), "no finite"),
        (((1.0, 0.0), (2.0, 0.0)), "dark"),
    ],
)
def test_a_profile_that_cannot_be_is_refused(profile, named):
    with pytest.raises(AnalysisError, match=named) as caught:
        Beam(from_mm=1.0, to_mm=2.0, profile=profile)
    assert "\n" not in str(caught.value)


def test_a_profile_is_read_back_and_a_top_hat_has_two_points():
    y_mm, irradiance = Beam(
        from_mm=1.0, to_mm=4.0, profile=((1.0, 0.0), (2.0, 3.0), (4.0, 0.5))
    ).profile_points()
    assert (y_mm.tolist(), irradiance.tolist()) == ([1.0, 2.0, 4.0], [0.0, 3.0, 0.5])
    y_mm, irradiance = Beam(from_mm=1.0, to_mm=4.0).profile_points()
    assert (y_mm.tolist(), irradiance.tolist()) == ([1.0, 4.0], [1.0, 1.0])


def test_solvers_refuse_what_they_cannot_answer():
    tank, beam = Tank(depth_mm=4.0, width_mm=4.0), Beam(from_mm=1.0, to_mm=2.0)
    grid = Grid.covering(tank, cell_mm=1.0, n_theta=8)
    peaked = Medium(**{**GOOD, "g": 0.95})
    with pytest.raises(AnalysisError, match=r"cannot resolve g = 0\.95"):
        solve_on(peaked, beam, grid, n_bounces=3)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"n_paths": 3}, "at least 16 paths"),
        ({"n_bounces": 1}, "paths of 2"),
        ({"cell_mm": 0.0}, "cell_mm = 0.0"),
        ({"cell_mm": math.nan}, "cell_mm = nan"),
        ({"angular_bounces": (1,)}, "choose among bounces 2 to 3"),
        ({"angular_bounces": (2, 4)}, "choose among bounces 2 to 3"),
        ({"angular_bounces": (2,), "n_theta": 0}, "n_theta = 0"),
        ({"until_std_error": 0.0}, "until_std_error = 0.0"),
        ({"until_std_error": math.nan}, "until_std_error = nan"),
        ({"beam": Beam(from_mm=1.0, to_mm=4.5)}, "leaves the tank's face"),
    ],
)
def test_the_monte_carlo_refuses_what_it_cannot_answer(wrong, named):
    tank, beam = Tank(depth_mm=4.0, width_mm=4.0), Beam(from_mm=1.0, to_mm=2.0)
    asked = {"beam": beam, "n_bounces": 3, "n_paths": 100, "cell_mm": 1.0, "seed": 1, **wrong}
    with pytest.raises(AnalysisError, match=named) as caught:
        simulate(Medium(**GOOD), tank, **asked)
    assert "\n" not in str(caught.value)


def test_the_literal_phase_function_has_no_limit_at_an_asymmetry_of_one():
    medium = Medium(**GOOD, phase="hg-paper")
    object.__setattr__(medium, "g", 1.0)  # whether or not a medium admits it
    tank, beam = Tank(depth_mm=4.0, width_mm=4.0), Beam(from_mm=1.0, to_mm=2.0)
    with pytest.raises(AnalysisError, match=r"hg-paper has no integral at g = 1\.0"):
        simulate(medium, tank, beam, n_bounces=3, n_paths=100, cell_mm=1.0, seed=1)
