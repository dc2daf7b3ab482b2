"""The commands of acquisition, and what they leave alone."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import toy

import labrig
from drivers.errors import SettingRefusedError
from labrig.acquisition.capturing import capture
from labrig.acquisition.estimate import estimate
from labrig.acquisition.probe import resolve
from labrig.acquisition.run_state import State
from labrig.errors import RunError
from labrig.plan import blocks_of, expand
from labrig.session import Session
from labrig.session.lock import holder


def test_check_prints_costs_and_verdicts(command, small_plan, small_rig, tmp_path) -> None:
    said = command("check", small_plan, "--rig", small_rig, "--out", tmp_path, "--json")
    assert said.code == 0
    found = json.loads(said.out)
    assert found["n_shots"] == 20
    assert found["seconds"]["exposure"] == pytest.approx(10 * (0.05 + 0.4))
    assert found["other_order"]["settle"] == pytest.approx(found["seconds"]["settle"] / 2)
    assert {v["name"] for v in found["verdicts"]} >= {"axis", "exposures", "latency", "disk"}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("rig: {require: [projector.height >= 720]}", "the rig has 24; use another rig"),
        ("rig: {require: [camera.colour]}", "is not understood"),
        ("calibration: {projector_latency_max_age_h: 8}", "run labrig calibrate latency"),
    ],
)
def test_check_says_what_would_be_refused(line, why, command, small_plan, small_rig, tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_text(small_plan.read_text() + line + "\n")
    said = command("check", plan, "--rig", small_rig)
    assert said.code == 2
    assert "refused" in said.out
    assert why in said.out


def test_latency_capture_resume_and_list(command, small_plan, small_rig, small_scene, tmp_path):
    rig = shutil.copy(small_rig, tmp_path / "rig.yaml")
    devices = ("--rig", rig, "--scene", small_scene)
    said = command("calibrate", "latency", *devices, "--flips", 10, "--json")
    assert said.code == 0, said.err
    assert (tmp_path / "rig.latency.yaml").exists()
    faults = "simulation: {faults: [{kind: drop, shot: white-e1-r0, times: 9}]}\n"
    rig.write_text(rig.read_text() + faults)
    said = command("capture", small_plan, *devices, "--out", tmp_path / "data")
    assert said.code == 4
    assert "labrig resume" in said.err
    (path,) = (tmp_path / "data").glob("*/*/")
    said = command("ls", tmp_path / "data", "--json")
    assert [(e["state"], e["saved"]) for e in json.loads(said.out)] == [("aborted", 16)]
    other = tmp_path / "other.yaml"
    other.write_text(small_rig.read_text().replace("refresh_hz: 60", "refresh_hz: 75"))
    said = command("resume", path, "--rig", other)
    assert said.code == 4
    assert "refresh_hz was 60.0, is 75.0" in said.err
    # measured anew meanwhile, which is no other rig
    again = shutil.copy(small_rig, tmp_path / "again.yaml")
    devices = ("--rig", again, "--scene", small_scene)
    assert command("calibrate", "latency", *devices, "--flips", 20).code == 0
    said = command("resume", path, "--rig", again)
    assert (said.code, said.out.strip()) == (0, str(path)), said.err
    assert command("verify", path).code == 0
    assert json.loads(command("ls", tmp_path / "data", "--json").out)[0]["state"] == "completed"
    said = command("resume", path)
    assert said.code == 3
    assert "nothing to resume" in said.err


def test_ctrl_c_again_and_again_leaves_a_session_that_can_be_resumed(
    command, small_plan, small_rig, small_scene, small_session, tmp_path
) -> None:
    """A real process in real time; the light of the scene is there, the shared session made it."""
    rig = shutil.copy(small_rig, tmp_path / "rig.yaml")
    rig.write_text(rig.read_text() + "simulation: {clock: real}\n")
    code = "import sys; from labrig.cli import main; main()"
    words = ["capture", small_plan, "--rig", rig, "--scene", small_scene, "--out", tmp_path / "d"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *map(str, words)], stderr=subprocess.PIPE, text=True
    ) as child:
        until = time.monotonic() + 300.0
        while not list((tmp_path / "d").glob("*/*/frames/*.tif")):
            assert child.poll() is None
            assert time.monotonic() < until
            time.sleep(0.02)
        while child.poll() is None:
            assert time.monotonic() < until
            child.send_signal(signal.SIGINT)
            time.sleep(0.005)
        _, said = child.communicate(timeout=300.0)
    assert child.returncode == 130
    assert said == "labrig: interrupted; what was saved stays saved.\n"
    (path,) = (tmp_path / "d").glob("*/*/")
    session = Session.open(path)
    assert session.sealed
    assert session.events[-1]["outcome"] == "aborted"
    assert session.missing
    assert holder(path) is None
    rig.write_text(small_rig.read_text())
    said = command("resume", path, "--rig", rig)
    assert said.code == 0, said.err
    assert command("verify", path).code == 0


def test_doctor_names_what_is_missing_and_the_remedy(command, small_rig, tmp_path) -> None:
    said = command("doctor", "--rig", small_rig, "--out", tmp_path, "--json")
    assert said.code == 0
    found = {finding["name"]: finding for finding in json.loads(said.out)}
    assert {"python", "tkinter", "display", "cameras", "serial ports", "disk", "rig"} <= set(found)
    assert all(finding["ok"] or finding["remedy"] for finding in found.values())
    assert "fsync" in found["disk"]["text"]
    assert list(tmp_path.iterdir()) == []


def test_doctor_fails_where_a_device_of_the_rig_is_missing(command, tmp_path) -> None:
    bench = (labrig.config_folder() / "rigs" / "bench.yaml").read_text(encoding="utf-8")
    rig = tmp_path / "bench.yaml"
    rig.write_text(bench, encoding="utf-8")
    said = command("doctor", "--rig", rig, "--out", tmp_path)
    assert said.code == 4
    assert "to mend: plug it in" in said.out
    # what no rig needs may be missing
    assert command("doctor", "--out", tmp_path).code == 0


def test_reading_a_session_leaves_it_as_it_was(command, session_copy: Path) -> None:
    """R13 without a mount: what never writes can be done on read-only media."""

    def state() -> list[tuple[str, int]]:
        return sorted((str(p), p.stat().st_mtime_ns) for p in session_copy.rglob("*"))

    before = state()
    assert command("verify", session_copy).code == 0
    said = command("analyse", session_copy, "--out", session_copy.parent / "elsewhere")
    assert said.code == 0, said.err
    assert state() == before


def test_pattern_outermost_keeps_a_bracket_together() -> None:
    plan = toy.plan_of(order={"outer": "pattern"})
    with toy.rig_of() as rig:
        shots = expand(plan, rig.config).shots
    assert [s.id for s in shots[:4]] == [f"stripes-e{k % 2}-r0-p{k // 2:02d}" for k in range(4)]
    assert [len(block) for block in blocks_of(shots)] == [8, 1, 1, 1, 1]


def test_reference_sets_come_again_between_groups() -> None:
    sets = [*toy.PLAN["sets"][:1], {"id": "w", "pattern": {"kind": "uniform"}, "every": 4}]
    sets[0] = {**sets[0], "repeats": 2}
    with toy.rig_of() as rig:
        shots = expand(toy.plan_of(sets=sets), rig.config).shots
    first = [s.group for s in shots if s.group.endswith(("e0-r0", "e0-r1", "e0-r2"))]
    assert list(dict.fromkeys(first)) == [
        "stripes-e0-r0",
        "w-e0-r0",
        "stripes-e0-r1",
        "w-e0-r1",
        "w-e0-r2",
    ]


def test_estimate_is_what_the_run_takes(tmp_path: Path) -> None:
    plan = toy.plan_of()
    with toy.rig_of() as rig:
        wanted = estimate(expand(plan, rig.config), rig.config).seconds
        begun_s = rig.now_s()
        capture(plan, rig, tmp_path)
        took_s = rig.now_s() - begun_s
    # measured equal to 4e-16; writing costs no virtual time
    assert took_s == pytest.approx(wanted.total - wanted.writing, rel=1e-6)


def test_automatic_bracket_reaches_its_target(tmp_path: Path) -> None:
    plan = toy.plan_of(exposures={"bracket_s": None, "auto": {"target": 0.7, "steps": 2}})
    with toy.rig_of() as rig:
        bracket_s = resolve(plan, rig).exposures.bracket_s
    # 0.7 of 4079 DN, at 60 300 e/s and 0.28 DN/e; measured 8.2 % less, for the noise of the
    # brightest thousandth, three standard deviations of a dim probe, counts as light
    assert bracket_s[0] == pytest.approx(0.7 * 4079 / 0.28 / 60_300, rel=0.1)
    assert bracket_s[1] == pytest.approx(4 * bracket_s[0], rel=1e-4)


def replay_rig(folder: Path, session: Session, **camera: object) -> Path:
    """Return a rig file whose camera is a recorded session of the toy rig."""
    kept = {k: v for k, v in toy.RIG["camera"].items() if k not in ("driver", "readout_s")}
    entry = {"driver": "replay", "session": str(session.path), **kept, **camera}
    file = folder / "replay.yaml"
    file.write_text(json.dumps({**toy.RIG, "camera": entry}), encoding="utf-8")
    return file


@pytest.mark.parametrize("bracket_s", [[0.05, 0.1], [0.1]])
def test_recorded_session_is_a_camera(bracket_s, tmp_path: Path) -> None:
    """The plan run again before the recording gives the same frames, and no scene is needed."""
    changes = {
        "exposures": {"bracket_s": bracket_s},
        "sets": [*toy.PLAN["sets"], {"id": "black", "pattern": {"kind": "black"}}],
    }
    finish, session = toy.capture(tmp_path / "first", plan=changes)
    assert finish.status.state is State.COMPLETED
    plan = toy.plan_of(**changes)
    with labrig.open_rig(replay_rig(tmp_path, session), None, plan) as rig:
        again = Session.open(capture(plan, rig, tmp_path / "again"))
    assert again.header["devices"]["camera"]["serial"] == session.path.name
    assert labrig.verify(again.path) == []
    for shot, pixels in toy.pixels(session).items():
        np.testing.assert_array_equal(again.read(shot), pixels)


def test_recording_refuses_what_it_does_not_hold(tmp_path: Path) -> None:
    _, session = toy.capture(tmp_path / "first")
    plan = toy.plan_of(exposures={"bracket_s": [0.07]})
    with (
        labrig.open_rig(replay_rig(tmp_path, session), None, plan) as rig,
        pytest.raises(SettingRefusedError, match=r"0\.07 s was not recorded"),
    ):
        capture(plan, rig, tmp_path / "again")
    with pytest.raises(RunError, match=r"camera\.bits is 10, that of session .* 12"):
        labrig.open_rig(replay_rig(tmp_path, session, bits=10, white_level_dn=1023), None, plan)


def test_simulated_rig_needs_a_scene(command, small_rig, small_plan, tmp_path) -> None:
    said = command("capture", small_plan, "--rig", small_rig, "--out", tmp_path)
    assert said.code != 0
    assert "is simulated and looks at a scene: give one with --scene" in said.err
    assert len(said.err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
