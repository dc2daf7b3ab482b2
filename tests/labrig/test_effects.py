"""Each effect alone, against its own truth."""

import math

import numpy as np
import pytest
from scipy.special import erf, erfinv

import labrig
from calibration.response import srgb_response
from drivers.simulation.lamp import Lamp
from drivers.simulation.sensor import Noise, Sensor, bloom
from drivers.simulation.world import World
from labrig.config import parse
from labrig.models import effects as models
from labrig.scene.effects.face import Fresnel
from labrig.scene.effects.lens import falling
from labrig.scene.effects.projector import lost_by
from labrig.scene.effects.sensor import SRGB_AT_BLACK
from labrig.scene.effects.view import seen_from, undistorted
from labrig.scene.fresnel import internal_reflectance, reflectances
from labrig.scene.parts import Parts
from labrig.scene.picture import Picture
from labrig.scene.pipeline import see
from labrig.scene.single import _projected, blurred

ROWS, COLS = 150, 200
WHITE = np.full((4, 1280), 255, np.uint8)
CLEAR = {"sigma_t_per_mm": 1e-9, "sigma_s_per_mm": 0.0, "g": 0.0}


def scene_of(effects: dict, **changes) -> labrig.Scene:
    content = {
        "schema": "labrig-scene/1",
        "medium": {"sigma_t_per_mm": 0.3, "sigma_s_per_mm": 0.15, "g": 0.3},
        "tank": {"depth_mm": 20, "width_mm": 15},
        "beam": {"from_mm": 4, "to_mm": 11},
        "light": {"peak_e_per_s": 1000.0, "ambient_e_per_s": 7.0},
        "effects": {"single-scattering": "always", **effects},
        **changes,
    }
    return parse(content, labrig.Scene, source="here")


def rig_of(**camera) -> labrig.Rig:
    content = {
        "schema": "labrig-rig/1",
        "name": "here",
        "camera": {
            "driver": "simulated",
            "rows": ROWS,
            "cols": COLS,
            "bits": 12,
            "black_level_dn": 16,
            "white_level_dn": 4095,
            "gain_dn_per_e": 0.28,
            "read_noise_e": 10.9,
            **camera,
        },
        "projector": {"driver": "simulated", "rows": 4, "cols": 1280, "black_level": 0.02},
        "geometry": {"mm_per_px": 0.1, "region_px": [0, 0, COLS, ROWS]},
        "projection": {"mm_per_px": 0.15, "origin_mm": -58.5, "blur_px": 0.5},
    }
    return parse(content, labrig.Rig, source="rig")


def plan_of(period_px: int = 12) -> labrig.Plan:
    stripes = {"kind": "stripes", "period_px": period_px, "shifts": 6, "low": 51}
    content = {
        "schema": "labrig-plan/1",
        "name": "here",
        "exposures": {"bracket_s": [0.05]},
        "sets": [{"id": "s", "pattern": stripes}, {"id": "white", "pattern": {"kind": "uniform"}}],
    }
    return parse(content, labrig.Plan, source="plan")


def seen(effects: dict, force: tuple[str, ...] = (), **changes) -> Picture:
    """Return the picture of a scene whose effects are all used, whatever the tolerance."""
    scene = scene_of(effects, tolerance=1e-9, **changes)
    return see(scene, rig_of(), plan_of(), force=force).picture


def parts_of(effects: dict, **changes) -> Parts:
    return seen(effects, **changes).parts


