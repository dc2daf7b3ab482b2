"""The session folder: what is written comes back, and what is damaged is named."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from labrig import session_format, session_lock
from labrig.errors import SessionError, SessionLockedError
from labrig.session import SCHEMA, Session, SessionWriter, verify

SHAPE = (24, 32)
SHOTS = [f"stripes-e0-r0-p{shift:02d}" for shift in range(6)]
HEADER = {"shots": [{"id": shot, "exposure_s": 0.1} for shot in SHOTS], "operator": "Zoë"}
DETAILS = {"sequence": 7, "exposure_asked_s": 0.1, "flags": ["late", None], "note": "Küvette 中"}
REPO = Path(__file__).parents[2]


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 65536, SHAPE, dtype=np.uint16)


def write(root: Path, *, shots: int = len(SHOTS), fail: bool = False) -> Path:
    """Write a session with the first shots, one rejected frame, a drop and a pattern."""
    stripes = {"5eed": np.tile(np.uint8([0, 255]), (8, 4))}
    with SessionWriter.create(root, "Milk 2%", HEADER, patterns=stripes) as writer:
        writer.reject(SHOTS[0], 1, picture(99), "early", {"sequence": 6})
        writer.record("drop", shot=SHOTS[0], cause="no frame")
        for number, shot in enumerate(SHOTS[:shots]):
            writer.commit(shot, 2, picture(number), DETAILS)
        if fail:
            raise KeyboardInterrupt
    return writer.path


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    return write(tmp_path)


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, shots=4, fail=True)
    return next(tmp_path.glob("*/*"))


def blamed(path: Path) -> set[str]:
    return {problem.file for problem in verify(path)}


def flip(file: Path, at: int) -> None:
    content = bytearray(file.read_bytes())
    content[at] ^= 0x10
    file.write_bytes(content)


def journal_lines(path: Path) -> list[bytes]:
    return (path / "journal.jsonl").read_bytes().splitlines(keepends=True)


def forge(path: Path, **changes: object) -> None:
    """Append a journal line that fits its number and its crc32, as a hostile sender could."""
    lines = journal_lines(path)
    line = json.loads(lines[-1] if changes.pop("closing", False) else lines[-2])
    line.pop("crc32")
    body = session_format.to_json({**line, "n": len(lines) + 1, **changes})
    line_bytes = body[:-1] + b',"crc32":"%08x"}\n' % zlib.crc32(body)
    (path / "journal.jsonl").write_bytes(b"".join([*lines, line_bytes]))


def test_what_is_written_comes_back(sealed: Path) -> None:
    session = Session.open(sealed)
    assert session.sealed
    assert session.missing == ()
    assert [shot["id"] for shot in session.shots] == SHOTS
    assert session.header["schema"] == SCHEMA
    assert session.header["operator"] == "Zoë"
    assert session.header["software"]["numpy"] == np.__version__
    for number, shot in enumerate(SHOTS):
        np.testing.assert_array_equal(session.read(shot), picture(number))
        frame = session.frames[shot]
        assert (frame.shot, frame.attempt, frame.file) == (shot, 2, f"frames/{shot}.tif")
        assert frame.details.items() >= DETAILS.items()
        assert frame.details["segment"] == 1


def test_whole_session_has_no_problems(sealed: Path) -> None:
    steps: list[tuple[int, int]] = []
    assert verify(sealed, lambda done, total: steps.append((done, total))) == []
    assert [done for done, _ in steps] == list(range(1, steps[0][1] + 1))


def test_folder_is_named_by_date_time_and_slug(sealed: Path, tmp_path: Path) -> None:
    date, folder = sealed.relative_to(tmp_path).parts
    header = Session.open(sealed).header
    assert header["id"] == f"{date}_{folder}"
    assert header["created"].startswith(date)
    assert folder[6:-4] == "_milk-2_"


def test_seal_counts_frames_and_gives_up_the_reserve(sealed: Path) -> None:
    seal = json.loads((sealed / "SEAL.json").read_bytes())
    assert (seal["expected"], seal["saved"], seal["dropped"]) == (6, 6, 1)
    assert f"rejected/{SHOTS[0]}-a1.tif" in seal["files"]
    assert "patterns/5eed.png" in seal["files"]
    assert not (sealed / "reserve.bin").exists()


def test_frames_read_alike_in_tifffile_opencv_and_pillow(sealed: Path) -> None:
    file = sealed / "frames" / f"{SHOTS[3]}.tif"
    np.testing.assert_array_equal(tifffile.imread(file), picture(3))
    np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), picture(3))
    with Image.open(file) as image:
        np.testing.assert_array_equal(np.asarray(image), picture(3))


def test_frame_says_in_itself_what_it_is(sealed: Path) -> None:
    session = Session.open(sealed)
    with tifffile.TiffFile(sealed / "frames" / f"{SHOTS[3]}.tif") as tiff:
        about = json.loads(tiff.pages[0].description)
    assert about["session"] == session.header["id"]
    assert about["frame"].items() >= {**DETAILS, "shot": SHOTS[3], "attempt": 2}.items()
    assert about["frame"]["xxh3_128"] == session.frames[SHOTS[3]].xxh3_128


def test_pattern_comes_back(sealed: Path) -> None:
    image = cv2.imread(str(sealed / "patterns/5eed.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, np.tile(np.uint8([0, 255]), (8, 4)))


def test_journal_lines_are_json_with_a_crc32_at_the_end(sealed: Path) -> None:
    for number, line in enumerate(journal_lines(sealed), start=1):
        event = json.loads(line)
        *_, last = event
        crc = event.pop("crc32")
        assert last == "crc32"
        assert event["n"] == number
        assert crc == f"{zlib.crc32(session_format.to_json(event)):08x}"


def test_segment_and_pauses_are_journaled(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        writer.commit(SHOTS[0], 1, picture(0), {})
        writer.record("pause", reason="operator")
        writer.record("resume")
        writer.record("segment", reason="lamp drifted by 3 %")
        writer.commit(SHOTS[1], 1, picture(1), {})
    session = Session.open(writer.path)
    events = [(event["event"], event["segment"]) for event in session.events]
    assert events == [
        ("open", 1),
        ("commit", 1),
        ("pause", 1),
        ("resume", 1),
        ("segment", 2),
        ("commit", 2),
        ("close", 2),
    ]
    assert session.missing == tuple(SHOTS[2:])
    assert blamed(writer.path) == {f"frames/{shot}.tif" for shot in SHOTS[2:]}


def test_interrupted_session_reads_and_is_reported_unsealed(interrupted: Path) -> None:
    session = Session.open(interrupted)
    assert not session.sealed
    assert session.missing == tuple(SHOTS[4:])
    np.testing.assert_array_equal(session.read(SHOTS[3]), picture(3))
    assert (session.events[-1]["outcome"], session.events[-1]["error"]) == (
        "failed",
        "KeyboardInterrupt: ",
    )
    problems = verify(interrupted)
    assert {p.file for p in problems} == {"SEAL.json", *(f"frames/{s}.tif" for s in SHOTS[4:])}
    assert "not sealed: interrupted" in problems[0].what


def test_nothing_is_added_after_close_and_closing_again_is_harmless(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path, "s", HEADER)
    writer.close("aborted")
    seal = (writer.path / "SEAL.json").read_bytes()
    writer.close()
    assert (writer.path / "SEAL.json").read_bytes() == seal
    with pytest.raises(SessionError, match="is closed"):
        writer.record("note", text="too late")
    with pytest.raises(SessionError, match="is closed"):
        writer.commit(SHOTS[0], 1, picture(0), {})


DAMAGED = f"frames/{SHOTS[2]}.tif"


def swap(path: Path) -> None:
    here, there = path / DAMAGED, path / f"frames/{SHOTS[3]}.tif"
    spare = here.read_bytes()
    here.write_bytes(there.read_bytes())
    there.write_bytes(spare)


def link(path: Path) -> None:
    outside = path.parent / "outside.tif"
    (path / DAMAGED).replace(outside)
    (path / DAMAGED).symlink_to(outside)


def other_shape(path: Path) -> None:
    tifffile.imwrite(path / DAMAGED, picture(2).reshape(32, 24))


# how a frame is damaged, and the files that verify then has to name
FRAME_DAMAGE: dict[str, tuple[Callable[[Path], object], set[str]]] = {
    "first byte flipped": (lambda p: flip(p / DAMAGED, 0), {DAMAGED}),
    "description flipped": (lambda p: flip(p / DAMAGED, 400), {DAMAGED}),
    "pixel flipped": (lambda p: flip(p / DAMAGED, -1), {DAMAGED}),
    "cut short": (lambda p: os.truncate(p / DAMAGED, 900), {DAMAGED}),
    "emptied": (lambda p: os.truncate(p / DAMAGED, 0), {DAMAGED}),
    "grown by zeros": (lambda p: os.truncate(p / DAMAGED, 90_000), {DAMAGED}),
    "deleted": (lambda p: (p / DAMAGED).unlink(), {DAMAGED}),
    "two swapped": (swap, {DAMAGED, f"frames/{SHOTS[3]}.tif"}),
    "a link": (link, {DAMAGED}),
    "a pipe": (lambda p: ((p / DAMAGED).unlink(), os.mkfifo(p / DAMAGED)), {DAMAGED}),
    "another picture": (other_shape, {DAMAGED}),
}


@pytest.mark.parametrize("kind", FRAME_DAMAGE)
@pytest.mark.parametrize("state", ["sealed", "interrupted"])
def test_damaged_frame_is_named_and_never_read(
    kind: str, state: str, request: pytest.FixtureRequest
) -> None:
    path: Path = request.getfixturevalue(state)
    before = blamed(path)
    damage, named = FRAME_DAMAGE[kind]
    damage(path)
    assert blamed(path) == before | named
    session = Session.open(path)
    for file in named:
        with pytest.raises(SessionError) as caught:
            session.read(Path(file).stem)
        assert file in str(caught.value)
        assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(session.read(SHOTS[0]), picture(0))


def rewrite_journal(change: Callable[[list[bytes]], list[bytes]]) -> Callable[[Path], object]:
    return lambda p: (p / "journal.jsonl").write_bytes(b"".join(change(journal_lines(p))))


def edit_seal(path: Path) -> None:
    seal = json.loads((path / "SEAL.json").read_bytes())
    seal["files"][DAMAGED] = "0" * 64
    (path / "SEAL.json").write_text(json.dumps(seal))


def edit_header(path: Path) -> None:
    text = (path / "session.json").read_text()
    (path / "session.json").write_text(text.replace('"exposure_s": 0.1', '"exposure_s": 0.2', 1))


REJECTED = f"rejected/{SHOTS[0]}-a1.tif"
OTHER_DAMAGE: dict[str, tuple[Callable[[Path], object], set[str]]] = {
    "journal line edited": (
        rewrite_journal(lambda lines: [x.replace(b'"sequence":7', b'"sequence":8') for x in lines]),
        {"journal.jsonl"},
    ),
    "journal line removed": (
        rewrite_journal(lambda lines: lines[:4] + lines[5:]),
        {"journal.jsonl"},
    ),
    "journal line twice": (
        rewrite_journal(lambda lines: [*lines[:5], lines[4], *lines[5:]]),
        {"journal.jsonl"},
    ),
    "journal end removed": (rewrite_journal(lambda lines: lines[:-1]), {"journal.jsonl"}),
    "journal deleted": (lambda p: (p / "journal.jsonl").unlink(), {"journal.jsonl"}),
    "journal emptied": (lambda p: os.truncate(p / "journal.jsonl", 0), {"journal.jsonl"}),
    "seal edited": (edit_seal, {"SEAL.json"}),
    "seal no JSON": (lambda p: (p / "SEAL.json").write_text("[" * 9999), {"SEAL.json"}),
    "seal deleted": (lambda p: (p / "SEAL.json").unlink(), {"SEAL.json"}),
    "header edited": (edit_header, {"session.json"}),
    "header cut short": (lambda p: os.truncate(p / "session.json", 99), {"session.json"}),
    "header deleted": (lambda p: (p / "session.json").unlink(), {"session.json"}),
    "header a link": (
        lambda p: ((p / "session.json").unlink(), (p / "session.json").symlink_to("/etc/hostname")),
        {"session.json"},
    ),
    "extra frame": (lambda p: (p / "frames/x.tif").write_bytes(b"x"), {"frames/x.tif"}),
    "extra calibration": (
        lambda p: (p / "calibration/dark.yaml").write_text("a: 1"),
        {"calibration/dark.yaml"},
    ),
    "part left": (lambda p: (p / "frames/x.tif.part").write_bytes(b"x"), {"frames/x.tif.part"}),
    "linked folder": (lambda p: (p / "frames/out").symlink_to("/etc"), {"frames/out"}),
    "pattern flipped": (lambda p: flip(p / "patterns/5eed.png", 40), {"patterns/5eed.png"}),
    "rejected flipped": (lambda p: flip(p / REJECTED, -1), {REJECTED}),
}


@pytest.mark.parametrize("kind", OTHER_DAMAGE)
def test_damage_beside_the_frames_is_named(kind: str, sealed: Path) -> None:
    damage, named = OTHER_DAMAGE[kind]
    damage(sealed)
    problems = verify(sealed)
    found = {problem.file for problem in problems}
    # frames whose journal line is damaged are named besides, for nothing vouches for them
    unvouched = {file for file in found if "journal.jsonl" in found and file.endswith(".tif")}
    assert found - unvouched == named
    assert not any("\n" in problem.what for problem in problems)


@pytest.mark.parametrize("state", ["sealed", "interrupted"])
def test_any_flipped_byte_is_noticed(state: str, request: pytest.FixtureRequest) -> None:
    path: Path = request.getfixturevalue(state)
    before = blamed(path)
    rng = np.random.default_rng(4)
    kept = ("session.json", "journal.jsonl", "patterns/5eed.png", DAMAGED, REJECTED)
    for name in kept:
        whole = (path / name).read_bytes()
        for at in rng.integers(0, len(whole), 25):
            flip(path / name, int(at))
            assert name in blamed(path) - (before - {name}), f"{name} byte {at}"
            (path / name).write_bytes(whole)


@pytest.mark.parametrize("cut", [1, 2, 30, 200])
def test_torn_last_line_is_forgiven_until_the_session_is_sealed(
    cut: int, interrupted: Path, sealed: Path
) -> None:
    for path in (interrupted, sealed):
        journal = path / "journal.jsonl"
        lines = journal_lines(path)
        journal.write_bytes(b"".join(lines)[: -min(cut, len(lines[-1]) - 1)])
        assert "journal.jsonl" in blamed(path)
    assert Session.open(interrupted).missing == tuple(SHOTS[4:])
    with pytest.raises(SessionError, match=r"journal.jsonl is damaged in line"):
        Session.open(sealed)


def test_torn_line_inside_is_refused(interrupted: Path) -> None:
    lines = journal_lines(interrupted)
    lines[4] = lines[4][:50] + b"\n"
    (interrupted / "journal.jsonl").write_bytes(b"".join(lines))
    with pytest.raises(SessionError, match="damaged in line 5"):
        Session.open(interrupted)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "a second time"),
        ({"shot": "unplanned", "file": "frames/unplanned.tif"}, "does not plan"),
        ({"shot": SHOTS[4], "file": "frames/../../x.tif"}, "names another file"),
        ({"shot": SHOTS[4], "file": "/etc/hostname"}, "names another file"),
        ({"shot": SHOTS[4], "file": None}, "lacks a field"),
        ({"shot": SHOTS[4], "file": f"frames/{SHOTS[4]}.tif", "rows": 9**9}, "lacks"),
        ({"n": 3, "event": "note"}, "lines were removed or added"),
    ],
)
def test_forged_line_is_refused(
    changes: dict[str, object], message: str, interrupted: Path
) -> None:
    forge(interrupted, **changes)
    with pytest.raises(SessionError, match=message) as caught:
        Session.open(interrupted)
    assert "\n" not in str(caught.value)
    assert "journal.jsonl" in blamed(interrupted)


@pytest.mark.parametrize("name", ["../victim", "/etc/hostname", "frames/../../victim", "", "a\0b"])
def test_seal_cannot_make_verify_look_outside(name: str, sealed: Path) -> None:
    (sealed.parent / "victim").write_text("secret")
    seal = json.loads((sealed / "SEAL.json").read_bytes())
    del seal["seal_sha256"]
    seal["files"][name] = session_format.sha256_of(b"secret")
    seal["seal_sha256"] = session_format.sha256_of(session_format.to_json(seal))
    (sealed / "SEAL.json").write_text(json.dumps(seal))
    assert blamed(sealed) == {name}


def test_linked_frames_folder_is_not_followed(sealed: Path) -> None:
    outside = sealed.parent / "outside"
    (sealed / "frames").rename(outside)
    (sealed / "frames").symlink_to(outside)
    assert blamed(sealed) == {"frames", *(f"frames/{shot}.tif" for shot in SHOTS)}
    with pytest.raises(SessionError, match="symbolic link"):
        Session.open(sealed).read(SHOTS[0])


def test_file_that_only_looks_committed_is_not_read(interrupted: Path) -> None:
    """A forged line may fit its file; the pixels must still fit the line."""
    content = (interrupted / DAMAGED).read_bytes()
    file = f"frames/{SHOTS[4]}.tif"
    (interrupted / file).write_bytes(content)
    own = Session.open(interrupted).frames[SHOTS[2]]
    forged = {"shot": SHOTS[4], "file": file, "bytes": own.bytes, "xxh3_128": "0" * 32}
    forge(interrupted, **{**forged, "file_xxh3_128": own.details["file_xxh3_128"]})
    with pytest.raises(SessionError, match="does not hold the pixels"):
        Session.open(interrupted).read(SHOTS[4])


def test_missing_frame_is_an_error_and_not_zeros(interrupted: Path) -> None:
    with pytest.raises(SessionError, match="holds no frame"):
        Session.open(interrupted).read(SHOTS[5])


@pytest.mark.parametrize("place", ["", "nowhere", "file"])
def test_other_folders_are_no_sessions(place: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for read in (Session.open, verify):
        with pytest.raises(SessionError, match="is no session folder"):
            read(tmp_path / place)


def test_other_schema_is_refused(sealed: Path) -> None:
    text = (sealed / "session.json").read_text()
    (sealed / "session.json").write_text(text.replace(SCHEMA, "labrig-session/9"))
    with pytest.raises(SessionError, match="labrig-session/9"):
        Session.open(sealed)


def test_second_writer_is_refused_naming_the_holder(tmp_path: Path) -> None:
    with SessionWriter.create(tmp_path, "s", HEADER) as writer:
        with pytest.raises(SessionLockedError, match=f"pid {os.getpid()} on host"):
            SessionWriter(writer.path, "s", SHOTS)
        writer.commit(SHOTS[0], 1, picture(0), {})
    os.close(session_lock.take_lock(writer.path))


def test_lock_is_free_once_the_writer_is_killed_though_its_helper_lives(tmp_path: Path) -> None:
    code = """
import os, pathlib, sys, time
from labrig.session import SessionWriter
writer = SessionWriter.create(pathlib.Path(sys.argv[1]), "s", {"shots": [{"id": "a"}]})
helper = os.fork()
if not helper:
    time.sleep(60)
    os._exit(0)
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
