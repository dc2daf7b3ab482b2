"""What the simulated camera sees, against integrals done another way."""

import math

import numpy as np
import pytest

import labrig
from analysis.errors import AnalysisError
from labrig.config import parse
from labrig.errors import PlanError, RunError
from labrig.patterns import draw
from labrig.plan import kinds_of_stripes, stripes_of
from labrig.scene.picture import Picture
from labrig.scene.pipeline import see
from labrig.scene.response import bounces_needed, tank_response
from labrig.scene.transport import answer_of

FOLDER = labrig.config_folder()
PERIOD_PX = 12
PERIOD_MM = PERIOD_PX * 0.15


def scene_of(**changes) -> labrig.Scene:
    content = {
        "schema": "labrig-scene/1",
        "medium": {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.15, "g": 0.3},
        "tank": {"depth_mm": 20, "width_mm": 15},
        "beam": {"from_mm": 4, "to_mm": 11},
        "light": {"peak_e_per_s": 1000.0, "ambient_e_per_s": 7.0},
        "transport": {"n_paths": 16000, "cell_mm": 0.5},
        **changes,
    }
    return parse(content, labrig.Scene, source="here")


def rig_of(side: str = "left") -> labrig.Rig:
    rig = labrig.load_rig(FOLDER / "rigs" / "simulated.yaml")
    region = (12, 5, 200, 150) if side in {"left", "right"} else (12, 5, 150, 200)
    geometry = rig.geometry.model_copy(update={"region_px": region, "lit_side": side})
    camera = rig.camera.model_copy(update={"rows": 220, "cols": 230})
    return rig.model_copy(update={"geometry": geometry, "camera": camera})


def plan_of(*periods_px: int) -> labrig.Plan:
    sets = [
        {"id": f"s{period}", "pattern": {"kind": "stripes", "period_px": period, "shifts": 6}}
        for period in periods_px
    ]
    content = {
        "schema": "labrig-plan/1",
        "name": "here",
        "exposures": {"bracket_s": [0.05]},
        "sets": [*sets, {"id": "white", "pattern": {"kind": "uniform"}}],
    }
    return parse(content, labrig.Plan, source="here")


def seen(scene: labrig.Scene | None = None, rig: labrig.Rig | None = None) -> Picture:
    return see(scene or scene_of(), rig or rig_of(), plan_of(PERIOD_PX)).picture


@pytest.fixture(scope="module")
def picture():
    return seen()


def stripes(shift: int) -> np.ndarray:
    plan = labrig.load_plan(FOLDER / "plans" / "six-shifts.yaml")
    image = draw(stripes_of(plan), 720, 1280, shift)
    assert image is not None
    return image


WHITE = np.full((720, 1280), 255, np.uint8)


def test_single_scattering_under_white_is_the_exponential_inside_the_beam(picture):
    truth = picture.truth(0.0)
    x = (np.arange(200) + 0.5) * 0.1
    rows = slice(50, 100)  # 5 to 10 mm, inside 4 to 11
    expected = 1000.0 * np.exp(-0.3 * x)
    # measured worst 4e-5: a pixel's mean of the exponential against its middle
    np.testing.assert_allclose(truth.single[rows].mean(axis=0), expected, rtol=1e-4)
    assert truth.single[:39].max() == 0.0
    assert truth.single[111:].max() == 0.0


def test_shifted_stripes_together_are_half_the_white_light(picture):
    together = sum(picture.light(stripes(k), 0.0) for k in range(6)) / 6 - 7.0
    white = picture.light(WHITE, 0.0) - 7.0
    inside = white > 0.01 * white.max()
    # measured worst 7e-16
    np.testing.assert_allclose(together[inside], 0.5 * white[inside], rtol=1e-9)


def test_light_is_linear_in_the_projectors_leak(picture):
    lit, dark = picture.light(WHITE, 0.0), picture.light(np.zeros_like(WHITE), 0.25)
    np.testing.assert_allclose(dark - 7.0, 0.25 * (lit - 7.0), rtol=1e-6, atol=1e-9)


def test_a_lamp_that_is_off_leaves_the_ambient_light(picture):
    assert (picture.light(None, 0.5) == 7.0).all()