def edge_at_px(column: np.ndarray) -> float:
    """Return where a Gaussian edge rises through half of the column's middle, px."""
    share = column / column[column.size // 2]
    n = int(np.flatnonzero(share > 0.5)[0])
    below, above = erfinv(2.0 * share[n - 1 : n + 1] - 1.0)
    return n - 1 - below / (above - below)


def test_gamma_bends_grey_levels_and_no_others():
    line = np.zeros((4, 1280), np.uint8)
    line[:, np.arange(1280) % 12 < 6] = 51
    plain, bent = seen({}), seen({"projector-gamma": {"gamma": 2.2}})
    grey = plain.light(line, 0.0) > 0.0
    ratio = bent.light(line, 0.0)[grey] / plain.light(line, 0.0)[grey]
    np.testing.assert_allclose(ratio, 0.2**1.2, rtol=1e-12)  # measured 3e-16
    np.testing.assert_array_equal(bent.light(WHITE, 0.0), plain.light(WHITE, 0.0))


def test_a_black_projector_leaks_its_share():
    picture = seen({"black-leak": "always"})
    black = picture.light(np.zeros_like(WHITE), picture.black_level)
    np.testing.assert_allclose(black, 0.02 * picture.light(WHITE, 0.0), rtol=1e-12)


@pytest.mark.parametrize("sigma_px", [0.5, 1.7])
def test_a_blurred_edge_is_an_error_function(sigma_px):
    levels = np.zeros(80)
    levels[40:] = 1.0
    u = np.linspace(30.0, 50.0, 997)
    expected = 0.5 * (1.0 + erf((u - 40.0) / (math.sqrt(2.0) * sigma_px)))
    # measured worst 1.2e-4 at half a pixel: the profile is straight between 32 samples a pixel
    np.testing.assert_allclose(blurred(levels, sigma_px)(u), expected, atol=3e-4)


def test_what_blur_takes_from_stripes_is_what_its_bound_says():
    levels = (np.arange(240) % 12 < 6).astype(float)
    u = np.linspace(60.0, 180.0, 24001)[:-1]
    soft, sharp = blurred(levels, 0.8)(u), blurred(levels, 0.0)(u)
    found = math.sqrt(np.mean((soft - sharp) ** 2) / 0.25)
    assert lost_by(0.8, 12.0) == pytest.approx(
        found, rel=5e-3
    )  # measured 3e-3: the profile is sampled


def test_defocus_grows_with_depth():
    parts = parts_of({"projector-blur": "always", "defocus": {"px_per_mm": 0.06}})
    line = (np.arange(1280) % 12 < 6).astype(float)
    entry = np.linspace(6.0, 9.6, 2401)[:-1, None]  # two periods
    x = np.array([0.05, 10.0, 19.95])
    shown = _projected(parts, line, entry, x)
    turn = 2.0 * np.pi / 1.8
    found = 2.0 * np.abs((shown * np.exp(-1j * turn * entry)).mean(axis=0))
    sigma_mm = (0.5 + 0.06 * x) * 0.15
    expected = 2.0 / math.pi * np.exp(-0.5 * (turn * sigma_mm) ** 2)
    # measured worst 1.6e-4: blurs are interpolated between 33
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_the_lamp_falls_to_the_edges_as_a_parabola():
    light = seen({"lamp-shape": {"falloff": 0.4}}).light(WHITE, 0.0)[:, 10]
    flat = seen({}).light(WHITE, 0.0)[:, 10]
    y = (np.arange(ROWS) + 0.5) * 0.1
    inside = (y > 4.2) & (y < 10.8)
    shape = 1.0 - 0.4 * ((y[inside] - 7.5) / 3.5) ** 2
    np.testing.assert_allclose(light[inside] / flat[inside], shape, atol=5e-4)  # measured 1e-4


def test_lamp_and_colour_wheel_are_integrated_over_an_exposure():
    effects = {
        "lamp-drift": {"cold_share": 0.3, "warmup_s": 20.0, "drift_per_h": 0.05},
        "colour-wheel": {"flicker": 0.1, "flicker_hz": 120.0},
    }
    parts = parts_of(effects)
    assert parts.lamp == Lamp(
        cold_share=0.3, warmup_s=20.0, drift_per_h=0.05, flicker=0.1, flicker_hz=120.0
    )
    t = np.linspace(8.0, 8.0333, 200_001)
    now = (1.0 - 0.3 * np.exp(-t / 20.0) + 0.05 * t / 3600.0) + 0.1 * np.sin(
        2.0 * np.pi * 120.0 * t
    )
    expected = np.trapezoid(now, t)
    world = World(light=lambda _i, _b: np.ones((1, 1)) if _i is not None else np.zeros((1, 1)))
    world.lamp = parts.lamp
    world.project(WHITE, at_s=0.0)
    # measured 1e-12
    assert world.expose(8.0, 0.0333)[0, 0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("outside_deg", "index"), [(30.0, 1.33), (-55.0, 1.5), (10.0, 1.0)])
def test_the_beam_turns_by_snells_law(outside_deg, index):
    effects = {"refraction": {"outside_deg": outside_deg, "index": index}}
    picture = seen(effects, tank={"depth_mm": 20, "width_mm": 15}, beam={"from_mm": 6, "to_mm": 9})
    inside = math.radians(picture.parts.scene.beam.angle_deg)
    assert index * math.sin(inside) == pytest.approx(math.sin(math.radians(outside_deg)), abs=1e-12)
    # and it is seen: the beam's edges drift by the tangent
    light = picture.light(WHITE, 0.0)
    rows = np.arange(ROWS)[:, None]
    middle = (light * rows).sum(axis=0)[:40] / light.sum(axis=0)[:40]
    drift_px = np.polyfit(np.arange(40), middle, 1)[0]
    assert drift_px == pytest.approx(math.tan(inside), abs=2e-3)  # measured worst 4e-4


def test_fresnels_equations_at_their_known_places():
    # straight: ((n1 - n2) / (n1 + n2))^2, of either polarisation
    s, p = reflectances(1.0, 1.5, 0.0, 0.0)
    assert s == pytest.approx(0.04)
    assert p == pytest.approx(0.04)
    # at Brewster's angle nothing of p comes back, and s as (n^2 - 1)^2 / (n^2 + 1)^2
    brewster = math.atan(1.5)
    s, p = reflectances(1.0, 1.5, brewster, math.pi / 2 - brewster)
    assert p == pytest.approx(0.0, abs=1e-30)
    assert s == pytest.approx((1.25 / 3.25) ** 2)
    # a pane between: 1 - R as the textbook's (n1 .. n2, n2 .. n3) without phases
    own = Fresnel(parse({"index": 1.33, "glass_index": 1.52}, _config("Fresnel"), source=""))
    front, back = (0.52 / 2.52) ** 2, (0.19 / 2.85) ** 2
    expected = (1 - front) * (1 - back) / (1 - front * back)
    assert own.transmission(0.0) == pytest.approx(expected, rel=1e-14)
    whole = seen({}).light(WHITE, 0.0)
    dimmed = seen({"fresnel": {"index": 1.33, "glass_index": 1.52}}).light(WHITE, 0.0)
    np.testing.assert_allclose(dimmed, expected * whole, rtol=1e-12)


def _config(name: str):
    return getattr(models, f"{name}Config")


def test_light_is_turned_back_beyond_the_critical_angle():
    critical = math.asin(1.0 / 1.33)
    angles = np.array([0.0, critical - 1e-6, critical + 1e-9, 1.5])
    found = internal_reflectance(1.33, np.cos(angles))
    assert found[0] == pytest.approx((0.33 / 2.33) ** 2)
    assert found[1] > 0.98
    assert (found[2:] == 1.0).all()


def test_a_spreading_beam_keeps_its_light_and_thins_it_out():
    # hardly any extinction: what crosses each depth is the same
    picture = seen({"divergence": {"half_angle_deg": 8.0}}, medium=CLEAR)
    light = picture.light(WHITE, 0.0)
    across = light.sum(axis=0) * 0.1
    # measured worst 1.6e-3: the edges are sampled eight times a pixel
    np.testing.assert_allclose(across, 7000.0, rtol=3e-3)
    far = 3.5 / math.tan(math.radians(8.0))
    x = (np.arange(COLS) + 0.5) * 0.1
    np.testing.assert_allclose(light[75], 1000.0 / (1.0 + x / far), rtol=1e-7)
    lit_mm = (light > 0.5 * light[75]).sum(axis=0) * 0.1
    np.testing.assert_allclose(lit_mm, 7.0 * (1.0 + x / far), atol=0.2)  # a pixel at each edge


def test_a_mirror_behind_shows_the_beam_again():
    picture, plain = seen({"walls": {"reflectance": 0.6}}), seen({})
    x = (np.arange(COLS) + 0.5) * 0.1
    found, alone = picture.light(WHITE, 0.0)[75], plain.light(WHITE, 0.0)[75]
    # to the far wall and back: 40 mm - x; and no further, the face being open
    np.testing.assert_allclose(found - alone, 600.0 * np.exp(-0.3 * (40.0 - x)), rtol=1e-4)
    slanted = {"from_mm": 4, "to_mm": 6, "angle_deg": -30.0}
    aside = seen({"walls": {"reflectance": 0.6}}, beam=slanted, medium=CLEAR).light(WHITE, 0.0)
    # its middle reaches the wall at 5 / tan(30) = 8.66 mm, and is as high again 17.3 mm deep
    rows = np.flatnonzero(aside[:, 173] > 500.0)
    assert rows.mean() * 0.1 == pytest.approx(5.0, abs=0.1)
    np.testing.assert_allclose(aside[rows[3:-3], 173], 600.0, rtol=1e-6)


KEPT = {  # share of the beam's light that crosses a depth, in a liquid that takes none of it
    "projector-gamma": ({"gamma": 2.2}, 1.0),
    "projector-blur": ({"sigma_px": 3.0}, 1.0),
    "defocus": ({"px_per_mm": 0.2}, 1.0),
    "lamp-shape": ({"falloff": 0.4}, 1.0 - 0.4 / 3.0),
    "refraction": ({"outside_deg": -12.0, "index": 1.33}, 1.0),
    "fresnel": ({"index": 1.33, "glass_index": 1.33}, 1.0 - (0.33 / 2.33) ** 2),
    "divergence": ({"half_angle_deg": 5.0}, 1.0),
    "walls": ({"reflectance": 0.25}, 1.25),  # and once again on its way back
    "lens-blur": ({"sigma_px": 2.0}, 1.0),
}


@pytest.mark.parametrize("name", KEPT)
def test_light_is_neither_made_nor_lost_but_where_physics_says(name):
    parameters, share = KEPT[name]
    light = seen({name: parameters}, medium=CLEAR).light(WHITE, 0.0)
    across = light[:, 15:-15].sum(axis=0) * 0.1
    # measured worst 1.6e-3, where the beam spreads: its edges are sampled eight times a pixel
    np.testing.assert_allclose(across, 7000.0 * share, rtol=3e-3)


@pytest.mark.parametrize("name", ["projector-blur", "defocus"])
def test_what_blur_takes_from_a_stripe_it_gives_to_the_next(name):
    picture = seen({name: KEPT[name][0]}, medium=CLEAR)
    white, total = picture.light(WHITE, 0.0), np.zeros((ROWS, COLS))
    for shift in range(6):
        line = np.zeros((4, 1280), np.uint8)
        line[:, (np.arange(1280) - 2 * shift) % 12 < 6] = 255
        total += picture.light(line, 0.0)
    np.testing.assert_allclose(total, 3.0 * white, rtol=1e-9, atol=1e-9)


def test_a_liquid_takes_of_the_beam_what_it_extinguishes():
    light = seen({}).light(WHITE, 0.0)
    # all that crossed the face, less what is left at the far wall
    taken = 0.3 * light.sum() * 0.1 * 0.1
    assert taken == pytest.approx(7000.0 * -math.expm1(-0.3 * 20.0), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("distortion", {"k1": 0.3}), ("oblique-view", {"tilt_deg": 20.0, "distance_mm": 100.0})],
)
def test_a_view_moves_light_but_leaves_its_brightness(name, parameters):
    picture = seen({"ambient": "always", name: parameters})
    np.testing.assert_allclose(picture.light(None, 0.0), 7.0, rtol=1e-12)
    # the beam's middle lies on the axis of either
    middle = seen({}, medium=CLEAR).light(WHITE, 0.0)[75, 100]
    bent = seen({name: parameters}, medium=CLEAR).light(WHITE, 0.0)[75, 100]
    assert bent == pytest.approx(middle, rel=1e-9)


