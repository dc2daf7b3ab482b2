"""Dilution series: the line through the sessions' parameters, against numpy's weighted fit."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from labrig.models.series import Concentrations
from labrig.results import read_results, write_results
from labrig.series import fit_series

CONCENTRATION = {"milk-1": 0.5, "milk-2": 1.0, "milk-3": 1.5, "milk-4": 2.0, "milk-5": 3.0}
STD = {"sigma_t_per_mm": 0.002, "sigma_s_per_mm": 0.003, "g": 0.01}


def medium(concentration: float, rng: np.random.Generator, bend: float = 0.0) -> dict:
    """Return the parameters of a dilution, with noise; ``bend`` is of sigma_s."""
    truth = {
        "sigma_t_per_mm": 0.01 + 0.1 * concentration,
        "sigma_s_per_mm": 0.09 * concentration + bend * concentration**2,
        "g": 0.8,
    }
    return {
        name: {"value": value + STD[name] * rng.standard_normal(), "std": 0.6 * STD[name],
               "model_std": 0.8 * STD[name]}
        for name, value in truth.items()
    }  # fmt: skip


@pytest.fixture
def dilutions(tmp_path: Path):
    """Return ``dilutions(bend=0, **changes)``: results folders and the file of concentrations."""

    def make(bend: float = 0.0, seed: int = 5, **changes) -> list[Path]:
        rng = np.random.default_rng(seed)
        known = tmp_path / "concentration.yaml"
        lines = [f"  {name}: {value}" for name, value in CONCENTRATION.items()]
        known.write_text(
            "\n".join(["schema: labrig-series/1", "unit: ml/l", "concentration:", *lines]) + "\n"
        )
        folders = []
        for name, concentration in reversed(CONCENTRATION.items()):
            run = {
                "session": {"path": f"data/2026-01-05/{name}"},
                "length_unit": "mm",
                "method": {"parameters": "stripe-aware"},
                **medium(concentration, rng, bend),
                **changes.get(name.replace("-", "_"), {}),
            }
            folders.append(write_results(tmp_path / name, run, {}, {"schema": "labrig-fields/1"}))
        return [*folders, "--concentration", known, "--out", tmp_path / "series"]

    return make


def test_lines_are_those_of_a_weighted_fit(dilutions, command, tmp_path):
    said = command("series", *dilutions(), "--json")
    assert said.code == 0, said.err
    found = json.loads(said.out)
    assert found["sessions"] == list(CONCENTRATION)
    assert found["unit"] == "ml/l"
    assert found["notes"] == []
    x = np.array(found["concentration"])
    for name, line in found["lines"].items():
        std = np.hypot(0.6, 0.8) * np.full(x.size, STD[name])
        np.testing.assert_allclose(line["std"], std, rtol=1e-12)
        fitted, covariance = np.polyfit(x, line["value"], 1, w=1 / std, cov="unscaled")
        assert [line["slope"], line["intercept"]] == pytest.approx(fitted, rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(
            line["covariance"], covariance[::-1, ::-1], rtol=1e-9, atol=1e-15
        )
        curve, spread = np.polyfit(x, line["value"], 2, w=1 / std, cov="unscaled")
        assert line["bend"] == pytest.approx(curve[0], rel=1e-7, abs=1e-12)
        assert line["bend_std"] == pytest.approx(np.sqrt(spread[0, 0]), rel=1e-9)
        assert line["straight"]
    with (tmp_path / "series" / "series.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["session"] for row in rows] == list(CONCENTRATION)
    assert float(rows[2]["sigma_s_per_mm"]) == pytest.approx(
        found["lines"]["sigma_s_per_mm"]["value"][2], rel=1e-5
    )
    assert (tmp_path / "series" / "series.png").stat().st_size > 10_000


def test_the_probability_of_a_straight_line_is_even(dilutions):
    """Over noise it is spread evenly from 0 to 1 where the stated std is the true one."""
    found = []
    known = Concentrations(schema="labrig-series/1", unit="ml/l", concentration=CONCENTRATION)
    for seed in range(12):
        folders = dilutions(seed=seed)[: len(CONCENTRATION)]
        fitted = fit_series([read_results(folder) for folder in folders], known)
        found += [line.p_straight for line in fitted.lines]
    # measured mean 0.53; 36 even numbers have one of 0.5 with a std of 0.05
    assert np.mean(found) == pytest.approx(0.5, abs=0.15)
    assert min(found) < 0.2
    assert max(found) > 0.8


def test_a_bent_line_is_said(dilutions, command):
    said = command("series", *dilutions(bend=0.01))
    assert said.code == 0, said.err
    assert "note: sigma_s_per_mm does not follow a straight line" in " ".join(said.out.split())
    assert "sigma_t_per_mm does not" not in said.out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"g": {"value": None}}, "does not determine g"),
        ({"sigma_s_per_mm": None}, "holds no sigma_s_per_mm"),
        ({"length_unit": "px"}, "lengths in mm and px cannot be compared"),
        ({"session": {"path": "data/water"}}, "session water has no concentration"),
    ],
)
def test_what_cannot_be_compared_is_refused(dilutions, complaint, change, said):
    assert said in complaint("series", *dilutions(milk_3=change))


def test_too_few_are_refused(dilutions, complaint):
    arguments = dilutions()
    assert "need 3 or more" in complaint("series", *arguments[:2], *arguments[5:])
    same = [arguments[0]] * 2 + [arguments[1]]
    assert "2 different concentrations" in complaint("series", *same, *arguments[5:])
