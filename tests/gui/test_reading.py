"""What is read off pictures and how they are shown: no display is needed."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.errors import AnalysisError
from analysis.light_field import Grid
from analysis.medium import Beam, Medium, Tank
from analysis.reweighting import reweight
from analysis.transport.ordinates import solve_on
from labrig.gui.curves import Chart, Curve, dashed, log_ticks, ranges, tick_text, ticks
from labrig.gui.images import HATCH_PX, coloured, levels, paint, places, table, zebra_mask
from labrig.gui.palette import DARK, LIGHT, PALETTES, ZEBRA, contrast, rgb
from labrig.gui.rail import Day, current, judge
from labrig.gui.viewport import Viewport
from labrig.station.meters import TARGET, bracket_fits, bracket_from, fitting_exposure, focus, read

# Machado, Oliveira and Fernandes 2009, severity 1, on linear red, green and blue
BLIND = {
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritan": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def picture(bits: int, seed: int = 1) -> tuple[np.ndarray, int]:
    """A picture of which a few hundredths are clipped, and its white level."""
    white = 2**bits - 1
    counts = np.random.default_rng(seed).normal(0.6 * white, 0.2 * white, (120, 160))
    return np.clip(np.rint(counts), 0, white).astype(np.uint16), white


def lab(colours: np.ndarray) -> np.ndarray:
    """CIE L*a*b* (D65) of linear red, green and blue."""
    to_xyz = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    xyz = np.clip(colours, 0, 1) @ to_xyz.T / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], 1)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_saturated_share_is_that_of_the_raw_frame_and_zebra_hatches_nothing_else(bits):
    counts, white = picture(bits)
    meter = read(counts, black=0.0, white=white)
    assert meter.saturated == pytest.approx(np.mean(counts == white), abs=1e-12)
    assert meter.dark == pytest.approx(np.mean(counts < np.ceil(0.01 * white)), abs=1e-12)
    assert meter.histogram.sum() == counts[::2, ::2].size
    for zoom in (0.4, 1.0, 3.7):
        view = Viewport(cols=160, rows=120, width=211, height=173).at(zoom)
        mask = zebra_mask(counts, view, white)
        cols, rows = places(view)
        i, j = np.nonzero(mask)
        assert i.size > 0
        assert (counts[rows[i], cols[j]] == white).all()
        shown = paint(
            counts, view, low=0, high=white, colours="grey", ground="#000000", white_level=white
        )
        hatched = np.isin(
            shown.reshape(-1, 3) @ [65536, 256, 1],
            [c[0] * 65536 + c[1] * 256 + c[2] for c in ZEBRA],
        ).reshape(mask.shape)
        np.testing.assert_array_equal(hatched, mask)  # grey shows neither of the two colours
    assert HATCH_PX >= 2


def test_a_part_is_read_alone():
    counts, white = picture(12)
    counts[:, :80] = white
    meter = read(counts, black=0.0, white=white, roi=(80, 10, 70, 90))
    assert meter.saturated == pytest.approx(np.mean(counts[10:100, 80:150] == white), abs=1e-12)


@pytest.mark.parametrize("zoom", [0.25, 1.0, 8.0])
def test_pixels_are_found_where_they_are_shown_at_every_zoom_and_after_a_pan(zoom):
    rng = np.random.default_rng(3)
    # every pixel its own value: 16 bits hold 65536 of them
    counts = rng.permutation(200 * 300).reshape(200, 300).astype(np.uint16)
    view = Viewport(cols=300, rows=200, width=240, height=180).at(zoom)
    for _ in range(100):
        view = view.panned(*rng.uniform(-40, 40, 2))
        x, y = int(rng.integers(240)), int(rng.integers(180))
        found = view.pixel(x, y)
        cols, rows = places(view)
        assert (found is None) == (cols[x] < 0 or rows[y] < 0)
        if found is None:
            continue
        assert found == (cols[x], rows[y])
        if zoom >= 1.0:
            shown = paint(counts, view, low=0, high=65535, colours="grey", ground="#000000")
            assert shown[y, x, 0] == levels(counts, 0, 65535)[found[1], found[0]]


def test_zoom_keeps_the_point_under_the_pointer():
    view = Viewport(cols=1280, rows=960, width=800, height=600).fit()
    before = view.to_picture(123, 456)
    assert view.zoomed(3.1, 123, 456).to_picture(123, 456) == pytest.approx(before)
    assert view.resized(400, 300).fitted


def test_levels_and_colours_are_those_of_the_map():
    counts = np.array([[0, 100, 200, 4095]], np.uint16)
    np.testing.assert_array_equal(levels(counts, 0, 4095), [[0, 6, 12, 255]])
    floats = np.array([[np.nan, -1.0, 0.25, np.inf]], np.float32)
    np.testing.assert_array_equal(levels(floats, 0, 1), [[0, 0, 64, 255]])
    np.testing.assert_array_equal(levels(floats, 0, 1, root=True), [[0, 0, 128, 255]])
    assert (
        coloured(np.array([[0, 255]], np.uint8), "cividis")[0] == table("cividis")[[0, 255]]
    ).all()
    lightness = table("cividis") @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(lightness) > -0.8).all()  # it rises: measured worst -0.7 of 255, by rounding


@pytest.mark.parametrize("palette", PALETTES.values(), ids=PALETTES)
def test_words_can_be_read(palette):
    for name, (words, ground) in palette.word_pairs.items():
        assert contrast(words, ground) >= 4.5, name
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)


@pytest.mark.parametrize("kind", BLIND)
@pytest.mark.parametrize("palette", [DARK, LIGHT], ids=["dark", "light"])
def test_curves_can_be_told_apart_by_every_kind_of_colour_vision(palette, kind):
    shares = np.array([rgb(colour) for colour, _, _ in palette.curves]) / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    seen = lab(linear @ np.array(BLIND[kind]).T)
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + 1e3 * np.eye(len(seen))
    assert apart.min() >= 12.0
    assert len({dashes for _, dashes, _ in palette.curves}) == len(palette.curves)
    assert len({marker for _, _, marker in palette.curves}) == len(palette.curves)


def test_exposure_is_led_to_its_target():
    light = np.random.default_rng(5).uniform(0.0, 1.0, (64, 64)) * 30000.0  # counts/s
    exposure_s, limits_s = 0.9, (1e-4, 2.0)
    for _ in range(8):
        counts = np.clip(16 + light * exposure_s, 0, 4095).astype(np.uint16)
        meter = read(counts, black=16.0, white=4095)
        wanted = fitting_exposure(meter, exposure_s, black=16.0, white=4095, limits_s=limits_s)
        if wanted == exposure_s:
            break
        exposure_s = wanted
    assert meter.bright == pytest.approx(TARGET, abs=0.08)
    assert bracket_from(0.5, limits_s) == (0.5, 2.0)


def test_a_bracket_that_clips_or_leaves_black_is_refused_with_the_reason():
    counts = np.full((32, 32), 2000, np.uint16)
    meter = read(counts, black=16.0, white=4095)
    assert bracket_fits(meter, 0.1, (0.1, 0.4), black=16.0, white=4095) == (True, "")
    assert "clip" in bracket_fits(meter, 0.1, (0.3, 0.4), black=16.0, white=4095)[1]
    dark = read(np.full((32, 32), 17, np.uint16), black=16.0, white=4095)
    assert "black" in bracket_fits(dark, 0.1, (0.1, 0.2), black=16.0, white=4095)[1]


def test_focus_falls_with_blur_and_not_with_exposure():
    rng = np.random.default_rng(7)
    stripes = np.tile(np.repeat([3000.0, 200.0], 8), 8)[None, :] * np.ones((128, 1))
    values = []
    for width in (1, 3, 7):
        kernel = np.ones(width) / width
        blurred = np.apply_along_axis(np.convolve, 1, stripes, kernel, mode="same")
        noisy = rng.normal(blurred, 5.0)
        values.append(focus(np.clip(noisy, 0, 4095).astype(np.uint16), 0.0))
    assert values[0] > 1.05 * values[1] > 1.05**2 * values[2]  # measured 0.066, 0.059, 0.041
    half = focus((stripes / 2).astype(np.uint16), 0.0)
    assert half == pytest.approx(focus(stripes.astype(np.uint16), 0.0), rel=1e-3)


def test_steps_are_ticked_by_rules():
    done = [ok for ok, _ in judge(Day())]
    assert done == [False] * 6
    assert current(done, Day()) == 0
    day = Day(connected=True, focus_share=0.95, focus_readings=9, exposure_fits=True)
    done = [ok for ok, _ in judge(day)]
    assert done == [True, True, True, False, False, False]
    assert current(done, day) == 3
    assert not judge(Day(connected=True, session="x", session_whole=False))[3][0]


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 17.9), (1e-6, 3e-6), (0.0, 65000.0)])
def test_ticks_are_round_and_inside(low, high):
    found = ticks(low, high, 5)
    assert 3 <= len(found) <= 7
    assert min(found) >= low - 1e-9 * abs(low)
    assert max(found) <= high * (1 + 1e-9)
    step = found[1] - found[0]
    texts = [tick_text(value, step) for value in found]
    assert len(set(texts)) == len(texts)


def test_log_ticks_and_ranges():
    tens, between = log_ticks(0.5, 200.0)
    assert tens == [1.0, 10.0, 100.0]
    assert 0.5 in between
    curve = Curve(
        x=np.arange(4.0), y=np.array([1.0, -1.0, np.nan, 100.0]), look=("#ffffff", (), "")
    )
    low, high = ranges(Chart(curves=(curve,), log=True))[1]
    assert low > 0.0
    assert high > 100.0


def test_dashes_cover_their_share_of_the_line():
    line = np.stack([np.linspace(0, 300, 40), np.zeros(40)], axis=1)
    pieces = dashed(line, (10.0, 5.0))
    length = sum(np.hypot(*np.diff(p, axis=0).T).sum() for p in pieces)
    assert length == pytest.approx(200.0, rel=0.02)
    assert len(dashed(line, ())) == 1


def test_reweighted_bounces_are_those_of_a_new_solution():
    """Eq. 11 against the solver itself: pictures and light fields of another sigma_s."""
    beam = Beam(from_mm=3.0, to_mm=7.0)
    grid = Grid(tank=Tank(depth_mm=12.0, width_mm=10.0), n_x=13, n_y=11, n_theta=16)

    def solved(sigma_s):
        medium = Medium(sigma_t_per_mm=0.3, sigma_s_per_mm=sigma_s, g=0.3)
        return solve_on(medium, beam, grid, n_bounces=5)

    here, there = solved(0.1), solved(0.27)
    fluence = reweight(here.fluence, first=1, sigma_s_per_mm=0.1, wanted_per_mm=0.27)
    np.testing.assert_allclose(fluence, there.fluence, rtol=1e-12)  # measured worst 5e-16
    light = reweight(here.light_field, first=2, sigma_s_per_mm=0.1, wanted_per_mm=0.27)
    # measured worst 2e-7 where the light fields are kept in single precision
    np.testing.assert_allclose(light, there.light_field, rtol=1e-6, atol=1e-12)
    with pytest.raises(AnalysisError, match="positive"):
        reweight(here.fluence, first=1, sigma_s_per_mm=0.0, wanted_per_mm=0.1)