def test_flicker_takes_no_light_from_whole_turns_nor_a_shutter_from_a_steady_lamp():
    wheel = parts_of({"colour-wheel": {"flicker": 0.4, "flicker_hz": 100.0}}).lamp
    assert wheel.integral_s(0.123, 0.153) == pytest.approx(0.03, rel=1e-12)  # three turns
    world = World(light=lambda i, _b: np.full((ROWS, 1), 5.0 if i is not None else 0.0))
    world.project(WHITE, at_s=0.0)
    np.testing.assert_allclose(world.expose(0.5, 0.02, row_time_s=1e-4), 0.1, rtol=1e-12)


def test_ambient_light_is_everywhere_and_needs_no_projector():
    picture = seen({"ambient": "always"})
    assert (picture.light(None, 0.0) == 7.0).all()
    np.testing.assert_allclose(picture.light(WHITE, 0.0) - 7.0, seen({}).light(WHITE, 0.0))


def test_the_lens_blurs_an_edge_by_its_gaussian_and_loses_no_light():
    sharp = seen({}).light(WHITE, 0.0)
    soft = seen({"lens-blur": {"sigma_px": 1.5}}).light(WHITE, 0.0)
    rows = np.arange(ROWS)
    # the beam begins between rows 39 and 40 and is that far from its other edge
    expected = 0.5 * (1.0 + erf((rows[20:60] - 39.5) / (math.sqrt(2.0) * 1.5)))
    found = soft[20:60, 100] / soft[75, 100]
    # measured worst 7e-3: a pixel's step is blurred, not a line's
    np.testing.assert_allclose(found, expected, atol=0.01)
    inner = slice(12, -12)
    assert soft[:, inner].sum() == pytest.approx(sharp[:, inner].sum(), rel=2e-3)


