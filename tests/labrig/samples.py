"""Small sessions written without a rig, and the damage that tests do to them."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np

from labrig.session import SessionWriter, verify
from labrig.session import format as session_format

SHAPE = (24, 32)
SHOTS = [f"stripes-e0-r0-p{shift:02d}" for shift in range(6)]
HEADER = {"shots": [{"id": shot, "exposure_s": 0.1} for shot in SHOTS], "operator": "Zoë"}
DETAILS = {"sequence": 7, "exposure_asked_s": 0.1, "flags": ["late", None], "note": "Küvette 中"}


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
