"""Kill it anywhere: nothing that was acknowledged is lost, and the resumed session is the same."""

from __future__ import annotations

import os
import random
import shutil
import signal
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import toy
from deadlines import ends_within

from labrig.acquisition.run_state import Command, State
from labrig.acquisition.sequence import Step
from labrig.errors import RunError, SessionError, SessionLockedError
from labrig.session import Session, verify
from labrig.session.items import Item
from labrig.session.recovery import reopen
from labrig.session.writer import SessionWriter

# `make torture` kills 500 times
KILLS = int(os.environ.get("LABRIG_KILLS", "50"))
LATEST_S = 0.35


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    _, session = toy.capture(tmp_path_factory.mktemp("unbroken"))
    return toy.pixels(session)


def same(session: Session, frames: dict[str, np.ndarray]) -> None:
    assert session.sealed
    assert verify(session.path) == []
    for shot, expected in frames.items():
        np.testing.assert_array_equal(session.read(shot), expected)


def kept(path: Path, shot: str) -> bool:
    """Whether a frame of a shot is there: good, or set aside with its torn group."""
    return (path / "frames" / f"{shot}.tif").exists() or any(
        (path / "rejected").glob(f"{shot}-a*.tif")
    )


def forked(work, kill_after_s: float | None) -> tuple[list[str], int]:
    """Run work in a forked child that says things; return what, and the signal that ended it."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        # Python 3.12 warns of forks beside threads; the child uses none of its parent's
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        os.close(reading)
        try:
            work(lambda text: os.write(writing, f"{text}\n".encode()))
        finally:
            os._exit(0)
    os.close(writing)
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    with os.fdopen(reading) as stream:
        return stream.read().split(), os.WTERMSIG(status)


def test_r1_kills_at_random_moments_lose_nothing(unbroken, tmp_path: Path) -> None:
    rng = random.Random(5)  # noqa: S311 - moments of death need no secrecy
    kills = 0
    while kills < KILLS:
        root = tmp_path / str(kills)

        def capture(say, root=root) -> None:
            with toy.rig_of() as rig:
                runner = toy.prepare(toy.plan_of(), rig, root)
                runner.subscribe(lambda e: e.kind == "saved" and say(e.text))
                toy.run(runner)

        acknowledged, _ = forked(capture, rng.uniform(0.0, LATEST_S))
        kills += 1
        found = [p.parent for p in root.glob("*/*/session.json")]
        if not found:
            assert acknowledged == []
            continue
        path = found[0]

        def resume(say, path=path) -> None:
            with toy.rig_of() as rig:
                runner = toy.prepare_resume(path, rig)
                runner.subscribe(lambda e: e.kind == "saved" and say(e.text))
                toy.run(runner)

        if kills < KILLS and not (path / "SEAL.json").exists() and rng.random() < 0.3:
            acknowledged += forked(resume, rng.uniform(0.0, LATEST_S))[0]
            kills += 1
        lost = [shot for shot in acknowledged if not kept(path, shot)]
        assert lost == []
        if not (path / "SEAL.json").exists():
            finish, _ = toy.resume(path)
            assert finish.status.state is State.COMPLETED, finish.status.reason
        same(Session.open(path), unbroken)
        shutil.rmtree(root)


@pytest.mark.parametrize("step", [Step.SHOW, Step.EXPOSE, Step.COLLECT, Step.COMMIT])
def test_r1_killed_at_a_step_it_resumes_to_the_same_frames(step, unbroken, tmp_path: Path) -> None:
    fault = {"kind": "kill", "shot": "stripes-e1-r0-p01", "step": step}
    _, how = forked(lambda _say: toy.capture(tmp_path, fault), None)
    assert how == signal.SIGKILL
    (path,) = (p.parent for p in tmp_path.glob("*/*/session.json"))
    finish, session = toy.resume(path)
    assert finish.status.state is State.COMPLETED, finish.status.reason
    same(session, unbroken)
    # the torn group is of one segment, and the journal says that it began again
    segments = {f.details["segment"] for s, f in session.frames.items() if "stripes-e1" in s}
    assert segments == {2}
    with pytest.raises(SessionError, match="nothing to resume"):
        toy.resume(path)


def interrupted(tmp_path: Path) -> Path:
    """A session whose run failed at its seventh shot."""
    finish, session = toy.capture(
        tmp_path, {"kind": "drop", "shot": "stripes-e1-r0-p00", "times": 99}
    )
    assert finish.status.state is State.ABORTED
    return session.path


def test_resume_asks_for_room_for_what_is_missing_alone(
    unbroken, tmp_path: Path, monkeypatch
) -> None:
    path = interrupted(tmp_path)
    free = int(6 * 1.1 * (2 * toy.SIZE**2 + 2048)) + 1
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=free))
    finish, _ = toy.capture(tmp_path / "whole")
    assert finish.status.state is State.REFUSED
    assert "make room" in finish.status.reason
    finish, session = toy.resume(path)
    assert finish.status.state is State.COMPLETED
    same(session, unbroken)


def test_an_aborted_session_is_sealed_and_can_still_be_resumed(unbroken, tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    assert (path / "SEAL.json").exists()
    finish, session = toy.resume(path)
    assert finish.status.state is State.COMPLETED
    same(session, unbroken)
    assert (path / "quarantine" / "SEAL.json").exists()


def test_strays_parts_and_torn_lines_go_to_quarantine(unbroken, tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    (path / "SEAL.json").unlink()
    (path / "frames" / "white-e1-r0.tif").write_bytes(b"orphan")
    (path / "frames" / "dark-e1-r0.tif.part").write_bytes(b"half")
    with (path / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"event":"commit","shot":"white-e')
    finish, session = toy.resume(path)
    assert finish.status.state is State.COMPLETED
    same(session, unbroken)
    found = {file.name for file in (path / "quarantine").iterdir()}
    assert found == {"white-e1-r0.tif", "dark-e1-r0.tif-part", "torn-line"}
    (line,) = [e for e in session.events if e.get("after") == "interruption"]
    assert len(line["quarantined"]) == 3


@pytest.mark.parametrize("how", ["deleted", "flipped", "cut"])
def test_a_committed_frame_that_was_damaged_is_taken_again(how, unbroken, tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    file = path / "frames" / "white-e0-r0.tif"
    content = bytearray(file.read_bytes())
    if how == "deleted":
        file.unlink()
    else:
        content[-9] ^= 1
        file.write_bytes(content if how == "flipped" else content[:-100])
    finish, session = toy.resume(path)
    assert finish.status.state is State.COMPLETED
    same(session, unbroken)
    assert [e["shot"] for e in session.events if e.get("lost") is True] == ["white-e0-r0"]


def test_resume_refuses_another_camera_naming_the_difference(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    before = sorted(p.name for p in path.rglob("*"))
    with pytest.raises(RunError, match=r"camera\.serial was 'sim-1', is 'sim-2'"):
        toy.resume(path, camera={"seed": 2})
    with pytest.raises(RunError, match=r"refresh_hz was 60\.0, is 75\.0"):
        toy.resume(path, projector={"refresh_hz": 75})
    with pytest.raises(RunError, match=r"geometry\.mm_per_px was 0\.5, is 0\.4"):
        toy.resume(path, geometry={"mm_per_px": 0.4})
    assert sorted(p.name for p in path.rglob("*")) == before


def test_damage_inside_the_journal_is_not_resumed(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    journal = path / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"attempt":1', b'"attempt":2', 1))
    with pytest.raises(SessionError, match="is damaged in line"):
        toy.resume(path)


def test_r6_a_session_being_written_is_not_resumed(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", {"shots": [{"id": "a"}]}) as writer:

        def refuse():
            with pytest.raises(SessionLockedError, match=f"pid {os.getpid()}"):
                reopen(writer.path)

        assert ends_within(0.1, refuse)  # measured 1.5 ms


def test_r8_recovery_of_672_frames_is_quick(tmp_path: Path) -> None:
    shots = [{"id": f"s{n}"} for n in range(672)]
    picture = np.random.default_rng(1).integers(0, 4096, (64, 64), dtype=np.uint16)
    writer = SessionWriter.create(tmp_path, "many", {"shots": shots})
    for first in range(0, 672, 84):
        writer.keep(
            [
                Item(event="commit", shot=s["id"], attempt=1, pixels=picture)
                for s in shots[first : first + 84]
            ]
        )
    writer.leave("failed", "left for the test")
    begun = time.process_time()
    again, recovery = reopen(writer.path)
    took_s = time.process_time() - begun
    again.leave("failed", "left for the test")
    assert recovery.saved == 672
    # measured 0.15 s of CPU; R8 asks for 2 s, which the bench measures with frames of full size
    assert took_s < 2.0


def test_pause_longer_than_the_gap_repeats_the_group(unbroken, tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)

        def hear(event) -> None:
            if event.kind == "step" and event.status.shot == "stripes-e0-r0-p01" and not paused:
                paused.append(True)
                runner.post(Command.PAUSE)
            if event.kind == "state" and event.status.state is State.PAUSED:
                rig.clock.sleep(31.0)

        paused: list[bool] = []
        runner.subscribe(hear)
        finish, session = toy.run(runner, Command.RESUME)
    assert finish.status.state is State.COMPLETED
    voided = [e["shot"] for e in session.events if e["event"] == "void"]
    assert voided[:2] == ["stripes-e0-r0-p00", "stripes-e0-r0-p01"]
    same(session, unbroken)
