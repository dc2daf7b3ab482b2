"""The order of system calls, and what follows when any one of them fails."""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import toy

from drivers.errors import FrameCorruptError, NoFrameError
from drivers.waiting import CancelToken
from labrig.acquisition.run_state import Command, State
from labrig.session import Session, verify
from labrig.session.catalogue import FILE, catalogue
from labrig.session.disk import Disk
from labrig.session.items import Item
from labrig.session.keeper import Keeper
from labrig.session.writer import SessionWriter

CALLS = ("open", "write", "fsync", "fdatasync", "replace")
SHORT = -1  # in place of an errno: the call writes half


class Shim:
    """Stands between the program and os: logs calls of one thread kind, and fails the k-th."""

    def __init__(self, patch: pytest.MonkeyPatch, *, fail_at: int = 0, code: int = 0) -> None:
        self.log: list[tuple[str, str]] = []
        self.failed = ""
        self._fail_at, self._code = fail_at, code
        self._names: dict[int, str] = {}
        for name in ("open", "write", "fsync", "fdatasync"):
            patch.setattr(os, name, self._wrap(name, getattr(os, name)))
        patch.setattr(Path, "replace", self._wrap("replace", Path.replace))

    def _wrap(self, name, call):
        def wrapped(first, *rest, **how):
            path = self._names.get(first, "") if isinstance(first, int) else str(first)
            # only what the session's folder sees: a frame, the journal, a folder
            if "/toy" not in path and "_toy_" not in path:
                return call(first, *rest, **how)
            self.log.append((name, Path(path).name))
            if len(self.log) == self._fail_at:
                self.failed = f"{name} {Path(path).name}"
                if self._code == SHORT and name == "write":
                    return call(first, rest[0][: max(len(rest[0]) // 2, 1)])
                raise OSError(max(self._code, errno.EIO), os.strerror(max(self._code, errno.EIO)))
            done = call(first, *rest, **how)
            if name == "open":
                self._names[done] = path
            return done

        return wrapped


def picture() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 4096, (24, 32), dtype=np.uint16)


def test_r2_a_frame_is_on_the_disk_before_its_line_is_written(tmp_path, monkeypatch) -> None:
    with SessionWriter.create(tmp_path, "toy", {"shots": [{"id": "a"}, {"id": "b"}]}) as writer:
        names = {writer._journal: str(writer.path / "journal.jsonl")}
        with monkeypatch.context() as patch:
            shim = Shim(patch)
            shim._names |= names
            writer.commit("a", 1, picture(), {})
        order = [(name, file) for name, file in shim.log if name != "open"]
    assert order == [
        ("write", "a.tif.part"),
        ("fsync", "a.tif.part"),
        ("replace", "a.tif.part"),
        ("fsync", "frames"),
        ("write", "journal.jsonl"),
        ("fdatasync", "journal.jsonl"),
    ]


def test_r2_a_group_shares_the_folder_and_the_journal(tmp_path, monkeypatch) -> None:
    shots = [f"s{k}" for k in range(8)]
    header = {"shots": [{"id": s} for s in shots]}
    with SessionWriter.create(tmp_path, "toy", header) as writer:
        with monkeypatch.context() as patch:
            shim = Shim(patch)
            shim._names |= {writer._journal: str(writer.path / "journal.jsonl")}
            writer.keep([Item(event="commit", shot=s, attempt=1, pixels=picture()) for s in shots])
        calls = [name for name, _ in shim.log]
        assert (calls.count("fsync"), calls.count("fdatasync")) == (9, 1)
        assert shim.log[-1] == ("fdatasync", "journal.jsonl")
        writer.close()
    assert verify(writer.path) == []


PLAN = {
    "exposures": {"bracket_s": [0.05]},
    "sets": [
        {"id": "stripes", "pattern": {"kind": "stripes", "period_px": 16, "shifts": 2}},
        {"id": "white", "pattern": {"kind": "uniform"}},
    ],
}


def capture_with_shim(root: Path, **how) -> tuple[Shim, object, Session | None]:
    with pytest.MonkeyPatch.context() as patch, toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(**PLAN), rig, root)
        shim: list[Shim] = []
        opened = runner._open_session

        def open_session() -> SessionWriter:
            writer = opened()
            shim.append(Shim(patch, **how))
            shim[0]._names[writer._journal] = str(writer.path / "journal.jsonl")
            return writer

        runner._open_session = open_session
        finish, session = toy.run(runner, *[Command.RESUME] * 3)
    return shim[0], finish, session


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, SHORT])
def test_r3_any_call_that_fails_pauses_and_the_session_completes(code, tmp_path: Path) -> None:
    shim, finish, whole = capture_with_shim(tmp_path / "whole")
    assert finish.status.state is State.COMPLETED
    frames = toy_pixels(whole)
    n_calls = len(shim.log)
    assert n_calls > 25
    for k in range(1, n_calls + 1):
        root = tmp_path / str(k)
        shim, finish, session = capture_with_shim(root, fail_at=k, code=code)
        bad = [p for p in verify(session.path) if "planned" not in p.what and "seal" not in p.what]
        assert bad == [], shim.failed
        if finish.status.state is not State.COMPLETED:
            # the disk failed while the session was being sealed
            assert session.missing == ()
            finish, session = resume(session.path)
        elif code != SHORT and (".tif" in shim.failed or "frames" in shim.failed):
            # a full journal at its last line is what the reserve is for, and pauses nothing
            pauses = [e["reason"] for e in session.events if e["event"] == "pause"]
            assert any(os.strerror(code) in reason for reason in pauses), shim.failed
        assert finish.status.state is State.COMPLETED, (shim.failed, finish.status.reason)
        for shot, expected in frames.items():
            np.testing.assert_array_equal(Session.open(session.path).read(shot), expected)
        assert verify(session.path) == []
        shutil.rmtree(root)


