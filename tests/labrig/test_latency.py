"""Latency measured by flips is the one the simulated projector has, and guards every run."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import toy

import labrig
from calibration.errors import CalibrationError
from labrig.acquisition.latency import measure_latency
from labrig.acquisition.run_state import State
from labrig.errors import RunError

PERIOD_S = 1 / 60


@pytest.mark.parametrize("fade_s", [0.0, 0.004])
def test_flips_find_latency_and_settling(fade_s) -> None:
    projector = {"latency_s": 0.03, "jitter_s": 0.01, "fade_s": fade_s}
    with toy.rig_of(projector=projector) as rig:
        found = measure_latency(rig)
    # light comes 30 to 57 ms after the request: latency, jitter, wait for the next refresh;
    # a fading light is seen to come up to a time constant late
    assert 0.0 < found.earliest_s < 0.030 + 1e-9
    assert 0.030 + 0.010 + PERIOD_S < found.latest_s < 0.030 + 0.010 + 3 * PERIOD_S + fade_s
    # a fade is within 0.5 % after 5.3 time constants; measured 40 and 46 ms: known by the end of
    # a frame, of which the longer have 40 ms
    assert 5.3 * fade_s <= found.settle_s < 5.3 * fade_s + 0.045
    assert found.timestamps == "start"


def test_time_stamps_that_mean_the_end_are_found_out(monkeypatch) -> None:
    with toy.rig_of() as rig:
        collect = rig.camera.collect

        def late(**how):
            frame = collect(**how)
            return replace(frame, t_start_s=frame.t_start_s + frame.exposure_s)

        monkeypatch.setattr(rig.camera, "collect", late)
        with pytest.raises(RunError, match="found to mean 'end'"):
            measure_latency(rig)


def test_a_camera_that_does_not_see_the_projector_is_told(monkeypatch) -> None:
    with toy.rig_of() as rig:
        rig.cover(covered=True)
        with pytest.raises(CalibrationError, match="let the camera see"):
            measure_latency(rig, flips=10)


def record(rig, **changes):
    return measure_latency(rig).model_copy(update=changes)


def test_run_with_a_latency_that_still_holds_says_so(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        rig.latency = record(rig)
        finish, session = toy.run(toy.prepare(toy.plan_of(), rig, tmp_path))
    assert finish.status.state is State.COMPLETED
    assert any("5 flips agree" in e.get("text", "") for e in session.events)
    assert session.header["calibration"]["projector_latency"]["flips"] == 50


def test_projector_that_became_slower_is_refused_before_a_session_is_made(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        rig.latency = record(rig, latest_s=0.031)
        finish, session = toy.run(toy.prepare(toy.plan_of(), rig, tmp_path))
    assert finish.status.state is State.FAILED
    assert "run labrig calibrate latency" in finish.status.reason
    assert session is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("age_h", [None, 9.0, -2.0])
def test_plan_that_wants_a_fresh_latency_refuses_an_old_one(age_h, tmp_path: Path) -> None:
    plan = toy.plan_of(calibration={"projector_latency_max_age_h": 8})
    with toy.rig_of() as rig:
        if age_h is not None:
            then = datetime.now(UTC) - timedelta(hours=age_h)
            rig.latency = record(rig, date=then.isoformat())
        finish, _ = toy.run(toy.prepare(plan, rig, tmp_path))
    assert finish.status.state is State.REFUSED
    assert isinstance(finish.error, RunError)
    assert list(tmp_path.iterdir()) == []


def test_what_was_shown_before_does_not_spoil_the_first_flip(tmp_path: Path) -> None:
    """An automatic bracket leaves white light behind that is still going when flips begin."""
    plan = toy.plan_of(exposures={"bracket_s": None, "auto": {"target": 0.7, "steps": 2}})
    for seed in (1, 2):
        with toy.rig_of(camera={"seed": seed}) as rig:
            rig.latency = record(rig)
            finish, session = toy.run(toy.prepare(plan, rig, tmp_path / str(seed)))
        assert finish.status.state is State.COMPLETED, finish.status.reason
    # and the record in the header is no calibration that an analysis would look for on the disk
    result = labrig.analyse(session.path, until="separation", out=tmp_path / "results")
    assert result.run["provenance"]["calibration"] == {}
