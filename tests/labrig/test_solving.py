"""`labrig solve`: a scene file in, every bounce with its error out."""

import json
import math

import h5netcdf
import numpy as np
import pytest

import labrig
from analysis.transport.choose import relative_error
from labrig import solving
from labrig.cli import run

SCENE = """\
schema: labrig-scene/1
medium: {{sigma_t_per_mm: {sigma_t}, sigma_s_per_mm: {sigma_s}, g: {g}, phase: {phase}{more}}}
tank: {{depth_mm: 20, width_mm: 15}}
beam: {{from_mm: 5, to_mm: {to_mm}, angle_deg: {angle}{profile}}}
"""
GOOD = {
    "sigma_t": 0.3,
    "sigma_s": 0.24,
    "g": 0.4,
    "phase": "hg-plane",
    "more": "",
    "to_mm": 10,
    "angle": 0,
    "profile": "",
}


@pytest.fixture
def scene(tmp_path):
    def write(**changed):
        path = tmp_path / "scene.yaml"
        path.write_text(SCENE.format(**{**GOOD, **changed}))
        return path

    return write


def test_file_holds_the_bounces_with_their_axes(scene, tmp_path, capsys):
    out = tmp_path / "field.nc"
    code = run(["solve", str(scene(angle=20)), "--orders", "4", "--out", str(out), "--json"])
    said = json.loads(capsys.readouterr().out)
    assert code == 0
    assert said["engine"] == "ordinates"
    assert said["orders"] == 4
    assert max(said["error_estimate"]) <= 1e-3
    assert said["cpu_seconds"] > 0.0
    with h5netcdf.File(out, "r") as file:
        fluence, light = file["fluence"], file["light_field"]
        assert fluence.dimensions == ("bounce", "y", "x")
        assert light.dimensions == ("scattered_bounce", "y", "x", "theta")
        assert list(file["bounce"][...]) == [1, 2, 3, 4]
        assert list(file["scattered_bounce"][...]) == [2, 3, 4]
        assert file["error_estimate"].shape == (4,)
        assert file.attrs["beam_direction_rad"] == pytest.approx(math.radians(20))
        assert float(fluence[0].max()) == 1.0
        summed = 2 * np.pi / said["angles"] * light[...].sum(axis=-1)
        rms = [relative_error(a, b) for a, b in zip(summed, fluence[1:], strict=True)]
        # order 2 is summed over more directions than the light field has; the others round alike
        assert rms[0] < 5e-3
        assert max(rms[1:]) < 1e-6
    assert not list(tmp_path.glob(".*.part"))


def test_orders_follow_the_tolerance_and_carry_sigma_s(scene):
    solved = labrig.solve(labrig.load_scene(scene()), tolerance=1e-2)
    half = labrig.solve(
        labrig.load_scene(scene(sigma_s=0.12)), tolerance=1e-2, orders=solved.field.n_bounces
    )
    assert solved.field.n_bounces > 4
    k = np.arange(solved.field.n_bounces)
    # measured worst 3e-7: single precision
    np.testing.assert_allclose(
        half.field.fluence.max(axis=(1, 2)),
        solved.field.fluence.max(axis=(1, 2)) * 0.5**k,
        rtol=2e-6,
    )


def test_profile_of_the_beam_is_its_light(scene):
    path = scene(profile=", profile: [[5, 0.0], [10, 2.0]]")
    field = labrig.solve(labrig.load_scene(path), orders=2, tolerance=1e-2).field
    middle = field.fluence[0, :, 0]
    lit = (field.grid.y_mm > 5) & (field.grid.y_mm < 10)
    np.testing.assert_allclose(middle[lit], 0.4 * (field.grid.y_mm[lit] - 5.0), atol=1e-12)


def test_explanation_solves_nothing_and_prices_the_neighbours(scene, capsys, monkeypatch):
    monkeypatch.setattr(labrig, "solve", None)
    assert run(["solve", str(scene()), "--explain", "--orders", "5", "--json"]) == 0
    costs = json.loads(capsys.readouterr().out)
    assert [cost["tolerance"] for cost in costs] == pytest.approx([1e-2, 1e-3, 1e-4])
    assert all(cost["reason"] and cost["orders"] == 5 for cost in costs)
    assert [c["memory_bytes"] for c in costs] == sorted(c["memory_bytes"] for c in costs)
    assert [c["seconds"] for c in costs] == sorted(c["seconds"] for c in costs)


@pytest.mark.parametrize(
    ("changed", "options", "named"),
    [
        ({"sigma_t": ".nan"}, (), "finite"),
        ({"sigma_t": ".inf"}, (), "finite"),
        ({"g": 1.1}, (), "g = 1.1"),
        ({"sigma_t": -0.3}, (), "negative"),
        ({"sigma_s": 0.4}, (), "gain: allowed"),
        ({"to_mm": 16}, (), "leaves the tank"),
        ({}, ("--orders", "0"), "orders = 0"),
        ({}, ("--tolerance", "0"), "tolerance = 0"),
        ({}, ("--tolerance", "nan"), "tolerance = nan"),
        ({}, ("--engine", "rays"), "rays"),
        ({"g": 0.95, "phase": "hg-paper"}, (), "diverges"),
        ({"g": 1, "phase": "hg-paper"}, (), "infinite power"),
        ({"profile": ", profile: [[5, 1.0]]"}, (), "fewer than two"),
    ],
)
def test_nonsense_is_refused_in_one_line(scene, capsys, changed, options, named):
    assert run(["solve", str(scene(**changed)), *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert named in said.err


def test_gain_is_solved_where_it_is_asked_for(scene):
    field = labrig.solve(
        labrig.load_scene(scene(sigma_s=0.6, more=", gain: allowed")), orders=3, tolerance=1e-2
    ).field
    assert np.isfinite(field.fluence).all()


def test_more_memory_than_there_is_is_refused_with_the_figure(scene, capsys, monkeypatch):
    monkeypatch.setattr(solving, "memory_at_hand_bytes", lambda: 1e6)
    assert run(["solve", str(scene()), "--orders", "5", "--tolerance", "1e-4"]) == 2
    assert "GB are needed and 0.001 GB at hand" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_one_line(scene, tmp_path, capsys):
    out = tmp_path / "missing" / "field.nc"
    assert run(["solve", str(scene()), "--orders", "2", "--out", str(out)]) == 4
    assert capsys.readouterr().err.count("\n") == 1
