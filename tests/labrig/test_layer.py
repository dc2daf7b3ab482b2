"""A layer of liquid of known height: seen, analysed beside a plane, compared at two heights."""

import json

import numpy as np
import pytest

import labrig
from labrig.config import parse
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.reporting import report_page
from labrig.reporting.figures_slab import layer_figure
from labrig.session import Session
from labrig.steps.corrections import gather, shone
from labrig.steps.decay import attenuate
from labrig.steps.joint import fit_joint
from labrig.steps.linearise import linearise
from labrig.steps.rectify import rectify
from labrig.steps.separation import separate
from labrig.steps.slab import fit_layer

SCENE = """\
schema: labrig-scene/1
name: small
medium: {sigma_t_per_mm: 0.3, sigma_s_per_mm: 0.15, g: 0.3}
tank: {depth_mm: 30, width_mm: 24}
beam: {from_mm: 7.2, to_mm: 16.8}
light: {peak_e_per_s: 2.0e5, ambient_e_per_s: 300}
transport: {method: montecarlo, n_paths: 60000, cell_mm: 0.5, seed: 1}
"""
TRUTH = {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.15, "g": 0.3}
QUICK = "n_paths: 200000, cell_mm: 0.4"  # seconds of a Monte Carlo; finer light is in docs/slab.md


def layered(height_mm: float, *, more: str = "") -> str:
    """Return the small scene with liquid of a height."""
    tank = f"tank: {{depth_mm: 30, width_mm: 24, height_mm: {height_mm}{more}}}"
    text = SCENE.replace("tank: {depth_mm: 30, width_mm: 24}", tank)
    return text.replace("n_paths: 60000, cell_mm: 0.5", QUICK)


@pytest.fixture(scope="module")
def sessions(small_rig, small_plan, tmp_path_factory):
    """The same liquid at two heights, captured and analysed: 5 s of processor time each."""
    folder, found = tmp_path_factory.mktemp("layers"), []
    plan = labrig.load_plan(small_plan)
    for height, known in ((5.0, ", height_std_mm: 0.1, index_std: 0.02"), (2.0, "")):
        scene = folder / f"{height:g}.yaml"
        scene.write_text(layered(height, more=known))
        with labrig.open_rig(small_rig, labrig.load_scene(scene), plan) as rig:
            found.append(labrig.capture(plan, rig, folder))
        labrig.analyse(found[-1])
    return found


def test_the_medium_of_a_layer_is_found_where_a_plane_is_far_off(sessions):
    run = labrig.read_results(sessions[0]).run
    assert run["model"]["geometry"] == "slab"
    off = {name: run[name]["value"] - true for name, true in TRUTH.items()}
    plane = {name: run["alternatives"]["flatland"][name]["value"] for name in TRUTH}
    # measured 0.01 %, -2.8 % and +0.010 with so few paths; model_std is 0.7 % and 0.005
    assert abs(off["sigma_t_per_mm"]) < 0.005 * 0.3
    assert abs(off["sigma_s_per_mm"]) < 0.05 * 0.15
    assert abs(off["g"]) < 0.05
    # measured -23 %
    assert plane["sigma_s_per_mm"] < 0.85 * 0.15
    quality = run["quality"]["slab"]
    assert quality["chi2_per_dof_of_plane"] > 4.0 * quality["chi2_per_dof"]
    assert any("A height 5 % too large makes sigma_s -" in note for note in run["notes"])


def test_what_is_not_known_of_height_and_index_is_told_beside_the_noise(sessions, command):
    told, silent = (labrig.read_results(session).run for session in sessions)
    quality = told["quality"]["slab"]
    for k, name in enumerate(TRUTH):
        by = (0.1 * quality["by_height_per_mm"][k], 0.02 * quality["by_index"][k])
        assert told[name]["walls_std"] == pytest.approx(np.hypot(*by))
        assert "walls_std" not in silent[name]
    # 2 % of the height and 0.02 of index: measured 0.65 % of sigma_s, thrice the camera's noise
    assert told["sigma_s_per_mm"]["walls_std"] > 0.004 * 0.15
    said = command("analyse", sessions[0])
    assert said.code == 0, said.err
    assert "(height, index)" in said.out
    page = report_page.render(labrig.read_results(sessions[0]), [], TRUTH)
    assert "(height, index)" in page


def test_bounces_and_light_field_are_those_of_the_layer(sessions):
    result = labrig.read_results(sessions[0])
    fields = result.fields
    # a bearing's light, added up, is the fluence; clipped at the beam's edges: measured 2.1 %
    total = fields["light_field"].values.sum(axis=-1) * 2.0 * np.pi / 64
    middle = slice(8, 17)
    np.testing.assert_allclose(
        total[1, middle, 1:20], fields["layer_fluence"].values[2, middle, 1:20], rtol=0.02
    )
    # measured 4.5 %, the noise of the paths in each cell
    assert result.run["quality"]["slab"]["picture"]["rms_relative"] < 0.08
    assert result.attributes["geometry"] == "slab"


