"""The session folder: what is written comes back."""

from __future__ import annotations

import io
import json
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image
from samples import DETAILS, HEADER, SHOTS, blamed, journal_lines, picture

from labrig.errors import SessionError
from labrig.session import SCHEMA, Session, SessionWriter, verify
from labrig.session import format as session_format


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


def test_r9_frames_read_alike_in_tifffile_opencv_and_pillow(sealed: Path) -> None:
    file = sealed / "frames" / f"{SHOTS[3]}.tif"
    np.testing.assert_array_equal(tifffile.imread(file), picture(3))
    np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), picture(3))
    with Image.open(file) as image:
        np.testing.assert_array_equal(np.asarray(image), picture(3))


def test_r9_frames_of_any_size_and_text_read_alike() -> None:
    rng = np.random.default_rng(9)
    for n in range(30):
        rows, cols = rng.integers(1, 50, 2)
        pixels = rng.integers(0, 65536, (rows, cols), dtype=np.uint16)
        content = session_format.tiff(pixels, {"note": "ü" * n})
        with tifffile.TiffFile(io.BytesIO(content)) as found:
            (page,) = found.pages
            assert (page.compression, page.photometric, page.software) == (1, 1, "labrig")
            assert json.loads(page.description)["note"] == "ü" * n
            np.testing.assert_array_equal(page.asarray(), pixels)
        by_opencv = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(by_opencv, pixels)
        with Image.open(io.BytesIO(content)) as image:
            np.testing.assert_array_equal(np.asarray(image), pixels)


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
