"""R5: what is damaged, forged or hostile in a session folder is named and never read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from samples import SHOTS, blamed, flip, forge, journal_lines, picture

from labrig.errors import SessionError
from labrig.session import SCHEMA, Session, verify
from labrig.session import format as session_format

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
def test_r5_damaged_frame_is_named_and_never_read(
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
def test_r5_damage_beside_the_frames_is_named(kind: str, sealed: Path) -> None:
    damage, named = OTHER_DAMAGE[kind]
    damage(sealed)
    problems = verify(sealed)
    found = {problem.file for problem in problems}
    # frames whose journal line is damaged are named besides, for nothing vouches for them
    unvouched = {file for file in found if "journal.jsonl" in found and file.endswith(".tif")}
    assert found - unvouched == named
    assert not any("\n" in problem.what for problem in problems)


@pytest.mark.parametrize("state", ["sealed", "interrupted"])
def test_r5_any_flipped_byte_is_noticed(state: str, request: pytest.FixtureRequest) -> None:
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
