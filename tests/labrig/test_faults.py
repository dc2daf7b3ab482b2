"""Whatever goes wrong, the frames are those of an undisturbed run, and the journal says why."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy

from labrig.acquisition.run_state import Command, State
from labrig.session import Session, verify

SHOT = "stripes-e1-r0-p02"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    finish, session = toy.capture(tmp_path_factory.mktemp("undisturbed"))
    assert finish.status.state is State.COMPLETED
    assert session is not None
    return toy.pixels(session)


def causes(session: Session) -> list[str]:
    """The causes that the journal names, in order."""
    return [e["cause"] for e in session.events if "cause" in e]


FAULTS = [
    ("drop", {}, ["no-frame"]),
    ("delay", {"seconds": 0.5}, []),
    ("delay", {"seconds": 5.0}, ["no-frame"]),
    ("duplicate", {}, ["duplicate"]),
    ("repeat-bytes", {}, ["duplicate"]),
    ("corrupt", {}, ["corrupt"]),
    ("flagged", {}, ["corrupt"]),
    ("gap", {}, []),
    ("wrong-exposure", {}, ["wrong-exposure"]),
    ("hidden-exposure", {}, ["wrong-exposure"]),
    ("hidden-exposure", {"factor": 0.5}, ["wrong-exposure"]),
    ("stuck-trigger", {}, []),
    ("stuck-trigger", {"times": 2}, ["trigger-not-fired"]),
    ("silent-trigger", {}, ["no-frame"]),
    ("camera-lost", {}, ["device-lost"]),
    ("projector-lost", {}, ["device-lost"]),
    ("wrong-pattern", {}, ["wrong-pattern"]),
]


@pytest.mark.parametrize(("kind", "how", "journaled"), FAULTS)
def test_fault_is_mended_and_explained(kind, how, journaled, undisturbed, tmp_path: Path) -> None:
    finish, session = toy.capture(tmp_path, {"kind": kind, "shot": SHOT, **how})
    assert finish.status.state is State.COMPLETED, finish.status.reason
    assert causes(session) == journaled
    found = toy.pixels(session)
    for shot, expected in undisturbed.items():
        np.testing.assert_array_equal(found[shot], expected)
    assert verify(session.path) == []
    if kind.endswith("-lost"):
        assert {e["shot"] for e in session.events if e["event"] == "void"} == {
            "stripes-e1-r0-p00",
            "stripes-e1-r0-p01",
        }
    line = session.frames[SHOT].details
    assert line.get("gap") == (3 if kind == "gap" else line.get("gap"))
    assert ("fired_again" in line) == (kind == "stuck-trigger" and "times" not in how)


def test_box_that_does_not_fire_is_told_from_a_lost_frame(undisturbed, tmp_path: Path) -> None:
    fault = {"kind": "silent-trigger", "shot": SHOT}
    box = {"trigger": {"driver": "simulated"}}
    finish, session = toy.capture(tmp_path, fault, **box)
    assert finish.status.state is State.COMPLETED
    # its counter did not rise: no frame was lost, and none is counted as lost
    assert causes(session) == ["trigger-not-fired"]
    assert finish.status.failures == 0
    np.testing.assert_array_equal(session.read(SHOT), undisturbed[SHOT])


@pytest.mark.parametrize("times", [1, 2])
def test_full_disk_pauses_and_the_frame_is_taken_again(times, undisturbed, tmp_path: Path) -> None:
    # the last shot: its frame is surely written while the script is at it
    fault = {"kind": "disk-full", "shot": "dark-e1-r0", "times": times}
    finish, session = toy.capture(tmp_path, fault, answers=(Command.RESUME,) * times)
    assert finish.status.state is State.COMPLETED, finish.status.reason
    pauses = [e for e in session.events if e["event"] == "pause"]
    assert any("No space left" in e["reason"] for e in pauses)
    found = toy.pixels(session)
    for shot, expected in undisturbed.items():
        np.testing.assert_array_equal(found[shot], expected)
    assert verify(session.path) == []


def test_second_loss_of_a_device_pauses(tmp_path: Path) -> None:
    faults = [{"kind": "camera-lost", "shot": shot} for shot in ("white-e0-r0", SHOT)]
    finish, session = toy.capture(tmp_path, *faults, answers=(Command.RESUME,))
    assert finish.status.state is State.COMPLETED
    (pause,) = [e for e in session.events if e["event"] == "pause"]
    assert "second loss" in pause["reason"]


def test_cause_that_does_not_go_away_pauses_and_then_aborts(tmp_path: Path) -> None:
    finish, session = toy.capture(tmp_path, {"kind": "drop", "shot": SHOT, "times": 99})
    assert finish.status.state is State.ABORTED
    assert causes(session) == ["no-frame"] * 3
    assert SHOT in session.missing
    assert session.sealed


@pytest.mark.parametrize(
    ("camera", "proof"),
    [
        ({"timestamp_source": "start", "uncertainty_s": 0.002}, "timestamped"),
        ({"timestamp_source": "end", "exposure_latency_frames": 2}, "timestamped"),
        ({"timestamp_source": "none"}, "count"),
        ({"timestamp_source": "arrival", "exposure_latency_frames": 2}, "count"),
        ({"exposure_report": "none", "exposure_latency_frames": 2}, "timestamped"),
        (
            {
                "exposure_report": "none",
                "exposure_latency_frames": 2,
                "timestamp_source": "none",
            },
            "count",
        ),
    ],
)
def test_free_running_camera_gives_the_same_frames(camera, proof, undisturbed, tmp_path) -> None:
    finish, session = toy.capture(tmp_path, trigger={"driver": "free-run"}, camera=camera)
    assert finish.status.state is State.COMPLETED, finish.status.reason
    assert causes(session) == []
    assert {frame.details["proof"] for frame in session.frames.values()} == {proof}
    for shot, expected in undisturbed.items():
        np.testing.assert_array_equal(session.read(shot), expected)


@pytest.mark.parametrize("driver", ["software", "simulated"])
def test_old_exposures_in_the_pipeline_are_thrown_away(driver, undisturbed, tmp_path) -> None:
    camera = {"exposure_latency_frames": 3}
    finish, session = toy.capture(tmp_path, trigger={"driver": driver}, camera=camera)
    assert finish.status.state is State.COMPLETED
    assert causes(session) == []
    assert session.frames["stripes-e1-r0-p00"].details["discarded"] == 3
    for shot, expected in undisturbed.items():
        np.testing.assert_array_equal(session.read(shot), expected)


def test_camera_that_hides_its_latency_is_caught_by_the_report(tmp_path: Path) -> None:
    plan = {"timing": {"discard_after_exposure_change": 0}}
    with toy.rig_of(camera={"exposure_latency_frames": 1}) as rig:
        # a driver that claims to have no latency
        rig.camera_can = replace(rig.camera_can, exposure_latency_frames=0)
        finish, session = toy.run(toy.prepare(toy.plan_of(**plan), rig, tmp_path))
    assert finish.status.state is State.COMPLETED
    assert set(causes(session)) == {"wrong-exposure"}
    for frame in session.frames.values():
        assert frame.details["exposure_reported_s"] == frame.details["exposure_asked_s"]