def test_the_report_shows_what_both_models_leave(sessions):
    result = labrig.read_results(sessions[0])
    text = report_page.render(result, [], TRUTH)
    assert "layer of 5 mm, surface index 1.33 (chosen)" in text
    assert "plane (flatland), effective parameters" in text
    drawn = layer_figure(result)
    assert [line.get_label() for line in drawn.axes[2].get_lines()[:2]] == ["layer", "plane"]


def test_two_fillings_expose_the_plane(sessions, command, tmp_path):
    said = command(
        "series", *sessions, "--heights", "--height-std-mm", "0.1", "--out", tmp_path, "--json"
    )
    assert said.code == 0, said.err
    found = json.loads(said.out)
    assert found["height_mm"] == [2.0, 5.0]
    sigma_s = found["parameters"]["sigma_s_per_mm"]
    # measured 0.1491 and 0.1457
    assert sigma_s["layer"][0] == pytest.approx(sigma_s["layer"][1], rel=0.06)
    # measured 1.38; the design says 1.3 to 1.7
    assert sigma_s["plane_ratio"] > 1.2
    assert (tmp_path / "heights.csv").read_text().count("\n") == 3
    assert (tmp_path / "heights.png").is_file()


def test_fillings_are_as_well_known_as_each_session_says(sessions, command, tmp_path):
    said = command("series", *sessions, "--heights", "--out", tmp_path, "--json")
    assert said.code == 0, said.err
    own = json.loads(said.out)
    # the session of 5 mm says 0.1 mm; that of 2 mm says nothing
    assert own["height_std_mm"] == [0.05, 0.1]
    assert "nobody said how well the height is known; 0.05 mm is taken" in own["notes"][0]
    run = labrig.read_results(sessions[0]).run["sigma_s_per_mm"]
    by_height = 0.1 * labrig.read_results(sessions[0]).run["quality"]["slab"]["by_height_per_mm"][1]
    wanted = np.linalg.norm([run["std"], run["model_std"], by_height])
    assert own["parameters"]["sigma_s_per_mm"]["layer_std"][1] == pytest.approx(wanted)
    said = command(
        "series", *sessions, "--heights", "--height-std-mm", "0", "--out", tmp_path, "--json"
    )
    assert json.loads(said.out)["height_std_mm"] == [0.0, 0.0]


def test_fillings_of_one_height_and_series_of_nothing_are_refused(
    sessions, small_session, complaint, tmp_path
):
    assert "two heights" in complaint("series", sessions[0], "--heights")
    assert "either" in complaint("series", *sessions, "--out", tmp_path)
    assert "0 mm" not in complaint("series", *sessions, "--heights", "--height-std-mm", "nan")
    labrig.analyse(small_session, out=tmp_path / "plane")
    plane = next((tmp_path / "plane").iterdir())
    assert "not analysed as a layer" in complaint("series", sessions[0], plane, "--heights")


def test_a_plane_says_what_looks_like_a_layer(sessions):
    session = Session.open(sessions[0])
    config = Analysis.model_validate({"schema": "labrig-analysis/1"})
    setup = parse(session.header["setup"], Setup, source="here")
    tank = setup.tank.model_copy(update={"height_mm": None, "surface_index": None})
    setup = setup.model_copy(update={"tank": tank})
    setup, known = shone(setup, gather(session, setup, config))
    pictures = rectify(linearise(session, setup, known), session, setup, known)
    decay = attenuate(separate(pictures, setup, config, known), pictures, setup, config)
    layer = fit_layer(pictures, setup, config, decay, fit_joint(pictures, setup, config, decay))
    assert layer is not None
    assert layer.fit is None
    assert "looks like light of a thin layer" in layer.notes[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (layered(0.0), "height 0.0 mm holds no liquid"),
        (layered(-1.0), "height -1.0 mm holds no liquid"),
        (layered(5.0, more=", surface_index: 0.9"), "surface_index = 0.9 is below one"),
        (layered(float("nan")).replace("nan", ".nan"), "finite number"),
        (layered(5.0, more=", surface_index: .inf"), "finite number"),
        (SCENE.replace("width_mm: 24", "width_mm: 24, surface_index: 1.3"), "height_mm"),
        (SCENE.replace("width_mm: 24", "width_mm: 24, height_std_mm: 0.1"), "height_mm"),
        (layered(5.0, more=", height_std_mm: -0.1"), "height_std_mm"),
        (layered(5.0).replace("g: 0.3", "g: 0.3, phase: hg-paper"), "leave phase out"),
        (layered(0.05), "thinner than the stripes' blur of 0.075 mm"),
        (layered(5.0).replace("16.8}", "16.8, angle_deg: 5}"), "angle_deg = 5"),
        (layered(5.0).replace("method: montecarlo", "method: ordinates"), "plain Monte Carlo"),
    ],
)
def test_impossible_layers_are_refused_in_one_line(
    text, words, complaint, small_rig, small_plan, tmp_path
):
    scene = tmp_path / "scene.yaml"
    scene.write_text(text)
    assert words in complaint("simulate", scene, "--plan", small_plan, "--rig", small_rig)


