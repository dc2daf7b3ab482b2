"""A day's work: from the rig to the exported result by keys, and everything a result shows."""

from __future__ import annotations

import csv
import math
import shutil
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from PIL import Image
from window import SLANT_DEG, Open, Window, shown_of

import labrig
from labrig.gui.field_tab import FAINT
from labrig.session import Session


def choose(window: Window, row: int) -> Path:
    """Choose a session of the list by keys alone; return its folder."""
    tree = window.app.browser.tree
    window.key("F6")
    tree.focus_force()
    window.key("Home", tree)
    tree.focus(tree.get_children()[0])
    tree.selection_set(tree.get_children()[0])
    for _ in range(row):
        window.key("Down", tree)
    assert window.pump(lambda: tree.selection() == (tree.get_children()[row],))
    return Path(tree.selection()[0])


def test_a_whole_day_by_keys_alone(open_window: Open):
    """A4: connect, expose, capture, analyse, look at every tab, export; the files are there."""
    window = open_window(helper=True, operator="Ada")
    app = window.app
    window.key("Key-a", app.live.pane)
    assert window.pump(lambda: window.said("brightest pixels stand")), window.log
    assert window.pump(lambda: app.day.exposure_fits and app.rail.states[2] == "done")
    assert window.pump(lambda: app.rail.states[1] == "done")
    window.key("F5")
    assert window.pump(lambda: app.day.session_whole), window.log
    (session,) = app.places.out.glob("20*/*")
    assert Session.open(session).header["operator"] == "Ada"
    assert "Ada" in app.about.cget("text")
    window.key("Key-space", app.live.pane)  # held: what follows has the processor
    assert window.pump(lambda: app.outcomes.shown is not None), window.log
    for number in range(1, 7):
        window.key(f"Control-Key-{number}")
        assert window.pump(lambda number=number: app.tab == number - 1)
    window.key("Control-e")
    assert window.pump(lambda: app.outcomes.exported), window.log
    kinds = {path.suffix for path in app.outcomes.exported}
    assert kinds >= {".png", ".pdf", ".csv", ".nc"}
    for path in app.outcomes.exported:
        assert path.stat().st_size > 0
    assert window.pump(lambda: app.day.exported)
    assert app.rail.states == ["done"] * 5 + ["now"]
    _files_hold_the_result(app.outcomes.exported, app.outcomes.shown)


