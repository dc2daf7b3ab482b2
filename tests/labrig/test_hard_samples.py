"""Samples that do not tell all: what cannot be determined is said, what can is given."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

import labrig
from labrig.session import Session, SessionWriter
from labrig.session.writer import HEADER_KEYS

Captured = Callable[..., Path]


@pytest.fixture
def captured(small_rig: Path, small_scene: Path, small_plan: Path, tmp_path: Path) -> Captured:
    """Return ``captured(medium=, light=, bracket_s=, period_px=)``: the small session, changed."""

    def capture(
        medium: dict[str, float] | None = None,
        light: dict[str, float] | None = None,
        bracket_s: list[float] | None = None,
        period_px: int = 12,
    ) -> Path:
        scene, plan = (yaml.safe_load(p.read_text("utf-8")) for p in (small_scene, small_plan))
        scene["medium"] |= medium or {}
        scene["light"] |= light or {}
        plan["exposures"]["bracket_s"] = bracket_s or plan["exposures"]["bracket_s"]
        plan["sets"][0]["pattern"]["period_px"] = period_px
        for name, content in (("scene", scene), ("plan", plan)):
            (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        what = labrig.load_plan(tmp_path / "plan.yaml")
        with labrig.open_rig(small_rig, labrig.load_scene(tmp_path / "scene.yaml"), what) as rig:
            return labrig.capture(what, rig, tmp_path / "data")

    return capture


def said(run: dict[str, Any], words: str) -> bool:
    return any(words in note for note in run["notes"])


def test_without_multiple_scattering_g_is_not_invented(captured, coarse, command, tmp_path) -> None:
    path = captured(medium={"sigma_s_per_mm": 0.0})
    result = labrig.analyse(path, coarse)
    run = result.run
    assert (run["g"]["value"], run["g"]["std"]) == (None, None)
    assert said(run, "g cannot be determined")
    # measured -0.02 % and 7e-5 per mm
    assert run["sigma_t_per_mm"]["value"] == pytest.approx(0.3, rel=1e-3)
    assert abs(run["sigma_s_per_mm"]["value"]) < 1e-3
    assert "not determined" in labrig.report(result.path, tmp_path / "page").read_text("utf-8")
    printed = command("analyse", path, "--config", coarse)
    assert (printed.code, "not determined" in printed.out) == (0, True)


def test_a_saturated_entry_is_left_out_and_said(captured, coarse) -> None:
    run = labrig.analyse(captured(bracket_s=[0.8]), coarse).run
    assert said(run, "are saturated in every exposure and left out")
    found = run["sigma_t_per_mm"]
    std = (found["std"] ** 2 + found["model_std"] ** 2) ** 0.5
    # measured 0.3 std off, from depths of 10 mm on
    assert abs(found["value"] - 0.3) < 3.0 * std
    assert run["quality"]["stripe_aware"]["depth_range"][0] > 3.0


def test_stripes_too_coarse_for_the_beam_leave_the_paper_s_values_without_std(
    captured, coarse
) -> None:
    run = labrig.analyse(captured(period_px=48), coarse).run
    assert said(run, "too coarse for a beam")
    assert said(run, "no stripes are seen within the beam")
    assert run["method"]["parameters"].startswith("Eqs. 9 and 10")
    assert (run["sigma_s_per_mm"]["std"], run["g"]["std"]) == (None, None)
    assert "unseparated" in run["alternatives"]


def test_a_tank_narrower_than_the_free_path_is_left_to_the_paper_s_way(captured, coarse) -> None:
    run = labrig.analyse(captured(medium={"sigma_t_per_mm": 0.03, "sigma_s_per_mm": 0.015}), coarse)
    assert said(run.run, "side walls take away most of the multiple scattering")
    # measured -0.2 %
    assert run.run["sigma_t_per_mm"]["value"] == pytest.approx(0.03, rel=0.02)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"light": {"peak_e_per_s": 20.0}}, "no signal"),
        ({"medium": {"sigma_t_per_mm": 5.0, "sigma_s_per_mm": 2.5}}, "sigma_t cannot be resolved"),
    ],
    ids=["dark", "thick"],
)
def test_what_tells_nothing_is_refused_in_a_line(captured, coarse, command, changed, words) -> None:
    refused = command("analyse", captured(**changed), "--config", coarse)
    assert refused.code == 2
    assert refused.err.startswith("labrig: ")
    assert words in refused.err
    assert refused.err.count("\n") == 1


def without(session: Session, lost: set[str], parent: Path) -> Path:
    """Write a session anew, some shots left out."""
    header = {key: value for key, value in session.header.items() if key not in HEADER_KEYS}
    with SessionWriter.create(parent, "lost", header) as writer:
        for shot in session.shots:
            if shot["id"] not in lost:
                pixels = session.read(shot["id"])
                writer.commit(shot["id"], 1, pixels, {})
        writer.close("aborted")
        return writer.path


def test_a_lost_shift_is_what_its_opposite_leaves(small_session, coarse, tmp_path) -> None:
    session = Session.open(small_session)
    stripes = [s["id"] for s in session.shots if s.get("role") == "stripes" and s["shift"] == 2]
    path = without(session, set(stripes), tmp_path / "a")
    found = labrig.analyse(path, coarse).run
    whole = labrig.analyse(small_session, coarse, out=tmp_path / "whole").run
    assert said(found, "its picture is what the opposite shift leaves")
    for name in ("sigma_t_per_mm", "sigma_s_per_mm", "g"):
        # measured worst 1.2 std of the noise, sigma_s
        assert abs(found[name]["value"] - whole[name]["value"]) < 3.0 * whole[name]["std"]


def test_two_lost_shifts_are_refused(small_session, coarse, complaint, tmp_path) -> None:
    session = Session.open(small_session)
    lost = {s["id"] for s in session.shots if s.get("role") == "stripes" and s["shift"] in {1, 2}}
    path = without(session, lost, tmp_path)
    assert "4 of 20 shots are missing" in complaint("analyse", path, "--config", coarse, code=2)
    shutil.rmtree(path)
    lost = {s["id"] for s in session.shots if s.get("role") == "white"}
    path = without(session, lost, tmp_path)
    assert "2 of 20 shots are missing" in complaint("analyse", path, "--config", coarse, code=2)