def test_vignetting_is_the_fourth_power_of_the_cosine():
    gain = falling(301, 401, 30.0)
    half = 0.5 * math.hypot(301, 401)
    for row, col in ((150, 200), (0, 0), (20, 390)):
        field = math.atan(math.tan(math.radians(30.0)) * math.hypot(row - 150, col - 200) / half)
        assert gain[row, col] == pytest.approx(math.cos(field) ** 4, rel=1e-13)
    assert gain[150, 200] == 1.0


@pytest.mark.parametrize("k1", [-0.14, 0.08, 0.5])
def test_distortion_is_undone_to_rounding(k1):
    r = np.linspace(0.0, 1.0, 101)
    u = r * undistorted(r, k1)
    np.testing.assert_allclose(u * (1.0 + k1 * u**2), r, atol=1e-12)  # measured 2e-16


def test_distorted_edges_are_where_they_belong_to_a_hundredth_of_a_pixel():
    soft = {"lens-blur": {"sigma_px": 1.0}}
    plain, k1 = seen(soft, medium=CLEAR).light(WHITE, 0.0), 0.02
    bent = seen({"distortion": {"k1": k1}, **soft}, medium=CLEAR).light(WHITE, 0.0)
    half = 0.5 * math.hypot(ROWS, COLS)
    straight = edge_at_px(plain[:, 100])
    for col in (60, 100, 150):
        # the straight edge at this row, seen at r (1 + k1 r^2)
        x_true = col - 0.5 * (COLS - 1)
        y_true = straight - 0.5 * (ROWS - 1)
        for _ in range(50):  # the place on the edge that is seen in this column
            scale = 1.0 + k1 * (x_true**2 + y_true**2) / half**2
            x_true = (col - 0.5 * (COLS - 1)) / scale
        expected = y_true * scale + 0.5 * (ROWS - 1)
        assert edge_at_px(bent[:, col]) == pytest.approx(expected, abs=0.01)  # measured 1.9e-3


