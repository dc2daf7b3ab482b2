"""The live decomposition: its numbers against the simulated truth and an analysis of its frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from window import Window

import labrig
from labrig.gui.drawer import OLD_S
from labrig.results import value_of
from labrig.station.decomposition import decompose
from labrig.station.door import Picture, StripeSet
from labrig.station.live import CYCLE_S, Live, binned_for

TRUTH = {"sigma_t": 0.3, "sigma_s": 0.15, "g": 0.3}  # of the small scene


@dataclass(frozen=True)
class Cycled:
    """A cycle of stripes: what the live fit is given, and the pictures it was made of."""

    found: StripeSet
    pictures: dict[str, Picture]


@pytest.fixture(scope="module")
def cycled(small_rig: Path, small_scene: Path, small_plan: Path) -> Cycled:
    plan = labrig.load_plan(small_plan)
    with labrig.open_rig(small_rig, small_scene, plan) as rig:
        live = Live(rig, plan)
        live.expose(0.05, 0.0)
        live.show("cycle")
        taken, found = {}, None
        while found is None:
            picture = live.take()
            taken[picture.shows] = picture
            found = live.stripe_set()
        live.stop()
    return Cycled(found, taken)


def off(fitted: Any, name: str) -> float:
    """How many of its own standard deviations a value is from the truth."""
    value, std = getattr(fitted, name)
    return abs(value - TRUTH[name]) / std


def test_a_set_tells_the_medium_and_its_first_bounces(cycled: Cycled):
    fitted = decompose(cycled.found)
    assert fitted.why == ""
    assert fitted.holds
    for name in TRUTH:
        assert off(fitted, name) < 4.0, name  # measured worst 1.1
    assert fitted.sigma_t[0] == pytest.approx(TRUTH["sigma_t"], rel=0.01)
    assert fitted.sigma_s[0] == pytest.approx(TRUTH["sigma_s"], rel=0.02)
    assert fitted.bounces.shape[0] == 6
    # the first bounce is the ballistic beam: it decays by the sigma_t that is shown
    decay = np.polyfit(fitted.bounce_depth, np.log(fitted.bounces[0]), 1)[0]
    assert -decay == pytest.approx(fitted.sigma_t[0], rel=1e-3)
    assert 0.0 < fitted.plan_std < fitted.sigma_t[1]


def test_it_agrees_with_an_analysis_of_the_same_frames(
    cycled: Cycled, tmp_path: Path, write_manifest: Callable[..., Path]
):
    """The pictures of the cycle go through files and the whole pipeline, at full resolution."""
    exposure_s, setup = cycled.found.exposure_s, cycled.found.setup
    frames = []
    for name, picture in cycled.pictures.items():
        file = f"{name.replace(' ', '-')}.tif"
        tifffile.imwrite(tmp_path / file, picture.pixels)
        about = {"file": file, "exposure_s": exposure_s}
        if name == "black":
            frames.append({**about, "role": "black"})
        else:
            shift = int(name.split()[1])
            frames.append({**about, "role": "stripes", "shift": shift, "shifts": 6})
    manifest = write_manifest(tmp_path, frames, **setup)
    run = labrig.analyse(labrig.import_session(manifest, tmp_path / "out")).run
    first = decompose(cycled.found)
    for fitted in (first, decompose(cycled.found, first)):
        for name, key in (("sigma_t", "sigma_t_per_mm"), ("sigma_s", "sigma_s_per_mm"), ("g", "g")):
            value, std = getattr(fitted, name)
            assert abs(value - value_of(run[key])) < 2.0 * std, name  # measured worst 0.96


def test_a_fit_that_begins_at_the_last_one_finds_what_one_from_nothing_does(cycled: Cycled):
    first = decompose(cycled.found)
    again = decompose(cycled.found, first)
    for name in TRUTH:
        value, std = getattr(first, name)
        assert abs(getattr(again, name)[0] - value) < 0.2 * std  # measured worst 0.045
    # another sample was put in: its fit begins from nothing
    wrong = replace(first, sigma_t=(0.2, 1e-3), sigma_s=(0.02, 1e-3), g=(0.6, 1e-2))
    other = decompose(cycled.found, wrong)
    assert [getattr(other, name) for name in TRUTH] == [getattr(first, name) for name in TRUTH]


def test_what_stops_a_fit_is_said(cycled: Cycled):
    dark = replace(cycled.found, counts=np.full_like(cycled.found.counts, 16.0))
    fitted = decompose(dark)
    assert fitted.why != ""
    assert fitted.sigma_s is None
    assert not fitted.holds
    lost = cycled.found.counts.copy()
    lost[:, :, :8] = np.nan  # clipped near the face
    assert decompose(replace(cycled.found, counts=lost)).sigma_t is not None


@pytest.mark.parametrize(
    ("period_px", "shifts", "n"),
    [(18.0, 6, 4), (9.0, 6, 2), (17.9999, 6, 4), (6.0, 6, 1), (80, 6, 8)],
)
def test_cells_tell_the_harmonics_of_the_stripes_apart(period_px: float, shifts: int, n: int):
    assert binned_for(period_px, shifts) == n
    if n == 1:
        return
    # harmonics h and h - N, on the cells' grid: no two waves are alike
    apart = math.remainder(shifts * n / period_px, 1.0)
    assert abs(apart) > 0.05
    assert period_px / n >= 4.0


def test_stripes_cycle_shortly_and_the_exposure_comes_back(
    small_rig: Path, small_scene: Path, small_plan: Path
):
    plan = labrig.load_plan(small_plan)
    with labrig.open_rig(small_rig, small_scene, plan) as rig:
        live = Live(rig, plan)
        live.expose(0.2, 0.0)
        live.show("cycle")
        assert live.take().exposure_s == pytest.approx(CYCLE_S)
        live.show("white")
        assert live.take().exposure_s == 0.2
        live.stop()


def test_the_window_fits_live_and_marks_age_and_uncertainty(window: Window):
    """D opens the drawer: every new set gives numbers with ±, their age, and a bar of it."""
    live = window.app.live
    window.key("Key-d", live.pane)
    panel = live.drawer.live
    assert window.pump(lambda: panel.count > 1), window.log
    fitted = panel.fitted
    for name, truth in TRUTH.items():
        value, sure = (label.cget("text") for label in panel.rows[name])
        shown, std = getattr(fitted, name)
        assert float(value) == pytest.approx(shown, abs=1e-3 if name == "g" else 1e-4)
        assert float(sure.split()[1]) == pytest.approx(std, rel=0.5)
        assert abs(shown - truth) < 6.0 * std  # measured worst 0.9
    assert "s since its first picture" in panel.age.cget("text")
    panel.fitted = replace(fitted, taken_s=fitted.taken_s - 2.0 * OLD_S)
    panel.tell_age()
    assert "old" in panel.age.cget("text")
    assert "σₜ" in window.app.capture.expected.cget("text")
    window.key("Key-d", live.pane)
    assert live.drawer.open == ""
    assert window.pump(lambda: live.picture.shows == "stripes")