def test_stripes_in_the_picture_have_the_contrast_of_the_blur(picture):
    amplitude, mean = 0.0, 0.0
    y = (np.arange(150) + 0.5) * 0.1
    column = picture._single(stripes(0)[0] / 255.0)[50:86, 0]  # two periods
    wave = np.exp(-2j * np.pi * y[50:86] / 1.8)
    amplitude, mean = 2 * abs((column * wave).mean()), column.mean()
    turn = 2 * np.pi / PERIOD_PX
    pixel = np.sinc(0.1 / 0.15 / PERIOD_PX)
    expected = 2 / math.pi * math.exp(-0.5 * (turn * 0.5) ** 2) * pixel
    # measured 6e-5
    assert amplitude / (2 * mean) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("side", ["right", "top", "bottom"])
def test_the_lit_side_turns_the_picture_and_nothing_else(picture, side):
    other = seen(rig=rig_of(side)).light(stripes(1), 0.0)
    left = picture.light(stripes(1), 0.0)[5:155, 12:212]
    if side == "right":
        np.testing.assert_array_equal(other[5:155, 12:212], left[:, ::-1])
    else:
        turned = other[5:205, 12:162]
        np.testing.assert_array_equal(turned if side == "top" else turned[::-1], left.T)


def test_a_slanted_beam_carries_its_stripes_along():
    scene = scene_of(beam={"from_mm": 2, "to_mm": 6, "angle_deg": 30.0})
    single = seen(scene).truth(0.0).single
    middle = np.array([np.mean(np.flatnonzero(column > 0)) for column in single[:, :150:20].T])
    drift = (middle - middle[0]) * 0.1
    expected = np.arange(0, 150, 20) * 0.1 * math.tan(math.radians(30.0))
    # measured worst 0.064 mm, less than a pixel
    np.testing.assert_allclose(drift, expected, atol=0.1)
    assert single[:, 150].max() / single[:, 0].max() == pytest.approx(
        math.exp(-0.3 * 15.0 / math.cos(math.radians(30.0))), rel=0.01
    )


def test_the_response_is_kept_and_a_damaged_copy_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("LABRIG_CACHE", str(tmp_path))
    scene = scene_of(transport={"n_paths": 1600, "cell_mm": 1.0})
    first = tank_response(scene, period_mm=1.8)
    again = tank_response(scene, period_mm=1.8)
    assert (first.from_cache, again.from_cache) == (False, True)
    np.testing.assert_array_equal(first.field.modulated, again.field.modulated)
    assert not tank_response(scene, period_mm=2.0).from_cache
    for kept in (tmp_path / "labrig").iterdir():
        kept.write_bytes(kept.read_bytes()[:500])
    assert not tank_response(scene, period_mm=1.8).from_cache


def test_the_noise_that_is_told_is_that_of_other_seeds():
    one, other = (
        seen(scene_of(transport={"n_paths": 16000, "cell_mm": 0.5, "seed": seed}))
        for seed in (3, 4)
    )
    moved = one.truth(0.0).multiple - other.truth(0.0).multiple
    light = one.truth(0.0).single + one.truth(0.0).multiple
    scatter = math.sqrt(0.5 * np.mean(moved**2) / np.mean(light**2))
    # the bounces' noise is not all the same, and pixels lie between cells: measured 0.81
    assert 0.6 * one.noise() < scatter < one.noise()
    assert seen(scene_of(transport={"method": "ordinates"})).noise() == 0.0


def test_bounces_end_where_the_albedo_says():
    assert bounces_needed(0.5, 1e-3) == 10
    assert bounces_needed(0.0, 1e-3) == 2
    assert bounces_needed(1.0, 1e-3) == 400


def test_the_literal_phase_function_ends_sooner_or_never(tmp_path, monkeypatch):
    monkeypatch.setenv("LABRIG_CACHE", str(tmp_path))
    medium = {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.15, "g": 0.4, "phase": "hg-paper"}
    quick = {"n_paths": 1600, "cell_mm": 1.0}
    # N3(0.4) = 0.619296, and 0.309648^6 is the first below 1e-3
    assert tank_response(scene_of(medium=medium, transport=quick), period_mm=1.8).n_bounces == 6
    with pytest.raises(AnalysisError, match=r"hg-paper at g = 0\.9.*choose hg-plane") as caught:
        tank_response(scene_of(medium={**medium, "g": 0.9}, transport=quick), period_mm=1.8)
    assert "\n" not in str(caught.value)