def test_an_oblique_view_is_the_pinholes_to_a_hundredth_of_a_pixel():
    tilt, far = 12.0, 150.0
    soft = {"lens-blur": {"sigma_px": 1.0}}
    plain = seen(soft, medium=CLEAR).light(WHITE, 0.0)
    turned = seen({"oblique-view": {"tilt_deg": tilt, "distance_mm": far}, **soft}, medium=CLEAR)
    light, straight = turned.light(WHITE, 0.0), edge_at_px(plain[:, 100])
    for col in (40, 100, 160):
        seen_x = (col - 0.5 * (COLS - 1)) * 0.1
        # a pinhole at distance D from a plane turned by t: solve u = D X cos t / (D + X sin t)
        sine, cosine = math.sin(math.radians(tilt)), math.cos(math.radians(tilt))
        true_x = seen_x * far / (far * cosine - seen_x * sine)
        depth = far + true_x * sine
        expected = (straight - 0.5 * (ROWS - 1)) * far / depth + 0.5 * (ROWS - 1)
        assert edge_at_px(light[:, col]) == pytest.approx(expected, abs=0.01)  # measured 2.3e-3
    y, x = seen_from(np.array([3.0]), np.array([0.0]), tilt, far)
    assert (y[0], x[0]) == (3.0, 0.0)


def sensor_of(**changes) -> Sensor:
    return Sensor(
        rows=200,
        cols=200,
        bits=12,
        white_level_dn=4095,
        gain_dn_per_e=0.28,
        readout_s=0.0,
        **{
            "black_level_dn": 16,
            "read_noise_e": 0.0,
            "shot_noise": False,
            "quantised": False,
            "saturates": False,
            **changes,
        },
    )


def read(sensor: Sensor, electrons: float | np.ndarray) -> np.ndarray:
    noise = Noise(sensor, 5)
    counts = noise.counts(np.broadcast_to(electrons, (200, 200)).astype(float), 0.1, "here")
    noise.close()
    return counts


