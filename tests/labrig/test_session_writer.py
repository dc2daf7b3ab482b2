"""The writer of a session: alone, refusing what it cannot keep, and whole after a failed call."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from samples import HEADER, SHAPE, SHOTS, picture

from labrig.errors import SessionError, SessionLockedError
from labrig.session import Session, SessionWriter, verify
from labrig.session import lock as session_lock

REPO = Path(__file__).parents[2]


def test_r6_second_writer_is_refused_naming_the_holder(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        with pytest.raises(SessionLockedError, match=f"pid {os.getpid()} on host"):
            SessionWriter(writer.path, "s", SHOTS)
        writer.commit(SHOTS[0], 1, picture(0), {})
    os.close(session_lock.take_lock(writer.path))


def test_r6_lock_is_free_once_the_writer_is_killed_though_its_helper_lives(tmp_path: Path) -> None:
    code = """
import os, pathlib, sys, time
from labrig.session import SessionWriter
writer = SessionWriter.create(pathlib.Path(sys.argv[1]), "s", {"shots": [{"id": "a"}]})
alive, says = os.pipe()
helper = os.fork()
if not helper:
    os.write(says, b"x")
    time.sleep(60)
    os._exit(0)
os.read(alive, 1)
print(writer.path, helper, flush=True)
time.sleep(60)
"""
    command = [sys.executable, "-c", code, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(REPO)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as child:
        assert child.stdout is not None
        path, helper = child.stdout.readline().split()
        try:
            with pytest.raises(SessionLockedError, match=f"pid {child.pid}"):
                session_lock.take_lock(Path(path))
            child.kill()
            child.wait()
            os.close(session_lock.take_lock(Path(path)))
        finally:
            child.kill()
            os.kill(int(helper), signal.SIGKILL)
    assert Session.open(Path(path)).missing == ("a",)


@pytest.mark.parametrize(
    "pixels",
    [
        np.zeros(SHAPE, np.uint8),
        np.zeros(SHAPE, ">u2"),
        np.zeros((2, *SHAPE), np.uint16),
        np.zeros((0, 4), np.uint16),
    ],
)
def test_other_pixels_are_refused(pixels: np.ndarray, tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        writer.record("note", text="a colour camera?")
        with pytest.raises(SessionError, match="uint16 counts"):
            writer.commit(SHOTS[0], 1, pixels, {})


def test_pixels_need_not_be_contiguous(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        writer.commit(SHOTS[0], 1, picture(0).T[::2], {})
    np.testing.assert_array_equal(Session.open(writer.path).read(SHOTS[0]), picture(0).T[::2])


@pytest.mark.parametrize(
    "details",
    [
        {"x": float("nan")},
        {"x": np.zeros(2)},
        {"x": "\ud800"},
        {"bytes": 3},
        {"t": 0.0},
        {"x": {"shape": 3}},
    ],
)
def test_details_that_cannot_be_kept_leave_nothing_behind(
    details: dict[str, object], tmp_path: Path
) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        with pytest.raises(SessionError) as caught:
            writer.commit(SHOTS[0], 1, picture(0), details)
        assert "\n" not in str(caught.value)
        assert list((writer.path / "frames").iterdir()) == []
        writer.commit(SHOTS[0], 1, picture(0), {})


def test_unknown_shots_second_frames_and_unknown_events_are_refused(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        writer.commit(SHOTS[0], 1, picture(0), {})
        writer.reject(SHOTS[1], 1, picture(0), "early", {})
        with pytest.raises(SessionError, match="plans no shot 'nobody'"):
            writer.commit("nobody", 1, picture(0), {})
        with pytest.raises(SessionError, match="already has its frame"):
            writer.commit(SHOTS[0], 2, picture(1), {})
        with pytest.raises(SessionError, match="already rejected"):
            writer.reject(SHOTS[1], 1, picture(1), "early", {})
        for event in ("commit", "open", "coffee"):
            with pytest.raises(SessionError, match="knows no event"):
                writer.record(event)
    assert Session.open(writer.path).frames.keys() == {SHOTS[0]}


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"shots": []},
        {"shots": ["a"]},
        {"shots": [{"id": "a"}, {"id": "a"}]},
        {"shots": [{"id": "../a"}]},
        {"shots": [{"id": "a\n"}]},
        {"shots": [{"id": ""}]},
        {"shots": [{"id": "a"}], "schema": "mine"},
        {"shots": [{"id": "a"}], "x": float("inf")},
    ],
)
def test_header_that_cannot_be_kept_makes_no_folder(
    header: dict[str, object], tmp_path: Path
) -> None:
    with pytest.raises(SessionError) as caught:
        SessionWriter.create(tmp_path, "s", header)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("key", ["../evil", "a/b", ""])
def test_pattern_names_stay_inside(key: str, tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="can name a file"):
        SessionWriter.create(tmp_path, "s", HEADER, patterns={key: np.zeros((2, 2), np.uint8)})


@pytest.mark.parametrize("call", ["fsync", "fdatasync", "replace"])
def test_frame_whose_write_failed_can_be_taken_again(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with SessionWriter.create(tmp_path, "s", {"shots": [{"id": "a"}]}) as writer:
        with monkeypatch.context() as broken:
            broken.setattr(Path if call == "replace" else os, call, fail)
            with pytest.raises(OSError, match="Input/output"):
                writer.commit("a", 1, picture(0), {})
        assert Session.open(writer.path).missing == ("a",)
        writer.commit("a", 2, picture(1), {})
    assert verify(writer.path) == []
    np.testing.assert_array_equal(Session.open(writer.path).read("a"), picture(1))


def test_short_write_to_the_journal_is_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = os.write
    room = 10

    def full_disk(descriptor: int, content: bytes) -> int:
        nonlocal room
        if not room:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = written(descriptor, content[:room])
        room -= count
        return count

    with SessionWriter.create(tmp_path, "s", {"shots": [{"id": "a"}]}) as writer:
        with monkeypatch.context() as full:
            full.setattr(os, "write", full_disk)
            with pytest.raises(OSError, match="No space"):
                writer.record("note", text="does not fit")
        assert Session.open(writer.path).events[-1]["event"] == "open"
        writer.commit("a", 1, picture(0), {})
    assert verify(writer.path) == []


def test_reserve_is_given_up_to_journal_the_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = os.write
    writer = SessionWriter.create(tmp_path, "s", HEADER)
    reserve = writer.path / "reserve.bin"

    def full_until_reserve_is_gone(descriptor: int, content: bytes) -> int:
        if reserve.exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        return written(descriptor, content)

    with writer, monkeypatch.context() as full:
        full.setattr(os, "write", full_until_reserve_is_gone)
        with pytest.raises(OSError, match="No space"):
            writer.record("note")
        writer.record("pause", reason="disk full")
    assert [e["event"] for e in Session.open(writer.path).events] == ["open", "pause", "close"]
