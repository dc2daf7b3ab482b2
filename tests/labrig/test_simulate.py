"""What a scene asks for is what is simulated, and no more."""

import json
import subprocess
import sys

import h5netcdf
import numpy as np
import pytest

import labrig
from labrig.accuracy.scene import cost_of_realism
from labrig.config import parse
from labrig.errors import ConfigError, PlanError
from labrig.scene import transport
from labrig.scene.decide import decide, situation_of
from labrig.scene.explain import begins_of, change, exposed, lit_images
from labrig.scene.pipeline import Seen, see
from labrig.scene.registry import ENTRIES
from labrig.scene.response import bounces_needed, bounces_of
from labrig.simulating import simulate, told_as_json

SIX = labrig.config_folder() / "plans" / "six-shifts.yaml"
IDEAL = labrig.config_folder() / "scenes" / "ideal.yaml"
ALONE = """
import sys
from labrig.cli import run
assert run(sys.argv[1:]) == 0
loaded = [name for name in sys.modules if name.startswith("analysis.transport.")]
assert not loaded, loaded
assert "numba" not in sys.modules
assert not [name for name in sys.modules if name == "labrig.scene.response"]
"""


def scene_of(effects: dict | None, **changes) -> labrig.Scene:
    content = {
        "schema": "labrig-scene/1",
        "name": "here",
        "medium": {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.15, "g": 0.3},
        "tank": {"depth_mm": 30, "width_mm": 24},
        "beam": {"from_mm": 7.2, "to_mm": 16.8},
        "light": {"peak_e_per_s": 2.0e5, "ambient_e_per_s": 300.0},
        "transport": {"n_paths": 16000, "cell_mm": 0.5},
        **({} if effects is None else {"effects": effects}),
        **changes,
    }
    return parse(content, labrig.Scene, source="here")


@pytest.fixture
def rig(small_rig) -> labrig.Rig:
    return labrig.load_rig(small_rig)


@pytest.fixture
def plan(small_plan) -> labrig.Plan:
    return labrig.load_plan(small_plan)


FAINT = {
    "single-scattering": "always",
    "projector-blur": {"sigma_px": 0.002},
    "black-leak": {"share": 2e-4},
    "lamp-shape": {"falloff": 1e-3},
    "lamp-drift": {"drift_per_h": 0.02},
    "colour-wheel": {"flicker": 0.02, "flicker_hz": 600.0},
    "fresnel": {"index": 1.0, "glass_index": 1.04},
    "divergence": {"half_angle_deg": 1e-7},
    "refraction": {"outside_deg": 1e-7, "index": 1.33},
    "multiple-scattering": "auto",
    "anisotropy": "auto",
    "ambient": {"e_per_s": 10.0},
    "oblique-view": {"tilt_deg": 1e-6, "distance_mm": 400},
    "distortion": {"k1": 1e-9},
    "lens-blur": {"sigma_px": 1e-3},
    "vignetting": {"half_field_deg": 1.0},
    "hot-pixels": {"number": 1, "e_per_s": 1000.0},
    "saturation": "auto",
    "quantisation": "auto",
}
THIN = {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 3e-4, "g": 0.3}