def test_the_variance_of_shot_noise_is_its_mean():
    counts = read(sensor_of(shot_noise=True), 900.0)
    electrons = (counts - 16.0) / 0.28
    # 40 000 pixels: a standard error of 0.7 % of the variance; measured 0.3 %
    assert electrons.var() == pytest.approx(900.0, rel=0.03)
    assert electrons.mean() == pytest.approx(900.0, rel=1e-3)
    np.testing.assert_allclose(electrons, np.rint(electrons), atol=1e-9)


def test_srgb_counts_lift_noise_by_no_more_than_their_bound_says():
    """A dark picture with a bright spot: noise of the dark pixels against the light of all."""
    light = np.full((200, 200), 4.0)
    light[:20, :20] = 8000.0

    def off(response: str) -> float:
        noisy, exact = (
            read(sensor_of(shot_noise=noise, response=response, black_level_dn=0), light)
            for noise in (True, False)
        )
        return float(np.linalg.norm(noisy - exact) / np.linalg.norm(exact))

    # measured 0.012 and 0.024
    assert 1.5 * off("linear") < off("srgb") < SRGB_AT_BLACK * off("linear")


def test_read_noise_is_normal_with_its_deviation():
    electrons = (read(sensor_of(read_noise_e=10.9), 500.0) - 16.0) / 0.28
    assert electrons.std() == pytest.approx(10.9, rel=0.015)
    inside = np.mean(np.abs(electrons - 500.0) < 10.9)
    assert inside == pytest.approx(0.6827, abs=0.01)


def test_rounding_errs_by_a_count_over_the_root_of_twelve():
    ramp = np.linspace(100.0, 9000.0, 40_000).reshape(200, 200)
    exact, whole = read(sensor_of(), ramp), read(sensor_of(quantised=True), ramp)
    assert (whole == np.rint(whole)).all()
    assert (whole - exact).std() == pytest.approx(1.0 / math.sqrt(12.0), rel=0.01)
    assert np.abs(whole - exact).max() <= 0.5


def test_counts_end_at_the_white_level():
    ramp = np.linspace(10_000.0, 20_000.0, 40_000).reshape(200, 200)
    counts = read(sensor_of(saturates=True), ramp)
    np.testing.assert_allclose(counts, np.minimum(16.0 + 0.28 * ramp, 4095.0))
    assert counts.max() == 4095.0


def test_blooming_moves_charge_along_columns_and_loses_none():
    electrons = np.full((200, 200), 100.0)
    electrons[90:93, 50] = 60_000.0
    full = sensor_of().full_well_e
    spilt = bloom(electrons, full, 1.0)
    assert spilt.max() <= full
    assert spilt.sum() == pytest.approx(electrons.sum(), rel=1e-12)
    assert (np.delete(spilt, 50, axis=1) == 100.0).all()
    assert (spilt[80:103, 50] > 100.0).sum() >= 10
    assert bloom(electrons, full, 0.5).sum() < electrons.sum()


def test_srgb_counts_are_what_the_calibration_undoes():
    ramp = np.linspace(0.0, 14_000.0, 40_000).reshape(200, 200)
    coded = read(sensor_of(response="srgb", quantised=True, saturates=True), ramp)
    linear = srgb_response(12).linear(12)[coded.astype(int)]
    # a count of the code is up to 2.2 linear counts near white: measured 1.1
    np.testing.assert_allclose(linear, 16.0 + 0.28 * ramp, atol=1.2)


def test_hot_pixels_collect_their_own_electrons():
    counts = read(sensor_of(hot_pixels=25, hot_e_per_s=2000.0), 0.0)
    assert (counts > 17.0).sum() == 25
    np.testing.assert_allclose(counts[counts > 17.0], 16.0 + 0.28 * 200.0)


def test_rows_of_a_rolling_shutter_see_the_light_later():
    effects = {
        "rolling-shutter": {"row_time_s": 1e-3},
        "lamp-drift": {"cold_share": 0.5, "warmup_s": 1.0},
    }
    parts = parts_of(effects)
    flat = np.ones((ROWS, 1))
    world = World(light=lambda i, _b: flat if i is not None else 0.0 * flat, lamp=parts.lamp)
    world.project(WHITE, at_s=0.0)
    assert parts.sensor is not None
    rows = world.expose(0.0, 0.01, parts.sensor.row_time_s)[:, 0]
    begin = 1e-3 * np.arange(ROWS)
    expected = 0.01 - 0.5 * (np.exp(-begin) - np.exp(-begin - 0.01))
    np.testing.assert_allclose(rows, expected, rtol=1e-12)