def resume(path: Path):
    with toy.rig_of() as rig:
        return toy.run(toy.prepare_resume(path, rig))


def toy_pixels(session: Session) -> dict[str, np.ndarray]:
    return toy.pixels(session)


class SlowDisk(Disk):
    """Takes as long for a frame as two exposures of the camera."""

    def __init__(self) -> None:
        self.most = 0

    def write_files(self, files) -> None:
        time.sleep(0.004 * len(files))
        self.most = max(self.most, len(files))
        super().write_files(files)


def test_r7_queue_is_bounded_waits_and_loses_nothing(tmp_path: Path) -> None:
    """R7: at a camera twice as fast as the disk, all frames are kept, and memory is bounded."""
    shots = [f"s{k}" for k in range(60)]
    disk = SlowDisk()
    writer = SessionWriter.create(tmp_path, "toy", {"shots": [{"id": s} for s in shots]}, disk=disk)
    keeper = Keeper(writer)
    longest = 0
    for shot in shots:
        keeper.put(Item(event="commit", shot=shot, attempt=1, pixels=picture()), CancelToken())
        longest = max(longest, len(keeper._waiting))
    assert keeper.drain(20.0)
    assert keeper.stop(5.0)
    assert [item.shot for item in keeper.collect_saved()] == shots
    writer.close()
    session = Session.open(writer.path)
    assert list(session.frames) == shots
    assert verify(writer.path) == []
    assert longest <= 16
    assert 1 < disk.most <= 8


def test_r7_every_frame_of_the_camera_is_journaled_or_journaled_as_dropped(tmp_path) -> None:
    """At a disk slower than the camera, with frames lost, late, twice and broken on the way."""
    spoilt = ("drop", "duplicate", "corrupt", "flagged", "hidden-exposure")
    faults = [{"kind": k, "shot": f"stripes-e1-r0-p{n % 4:02d}"} for n, k in enumerate(spoilt)]
    came: Counter[str] = Counter()
    with toy.rig_of(*faults) as rig:
        rig.disk, collect = SlowDisk(), rig.camera.collect

        def counted(**how):
            of_plan = not rig._world.faults.shot.startswith("reference")
            try:
                frame = collect(**how)
            except (NoFrameError, FrameCorruptError):
                came["lost"] += of_plan
                raise
            came["frames"] += of_plan
            return frame

        rig.camera.collect = counted
        plan = toy.plan_of(limits={"failures_per_run": 1.0})
        finish, session = toy.run(toy.prepare(plan, rig, tmp_path))
    assert finish.status.state is State.COMPLETED, finish.status.reason
    lines = Counter(e["event"] for e in session.events)
    assert came == {
        "frames": lines["commit"] + lines["reject"],
        "lost": lines["drop"],
    }
    assert lines["drop"] >= 2
    assert lines["reject"] >= 2
    close = session.events[-1]
    assert (close["expected"], close["saved"], close["dropped"]) == (12, 12, lines["drop"])


def test_r12_catalogue_is_derived_and_comes_back(tmp_path: Path) -> None:
    toy.capture(tmp_path)
    toy.capture(tmp_path, {"kind": "drop", "shot": "white-e1-r0", "times": 99})
    before = catalogue(tmp_path)
    assert [entry.state for entry in before] in (["completed", "aborted"], ["aborted", "completed"])
    assert {entry.saved for entry in before} == {12, 10}
    (tmp_path / FILE).unlink()
    assert catalogue(tmp_path) == before
    (tmp_path / FILE).write_bytes(b"no database")
    assert catalogue(tmp_path) == before
    journal = tmp_path / before[0].path / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b'"attempt":1', b'"attempt":9', 1))
    assert catalogue(tmp_path)[0].state == "damaged"


def test_r12_500_sessions_are_listed_quickly(tmp_path: Path) -> None:
    for k in range(500):
        folder = tmp_path / "2026-11-22" / f"{k:06d}_s_0000"
        folder.mkdir(parents=True)
        if k == 0:
            writer = SessionWriter.create(
                tmp_path / "one", "s", {"shots": [{"id": f"s{n}"} for n in range(24)]}
            )
            for n in range(24):
                writer.commit(f"s{n}", 1, picture(), {})
            writer.close()
        for name in ("session.json", "journal.jsonl", "SEAL.json"):
            shutil.copy(writer.path / name, folder / name)
    begun = time.process_time()
    entries = catalogue(tmp_path)
    took_s = time.process_time() - begun
    assert len([e for e in entries if e.state == "completed"]) == 500
    # measured 1.6 s of CPU on a busy machine; R12 asks for 5 s, which the bench measures
    assert took_s < 5.0