def test_the_ideal_scene_loads_neither_solver_nor_kernels():
    arguments = ["simulate", str(IDEAL), "--plan", str(SIX), "--explain", "--json"]
    done = subprocess.run(
        [sys.executable, "-c", ALONE, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["transport"], told["bounces"]) == ("none", 1)


def test_only_scenes_with_multiple_scattering_come_to_the_transport(rig, plan, monkeypatch):
    calls, solved = [], transport.answer_of

    def counted(*given, **named):
        calls.append(given)
        return solved(*given, **named)

    monkeypatch.setattr(transport, "answer_of", counted)
    single = {"single-scattering": "always", "walls": {"reflectance": 0.1}}
    both = {"single-scattering": "always", "multiple-scattering": "auto"}
    simulate(scene_of(single), rig, plan, explained=True)
    simulate(scene_of(both, medium=THIN, tolerance=0.1), rig, plan, explained=True)
    assert len(calls) == 0  # the tolerance does without it
    simulate(scene_of(both), rig, plan)
    assert len(calls) == 1


def test_a_looser_tolerance_follows_no_more_bounces_and_no_more_waves():
    before = 400
    for tolerance in (1e-5, 1e-3, 5e-3, 0.05, 0.5):
        bounces = bounces_of(scene_of(None, tolerance=tolerance))
        assert bounces <= before
        before = bounces
    assert bounces_of(scene_of(None)) == bounces_needed(0.5, 1e-3)
    assert bounces_of(scene_of(None, transport={"tail": 0.5})) == 2


def test_forcing_all_that_was_left_out_changes_less_than_the_tolerance(rig, plan):
    scene = scene_of(FAINT, medium=THIN, tolerance=0.1)
    about, images = situation_of(scene, rig, plan), lit_images(plan, rig)
    plain = see(scene, rig, plan)
    left_out = tuple(d.name for d in plain.decisions if not d.used)
    assert len(left_out) >= 15
    forced = see(scene, rig, plan, force=left_out)
    assert all(d.used for d in forced.decisions)

    def pictures(seen: Seen) -> dict[str, np.ndarray]:
        return exposed(seen.picture, images, about)

    moved = change(pictures(plain), pictures(forced))
    # measured 0.0021
    assert 1e-4 < moved < scene.tolerance


def test_a_looser_tolerance_leaves_out_all_that_a_stricter_one_does(rig, plan):
    before: set[str] = set()
    for tolerance in (1e-6, 1e-4, 1e-3, 1e-2, 0.1, 0.5):
        about = situation_of(scene_of(FAINT, medium=THIN, tolerance=tolerance), rig, plan)
        decisions = decide(about)
        left_out = {d.name for d in decisions if not d.used}
        assert before <= left_out
        auto = [d for d in decisions if d.name in left_out and d.bound > 0.0]
        assert sum(d.bound for d in auto) <= tolerance
        before = left_out
    assert "single-scattering" not in before


def test_the_order_in_which_effects_are_listed_changes_nothing(rig, plan):
    effects = {**FAINT, "shot-noise": "auto", "read-noise": "auto", "lens-blur": {"sigma_px": 1.0}}
    turned = dict(reversed(effects.items()))
    one, other = (simulate(scene_of(e, medium=THIN), rig, plan) for e in (effects, turned))
    assert [d.name for d in one.seen.decisions] == [d.name for d in other.seen.decisions]
    for name, light in one.light.items():
        np.testing.assert_array_equal(light, other.light[name])


def test_a_scene_that_names_no_effects_has_what_rig_and_scene_speak_of(rig, plan):
    seen = see(scene_of(None), rig, plan)
    summary = seen.summary()
    assert summary["transport"] == "montecarlo"
    assert {"multiple-scattering", "shot-noise", "ambient", "black-leak"} <= set(summary["used"])
    sensor = seen.picture.parts.sensor
    assert sensor is not None
    assert (sensor.shot_noise, sensor.read_noise_e, sensor.quantised) == (True, 10.9, True)


def test_what_is_told_is_measured(rig, plan):
    effects = {
        "single-scattering": "always",
        "black-leak": "always",
        "multiple-scattering": "auto",
        "vignetting": {"half_field_deg": 20.0},
        "shot-noise": "auto",
        "projector-gamma": {"gamma": 2.2},
    }
    found = simulate(scene_of(effects), rig, plan, explained=True)
    told = {entry["name"]: entry for entry in told_as_json(found)["effects"]}
    assert told["projector-gamma"]["used"] is False  # the plan shows black and white alone
    assert "nothing to do" in told["projector-gamma"]["why"]
    assert told["projector-gamma"]["rms_percent"] is None
    black = found.seen.picture.light(np.zeros((24, 640), np.uint8), 0.01)
    share = 100.0 * np.sqrt(np.mean(black**2) / np.mean(found.light["stripes-12px"] ** 2))
    assert 0.3 * share < told["black-leak"]["rms_percent"] < share
    assert 5.0 < told["multiple-scattering"]["rms_percent"] < 100.0
    assert told["vignetting"]["rms_percent"] < 100.0 * told["vignetting"]["bound"] * 1.3
    for name in ("black-leak", "vignetting", "shot-noise"):
        assert told[name]["rms_percent"] / 100.0 < told[name]["bound"] * 1.3, name


EVERY = {
    "single-scattering": "always",
    "projector-gamma": {"gamma": 2.2},
    "black-leak": "always",
    "projector-blur": "always",
    "defocus": {"px_per_mm": 0.02},
    "lamp-shape": {"falloff": 0.2},
    "lamp-drift": {"cold_share": 0.1, "drift_per_h": 0.5},
    "colour-wheel": {"flicker": 0.3, "flicker_hz": 10.0},
    "refraction": {"outside_deg": 10.0},
    "fresnel": {"index": 1.33},
    "divergence": {"half_angle_deg": 1.0},
    "multiple-scattering": "always",
    "anisotropy": "always",
    "internal-reflection": {"index": 1.33},
    "walls": {"reflectance": 0.05},
    "ambient": "always",
    "lens-blur": {"sigma_px": 1.0},
    "oblique-view": {"tilt_deg": 5.0, "distance_mm": 200},
    "distortion": {"k1": 0.05},
    "vignetting": {"half_field_deg": 20.0},
    "rolling-shutter": {"row_time_s": 1e-4},
    "hot-pixels": {"number": 20, "e_per_s": 50_000.0},
    "shot-noise": "always",
    "read-noise": "always",
    "blooming": {"share": 0.5},
    "response": {"curve": "srgb"},
    "saturation": "always",
    "quantisation": "always",
}


def test_of_every_effect_it_is_told_what_it_changes_and_costs(rig):
    stripes = {"kind": "stripes", "period_px": 12, "shifts": 6, "low": 51}
    grey = {"schema": "labrig-plan/1", "name": "grey", "exposures": {"bracket_s": [0.2]}}
    sets = [{"id": "stripes", "pattern": stripes}, {"id": "white", "pattern": {"kind": "uniform"}}]
    plan = parse({**grey, "sets": sets}, labrig.Plan, source="plan")
    camera = rig.camera.model_copy(update={"rows": 80, "cols": 96})
    view = {"mm_per_px": 0.4, "region_px": (10, 10, 75, 60)}
    geometry = rig.geometry.model_copy(update=view)
    rig = rig.model_copy(update={"camera": camera, "geometry": geometry})
    few = {"n_paths": 1000, "cell_mm": 2.0}
    scene = scene_of(EVERY, tolerance=1e-3, transport={**few, "tail": 0.1})
    found = simulate(scene, rig, plan, explained=True)
    assert [t.decision.name for t in found.told] == [entry.name for entry in ENTRIES]
    for told in found.told:
        assert told.decision.used, told.decision.name
        assert told.rms_percent is not None
        # charge that blooms, and sRGB counts, end at the white level by themselves
        assert told.rms_percent > 0.0 or told.decision.name == "saturation", told.decision.name
        assert told.seconds is not None
        assert told.seconds >= 0.0


def test_what_multiple_scattering_cost_is_told_although_it_was_kept(
    rig, plan, tmp_path, monkeypatch
):
    monkeypatch.setenv("LABRIG_CACHE", str(tmp_path))
    effects = {"single-scattering": "always", "multiple-scattering": "always"}
    scene = scene_of(effects, transport={"n_paths": 8000, "cell_mm": 1.0})
    fresh, kept = (simulate(scene, rig, plan, explained=True) for _ in range(2))
    answers = [one.seen.picture.answer for one in (fresh, kept)]
    assert [one.from_cache for one in answers if one] == [False, True]
    assert answers[0].seconds == answers[1].seconds > 0.0
    assert kept.told[1].seconds > 0.5 * answers[0].seconds


def test_bad_words_of_a_scene_are_refused_in_one_line(rig, plan):
    with pytest.raises(ConfigError, match=r"'effects\.lens-blurr' is unknown; did you mean"):
        scene_of({"lens-blurr": {"sigma_px": 1.0}})
    with pytest.raises(ConfigError, match=r"'effects\.lens-blur': a mapping of its own keys"):
        scene_of({"lens-blur": "auto"})
    with pytest.raises(ConfigError, match="less than or equal to 100"):
        scene_of({"lens-blur": {"sigma_px": 1e9}})
    with pytest.raises(ConfigError, match="leave it at 0"):
        scene_of(
            {"refraction": {"outside_deg": 5.0}}, beam={"from_mm": 7, "to_mm": 9, "angle_deg": 5}
        )
    with pytest.raises(PlanError, match="effect 'sparkle' is not among those of the scene"):
        see(scene_of({"single-scattering": "always"}), rig, plan, force=("sparkle",))


def test_the_command_tells_forces_and_writes(command, small_rig, small_plan, tmp_path):
    scene = tmp_path / "scene.yaml"
    content = scene_of({"single-scattering": "auto", "ambient": {"e_per_s": 1.0}})
    scene.write_text(content.model_dump_json(by_alias=True, exclude_none=True))
    out = tmp_path / "light.nc"
    given = ("simulate", scene, "--plan", small_plan, "--rig", small_rig)
    said = command(*given, "--explain", "--out", out)
    assert said.code == 0
    assert "ambient" in said.out
    assert "1 of 2 effects used" in said.out
    with h5netcdf.File(out, "r") as file:
        assert file.attrs["transport"] == "none"
        assert file["white"].shape == (160, 192)
        assert float(np.max(file["single"][...])) == pytest.approx(2.0e5, rel=0.05)
        assert not np.any(file["multiple"][...])
    forced = command(*given, "--force", "ambient", "--json")
    told = {entry["name"]: entry for entry in json.loads(forced.out)["effects"]}
    assert told["ambient"]["used"] is True
    bad = command(*given, "--force", "sparkle")
    assert bad.code == 2
    assert "sparkle" in bad.err


def test_a_session_says_how_its_light_was_made(rig, plan, tmp_path):
    scene = scene_of(None, transport={"method": "ordinates"}, medium=THIN, tolerance=1e-5)
    with labrig.open_rig(rig, scene, plan) as opened:
        session = labrig.capture(plan, opened, tmp_path)
    header = labrig.Session.open(session).header
    assert header["simulation"]["transport"] == "ordinates"
    assert "multiple-scattering" in header["simulation"]["used"]
    assert header["simulation"]["left_out"]["response"].startswith("nothing to do")


GALLERY = sorted(path.stem for path in (labrig.config_folder() / "scenes").glob("*.yaml"))


def gallery(name: str) -> tuple[labrig.Scene, labrig.Rig, labrig.Plan]:
    """Return a scene of the gallery on 144 x 192 px of 0.625 mm, its light by few paths."""
    folder = labrig.config_folder()
    scene = labrig.load_scene(folder / "scenes" / f"{name}.yaml")
    rig = labrig.load_rig(
        folder / "rigs" / f"{'webcam' if name == 'noisy-webcam' else 'simulated'}.yaml"
    )
    camera = rig.camera.model_copy(update={"rows": 144, "cols": 192, "hot_pixels": 2})
    view = {"mm_per_px": 0.625, "region_px": (16, 13, 160, 120)}
    geometry = rig.geometry.model_copy(update=view)
    few = scene.transport.model_copy(
        update={"method": "montecarlo", "n_paths": 4000, "cell_mm": 2.5}
    )
    return (
        scene.model_copy(update={"transport": few}),
        rig.model_copy(update={"camera": camera, "geometry": geometry}),
        labrig.load_plan(SIX),
    )


@pytest.mark.parametrize("name", GALLERY)
def test_the_gallery_can_do_without_what_it_leaves_out(name):
    scene, rig, plan = gallery(name)
    about, images = situation_of(scene, rig, plan), lit_images(plan, rig)
    plain = see(scene, rig, plan)
    left_out = tuple(d.name for d in plain.decisions if not d.used)
    forced = see(scene, rig, plan, force=left_out)
    begins_s = begins_of(about, plain.picture, forced.picture)
    one, other = (
        exposed(seen.picture, images, about, begins_s, noisy=False) for seen in (plain, forced)
    )
    # measured worst 0.002, of a tolerance of 0.005
    assert change(one, other) < scene.tolerance
    assert not {"shot-noise", "read-noise"} & set(left_out)  # which are not looked at here
    assert name in ("ideal", "refracting-face") or left_out


def test_realism_is_bought_step_by_step(rig, plan):
    effects = {
        "single-scattering": "auto",
        "projector-blur": "auto",
        "black-leak": "auto",
        "ambient": "auto",
        "multiple-scattering": "auto",
        "anisotropy": "auto",
    }
    found = cost_of_realism(scene_of(effects), rig, plan, lambda *_: None)
    names = [step.name for step in found.steps]
    assert names[:2] == ["single-scattering", "multiple-scattering"]
    assert sorted(names[2:]) == ["ambient", "black-leak", "projector-blur"]
    errors = [step.error for step in found.steps]
    assert errors[-1] == 0.0
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 0.1
    assert [step.transport_s > 0.0 for step in found.steps] == [False, True, True, True, True]
    assert found.left_out == 0.0


def test_the_command_draws_what_realism_costs(command, small_rig, small_plan, tmp_path):
    scene = tmp_path / "scene.yaml"
    content = scene_of({"single-scattering": "auto", "ambient": "auto"})
    scene.write_text(content.model_dump_json(by_alias=True, exclude_none=True))
    given = ("--plan", small_plan, "--rig", small_rig, "--out", tmp_path / "out")
    said = command("accuracy", "scene", scene, *given)
    assert said.code == 0, said.err
    assert "single-scattering" in said.out
    assert (tmp_path / "out" / "scene.png").stat().st_size > 10_000