def test_pictures_the_response_does_not_know_are_refused(picture):
    uneven = WHITE.copy()
    uneven[:, 100:] = 3
    with pytest.raises(RunError, match="does not repeat every 12 px"):
        picture.light(uneven, 0.0)
    with pytest.raises(RunError, match="varies along y"):
        picture.light(
            np.ascontiguousarray(WHITE * (np.arange(720) % 2)[:, None].astype(np.uint8)), 0.0
        )
    with pytest.raises(PlanError, match="the scene's tank is"):
        seen(scene_of(tank={"depth_mm": 30, "width_mm": 15}))


def test_a_projector_that_does_not_light_the_whole_beam_is_refused(picture):
    narrow = rig_of()
    narrow = narrow.model_copy(
        update={"projector": narrow.projector.model_copy(update={"cols": 440})}
    )
    with pytest.raises(PlanError, match="not the whole beam"):
        seen(rig=narrow)


def test_a_plan_may_hold_stripes_of_several_periods(picture):
    both = see(scene_of(), rig_of(), plan_of(PERIOD_PX, 24)).picture
    # the answer to each period does not know of the other
    np.testing.assert_array_equal(both.light(stripes(1), 0.0), picture.light(stripes(1), 0.0))
    wide = np.zeros((720, 1280), np.uint8)
    wide[:, np.arange(1280) % 24 < 12] = 255
    alone = see(scene_of(), rig_of(), plan_of(24)).picture.light(wide, 0.0)
    np.testing.assert_array_equal(both.light(wide, 0.0), alone)
    assert both.answer.harmonics(PERIOD_MM) == (1, 3)
    assert both.answer.harmonics(2 * PERIOD_MM)[:2] == (1, 3)
    assert [s.period_px for s in kinds_of_stripes(plan_of(24, PERIOD_PX))] == [12, 24]


def test_a_sharp_projector_and_a_strict_tolerance_call_for_more_waves():
    scene = scene_of()
    rig = rig_of()
    sharp = rig.model_copy(update={"projection": rig.projection.model_copy(update={"blur_px": 0})})
    parts = seen(scene, sharp).parts
    loose = answer_of(parts, (PERIOD_PX,), tolerance=0.05).harmonics(PERIOD_MM)
    strict = answer_of(parts, (PERIOD_PX,), tolerance=1e-4).harmonics(PERIOD_MM)
    assert loose == (1, 3)
    assert strict[:4] == (1, 3, 5, 7)
    # with all waves the picture's stripes are those of the projector: each shift of the white
    together = Picture(parts, answer_of(parts, (PERIOD_PX,), tolerance=1e-4), periods_px=(12,))
    total = sum(together.parted(stripes(k), 0.0)[1] for k in range(6)) / 3
    white = together.parted(WHITE, 0.0)[1]
    bright = white > 0.05 * white.max()
    # measured worst 3e-16: what the six shifts add up to holds no wave below the sixth
    np.testing.assert_allclose(total[bright], white[bright], rtol=1e-9)


@pytest.mark.parametrize("angle_deg", [0.0, 20.0])
def test_the_solver_and_the_monte_carlo_light_a_scene_alike(angle_deg):
    beam = {"from_mm": 4, "to_mm": 11, "angle_deg": angle_deg}
    sampled = seen(scene_of(beam=beam, transport={"n_paths": 200_000, "cell_mm": 0.5}))
    solved = seen(scene_of(beam=beam, transport={"method": "ordinates"}))
    assert (sampled.truth(0.0).method, solved.truth(0.0).method) == ("montecarlo", "ordinates")
    # measured worst 0.032: noise of the Monte Carlo, and its cells where the beam ends
    for image in (WHITE, stripes(2)):
        one, other = sampled.parted(image, 0.0)[1], solved.parted(image, 0.0)[1]
        miss = math.sqrt(np.mean((one - other) ** 2) / np.mean(one**2))
        assert miss < 0.04
    n = min(one.truth(0.0).bounces.shape[0] for one in (sampled, solved))
    power = [one.truth(0.0).bounces[:n].mean(axis=(1, 2)) for one in (sampled, solved)]
    # nodes on the walls count half of what cells do: the two means differ by the grid's edge
    np.testing.assert_allclose(power[0][:3], power[1][:3], rtol=0.05)