def test_stripes_finer_than_two_pixels_are_refused(
    complaint, small_rig, small_plan, small_scene, tmp_path
):
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        small_plan.read_text().replace("period_px: 12, shifts: 6", "period_px: 2, shifts: 2")
    )
    said = complaint("simulate", small_scene, "--plan", plan, "--rig", small_rig)
    assert "shorter than two camera pixels" in said


def test_the_rig_may_say_how_high_the_liquid_stands(complaint, small_rig, small_plan, tmp_path):
    rig, scene = tmp_path / "rig.yaml", tmp_path / "scene.yaml"
    rig.write_text(small_rig.read_text() + "tank: {height_mm: 5}\n")
    told = labrig.load_rig(rig)
    assert (told.tank.height_mm, told.tank.surface_index) == (5.0, 1.33)
    scene.write_text(layered(4.0))
    said = complaint("simulate", scene, "--plan", small_plan, "--rig", rig)
    assert "4 mm high" in said
    assert "the rig's 5" in said
    rig.write_text(small_rig.read_text() + "tank: {height_mm: -5}\n")
    assert "holds no liquid" in complaint("simulate", scene, "--plan", small_plan, "--rig", rig)


def test_what_computes_in_a_plane_refuses_a_layer(complaint, tmp_path):
    scene = tmp_path / "scene.yaml"
    scene.write_text(layered(5.0))
    for options in (("--engine", "ordinates"), ("--engine", "plane", "--explain")):
        said = complaint("solve", scene, *options)
        assert "choose auto or montecarlo, or leave tank.height_mm out" in said
    said = complaint("solve", scene, "--engine", "montecarlo", "--tolerance", "1e-5", "--orders", 2)
    assert "would need" in said


def test_what_a_layer_costs_is_told_before_it_is_solved(command, tmp_path):
    scene = tmp_path / "scene.yaml"
    scene.write_text(layered(5.0))
    asked = ("solve", scene, "--orders", 5, "--explain")
    costs = json.loads(command(*asked, "--json").out)
    assert [cost["tolerance"] for cost in costs] == pytest.approx([1e-2, 1e-3, 1e-4])
    assert all("polynomials over the height" in cost["reason"] for cost in costs)
    for name in ("angles", "memory_bytes", "seconds"):
        assert costs[0][name] < costs[1][name] < costs[2][name]
    assert "Times are of all grids" in command("solve", scene, "--explain").out
    paths = json.loads(command("solve", scene, "--explain", "--engine", "montecarlo", "--json").out)
    assert paths[1]["seconds"] is None
    # all but the tail of the light, at an albedo of one half
    assert 5 <= paths[1]["orders"] <= 12


def test_the_monte_carlo_solves_a_layer_too(tmp_path):
    scene = tmp_path / "scene.yaml"
    scene.write_text(layered(5.0))
    told = labrig.load_scene(scene)
    sampled = labrig.solve(told, engine="montecarlo", tolerance=0.1, orders=3).field
    assert (sampled.engine, sampled.light_field) == ("montecarlo", None)
    assert sampled.error_estimate.max() <= 0.1
    solved = labrig.solve(told, tolerance=1e-2, orders=3).field
    for one, other in zip(sampled.fluence, solved.fluence, strict=True):
        middle = one[one.shape[0] // 2 - 8 : one.shape[0] // 2 + 8, :30].mean(axis=0)
        row = other[other.shape[0] // 2, :31]
        # PLACE
        np.testing.assert_allclose(middle, 0.5 * (row[1:] + row[:-1]), rtol=0.05)


def test_a_layer_is_solved_to_a_tolerance(command, tmp_path):
    scene = tmp_path / "scene.yaml"
    scene.write_text(layered(5.0))
    said = command("solve", scene, "--tolerance", "1e-2", "--orders", "4", "--json")
    assert said.code == 0, said.err
    found = json.loads(said.out)
    assert (found["engine"], found["orders"]) == ("slab", 4)
    assert max(found["error_estimate"]) <= 1e-2