def _files_hold_the_result(written: list[Path], shown: labrig.Result) -> None:
    named = {path.name: path for path in written}
    with named["parameters.csv"].open(encoding="utf-8", newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    value = rows["sigma_t_per_mm"]["value"]
    assert float(value) == pytest.approx(shown.bounces.sigma_t, rel=1e-12)
    with h5netcdf.File(named["fields.nc"]) as file:
        assert set(file.variables) >= {"single", "multiple", "fluence", "light_field"}
        assert file["fluence"].shape == shown.bounces.pictures.shape
    for path in written:
        if path.suffix == ".png":
            shades = np.asarray(Image.open(path).convert("L"))
            assert shades.std() > 5, path
        elif path.suffix == ".pdf":
            assert path.read_bytes().startswith(b"%PDF")


def test_results_answer_to_sliders_and_a_straight_run_stands_beside_a_slanted_one(
    open_window: Open, results_root: Path, tmp_path: Path
):
    root = shutil.copytree(results_root, tmp_path / "sessions")
    window = open_window(helper=True)
    app = window.app
    window.key("Key-space", app.live.pane)
    assert window.pump(lambda: len(app.browser.entries) == 2), window.log
    for row in (1, 0):  # the newest is the first
        chosen = choose(window, row)
        assert chosen.parent.parent == root
        assert window.pump(
            lambda chosen=chosen: app.outcomes.shown and app.outcomes.shown.title == chosen.name
        ), window.log
    window.key("Control-k")
    right, left = app.field.halves  # the chosen one, and the one seen before
    assert app.tab == 4
    assert right.name == chosen.name
    assert left.name != chosen.name
    assert math.degrees(left.bounces.beam_angle_rad) == pytest.approx(0.0)
    assert math.degrees(right.bounces.beam_angle_rad) == pytest.approx(SLANT_DEG)
    assert window.pump(lambda: left.pane.winfo_ismapped() and left.n_glyphs > 8)
    # light goes along its beam: brightest where the beam goes, in both
    for half, angle in ((left, 0.0), (right, math.radians(SLANT_DEG))):
        bounces = half.bounces
        light = bounces.light_field[0].sum(axis=(0, 1), dtype=np.float64)
        mean = math.atan2(
            (light * np.sin(bounces.theta)).sum(), (light * np.cos(bounces.theta)).sum()
        )
        assert mean == pytest.approx(
            angle, abs=0.08
        )  # measured worst 0.051: the tank ends nearer on one side
    app.field.alone.invoke()
    assert left.bounces is None
    _sigma_s_slides(window)
    _accuracy_has_its_price(window)


def _sigma_s_slides(window: Window) -> None:
    """Bounce k goes with the k-1st power of sigma_s (Eq. 11), curves and pictures alike."""
    app = window.app
    app.show_tab(3)
    window.beats()
    own = app.bounces.own
    app.bounces.sigma_s.set(0.5 * own.sigma_s)
    assert window.pump(lambda: app.bounces.bounces.sigma_s == pytest.approx(0.5 * own.sigma_s))
    seen = app.bounces.bounces
    for k in range(own.pictures.shape[0]):
        inside = own.pictures[k] > 1e-6
        # single precision
        np.testing.assert_allclose(
            seen.pictures[k][inside] / own.pictures[k][inside], 0.5**k, rtol=1e-5
        )
        np.testing.assert_allclose(seen.curves[k], 0.5**k * own.curves[k], rtol=1e-12)
    shown = app.bounces.plot.chart.curves[1].y
    np.testing.assert_allclose(shown, 0.5 * own.curves[1], rtol=1e-12)
    app.show_tab(4)
    window.beats()
    light = app.field.halves[0].bounces
    np.testing.assert_allclose(light.light_field[1], 0.25 * own.light_field[1], rtol=1e-5)
    app.show_tab(3)
    app.bounces.back.invoke()
    assert app.bounces.bounces.sigma_s == own.sigma_s


def _accuracy_has_its_price(window: Window) -> None:
    """The price of a tighter tolerance is said before it is paid; then it is kept."""
    app = window.app
    assert window.pump(lambda: "MB" in app.bounces.price_words.cget("text")), window.log
    app.bounces.tolerance.set(-3.0)
    tight = window.pump(lambda: app.bounces.price_words.cget("text").startswith("0.1 %"))
    assert tight, app.bounces.price_words.cget("text")
    app.bounces.tolerance.set(-1.5)
    assert window.pump(lambda: "MB" in app.bounces.price_words.cget("text"))
    before = app.bounces.own
    app.bounces.pay.invoke()
    assert window.pump(lambda: app.bounces.own is not before), window.log
    stated = app.bounces.own.error_estimate
    assert (stated <= 10**-1.5).all()
    assert "±" in app.bounces.panes[1].title


def test_light_field_has_a_glyph_at_every_point_that_is_lit_and_is_read_by_arrow_keys(
    open_window: Open, results_root: Path
):
    window = open_window()
    app = window.app
    app.devices.hold(paused=True)
    app.outcomes.show(shown_of(results_root))
    window.key("Control-Key-5")
    half = app.field.halves[0]
    assert window.pump(lambda: half.n_glyphs > 0)
    assert half.n_glyphs == glyphs_expected(window)
    before = app.field.numbers_of.cget("text")
    half.pane.focus_force()
    for _ in range(12):
        window.key("Right", half.pane)
    words = app.field.numbers_of.cget("text")
    assert words != before
    assert "from the beam" in words
    assert app.field.polar.find_all()


def glyphs_expected(window: Window) -> int:
    """Sampling points in sight whose radiance exceeds a ten-thousandth of the largest."""
    half = window.app.field.halves[0]
    found, view = half.bounces, half.pane.view
    node_px = 6 * view.zoom
    step = max(round(46.0 / node_px), 1)
    top, bottom, left, right = found.lit
    light = found.light_field[0][top : bottom + 1, left : right + 1].max(axis=2)
    rows = range((light.shape[0] - 1) // 2 % step, light.shape[0], step)
    cols = range(step // 2, light.shape[1], step)
    return sum(light[r, c] > FAINT * light.max() for r in rows for c in cols)
