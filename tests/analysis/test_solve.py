"""The front door of transport: what it refuses, how many bounces it takes, and its engines."""

import math

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.transport.ordinates import solve_on
from analysis.transport.solve import solve

TANK, BEAM = Tank(depth_mm=10.0, width_mm=10.0), Beam(from_mm=3.0, to_mm=7.0)
GOOD = {"sigma_t_per_mm": 0.2, "sigma_s_per_mm": 0.1, "g": 0.4}
MEDIUM = Medium(**GOOD)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"orders": 0}, "orders = 0"),
        ({"orders": 401}, "orders = 401"),
        ({"tolerance": 0.0}, "tolerance = 0.0"),
        ({"tolerance": math.nan}, "tolerance = nan"),
        ({"engine": "magic"}, "engine = 'magic'"),
        ({"beam": Beam(from_mm=6.0, to_mm=12.0)}, "leaves the tank's face"),
        ({"beam": Beam(from_mm=12.0, to_mm=14.0)}, "leaves the tank's face"),
        ({"medium": Medium(**{**GOOD, "g": 1.0, "phase": "hg-paper"})}, "infinite power"),
        ({"memory_bytes": 1e5}, "GB are needed and 0.0001 GB at hand"),
    ],
)
def test_what_cannot_be_solved_is_refused_in_one_line(wrong, named):
    asked = {"medium": MEDIUM, "tank": TANK, "beam": BEAM, "orders": 3, **wrong}
    with pytest.raises(AnalysisError, match=named) as caught:
        solve(asked.pop("medium"), asked.pop("tank"), asked.pop("beam"), **asked)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["sigma_t_per_mm", "sigma_s_per_mm", "g"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_none_are_named(name, value):
    with pytest.raises(AnalysisError, match=name):
        Medium(**{**GOOD, name: value})


def test_as_many_orders_are_taken_as_leave_less_than_the_tolerance():
    medium = Medium(sigma_t_per_mm=0.2, sigma_s_per_mm=0.2, g=0.4)  # albedo one converges
    some = solve(medium, TANK, BEAM, tolerance=3e-2, light_field=False).fluence
    grid = Grid(tank=TANK, n_x=some.shape[2], n_y=some.shape[1], n_theta=64)
    many = solve_on(medium, BEAM, grid, n_bounces=60, light_field=False).fluence
    assert 4 < some.shape[0] < 40
    energy = many.sum(axis=(1, 2))
    left = energy[some.shape[0] :].sum() / energy.sum()
    assert left < 3e-2


def test_a_diverging_series_names_what_converges():
    tank, beam = Tank(depth_mm=60.0, width_mm=60.0), Beam(from_mm=20.0, to_mm=40.0)
    medium = Medium(sigma_t_per_mm=0.2, sigma_s_per_mm=0.19, g=0.85, phase="hg-paper")
    with pytest.raises(AnalysisError, match=r"diverges: .*below sigma_s = 0\.\d+ / mm") as caught:
        solve(medium, tank, beam, tolerance=5e-2, light_field=False)
    least = float(str(caught.value).split("below sigma_s = ")[1].split(" ")[0])
    assert 0.0 < least < 0.19


@pytest.mark.parametrize("engine", ["montecarlo", "exhaustive"])
def test_engines_agree_within_the_errors_they_state(engine):
    truth = solve(MEDIUM, TANK, BEAM, orders=4, tolerance=3e-3, light_field=False)
    other = solve(MEDIUM, TANK, BEAM, orders=4, tolerance=3e-2, engine=engine, light_field=False)
    for k in range(1, 4):
        here, there = truth.fluence[k], other.fluence[k]
        stated = other.error_estimate[k]
        # 5e-3 because means of nodes stand for means of the tank
        assert mean_of(there, engine) == pytest.approx(mean_of(here, ""), rel=2.0 * stated + 5e-3)


def mean_of(fluence: np.ndarray, engine: str) -> float:
    if engine == "montecarlo":
        return float(fluence.mean())
    nodes = [np.linspace(0.0, 1.0, n) for n in fluence.shape]
    return float(np.trapezoid(np.trapezoid(fluence, nodes[1], axis=1), nodes[0]))


def test_depth_alone_is_the_middle_of_a_wide_tank():
    tank, beam = Tank(depth_mm=10.0, width_mm=200.0), Beam(from_mm=0.0, to_mm=200.0)
    medium = Medium(sigma_t_per_mm=0.4, sigma_s_per_mm=0.2, g=0.4)
    wide = solve(medium, tank, beam, orders=4, tolerance=1e-2, light_field=False)
    alone = solve(medium, tank, beam, orders=4, tolerance=1e-3, engine="plane", light_field=False)
    middle = wide.fluence[:, wide.fluence.shape[1] // 2]
    at = [np.interp(wide.grid.x_mm, alone.grid.x_mm, order[0]) for order in alone.fluence]
    np.testing.assert_allclose(middle.sum(axis=1), np.sum(at, axis=1), rtol=2e-2)


def test_lengths_scale_and_orders_are_powers_of_sigma_s():
    one = solve(MEDIUM, TANK, BEAM, orders=4, tolerance=5e-2, light_field=False).fluence
    large = solve(
        Medium(sigma_t_per_mm=0.1, sigma_s_per_mm=0.05, g=0.4),
        Tank(depth_mm=20.0, width_mm=20.0),
        Beam(from_mm=6.0, to_mm=14.0),
        orders=4,
        tolerance=5e-2,
        light_field=False,
    ).fluence
    dim = solve(
        Medium(sigma_t_per_mm=0.2, sigma_s_per_mm=0.05, g=0.4),
        TANK,
        BEAM,
        orders=4,
        tolerance=5e-2,
        light_field=False,
    ).fluence
    # rounding in single precision
    np.testing.assert_allclose(one, large, rtol=1e-5)
    for k in range(4):
        np.testing.assert_allclose(dim[k] * 2.0**k, one[k], rtol=1e-5)
