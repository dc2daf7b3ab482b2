"""The form of a session folder: names of files, JSON, journal lines, frames as TIFF.

docs/file-formats.md shows the folder; docs/decisions/0002-session-format.md says why it is so.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import unicodedata
import zlib
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xxhash
from numpy.typing import NDArray

from labrig.errors import SessionError
from labrig.session.frame_tiff import encode

SCHEMA = "labrig-session/2"
READABLE = ("labrig-session/1", SCHEMA)
JsonObject = dict[str, Any]

HEADER, JOURNAL, SEAL = "session.json", "journal.jsonl", "SEAL.json"
LOCK, RESERVE = "session.lock", "reserve.bin"
CAPTURED = ("calibration", "frames", "patterns", "quarantine", "rejected")
RECORDABLE = ("drop", "note", "pause", "resume", "segment", "void")
HEADER_KEYS = {"created", "host", "id", "schema", "software"}
LINE_KEYS = {"crc32", "event", "n", "segment", "t"}
FRAME_KEYS = {"attempt", "bytes", "cols", "file", "file_xxh3_128", "rows", "shot", "xxh3_128"}
STEM = re.compile(r"[A-Za-z0-9._-]{1,200}")
_PACKAGES = ("labrig", "numpy", "opencv-contrib-python-headless", "scipy", "tifffile", "xxhash")


def shot_ids(shots: object) -> list[str]:
    """Return the ids of a header's shots, refused unless each can name a file of its own."""
    if not isinstance(shots, list | tuple) or not shots:
        msg = "the header lists no shots: give a list of dicts, each with an id."
        raise SessionError(msg)
    ids: dict[str, None] = {}
    for shot in shots:
        shot_id = shot.get("id") if isinstance(shot, Mapping) else None
        if not isinstance(shot_id, str) or not STEM.fullmatch(shot_id):
            msg = f"shot id {shot_id!r} cannot name a file: use letters, digits, '.', '_', '-'."
            raise SessionError(msg)
        if shot_id in ids:
            msg = f"shot id {shot_id!r} stands twice in the header: give each shot its own."
            raise SessionError(msg)
        ids[shot_id] = None
    return list(ids)


def frame_file(event: str, shot_id: str, attempt: int) -> str:
    """Name the file of a committed or rejected frame, relative to the session."""
    return f"frames/{shot_id}.tif" if event == "commit" else f"rejected/{shot_id}-a{attempt}.tif"


def journal_line(event: str, number: int, segment: int, fields: Mapping[str, Any]) -> bytes:
    """Return a line of the journal, its CRC-32 and line break at its end."""
    refuse_reserved(fields, LINE_KEYS)
    t = datetime.now(UTC).isoformat(timespec="milliseconds")
    body = to_json({**fields, "event": event, "n": number, "segment": segment, "t": t})
    return body[:-1] + b',"crc32":"%08x"}\n' % zlib.crc32(body)


def pixel_digest(pixels: NDArray[np.uint16]) -> str:
    """Return the XXH3-128 of the counts, row by row, in hex."""
    return xxhash.xxh3_128_hexdigest(np.ascontiguousarray(pixels).data)


def captured_files(folder: Path) -> list[str]:
    """Name every file, link and part file a session captured; links are not followed."""
    found = []
    for here, folders, files in os.walk(folder):
        at_top = Path(here) == folder
        if at_top:
            folders[:] = [name for name in folders if name in CAPTURED]
        links = [name for name in folders if Path(here, name).is_symlink()]
        kept = [name for name in files if name in CAPTURED or is_part(name) or not at_top]
        found += [Path(here, name).relative_to(folder).as_posix() for name in kept + links]
    return sorted(found)


def is_part(file: str) -> bool:
    """Tell whether a file is what an interrupted write leaves."""
    return file.endswith(".part")


def to_json(value: object, *, pretty: bool = False) -> bytes:
    """Return JSON in the one form that digests are taken of: keys sorted, numbers finite."""
    try:
        text = json.dumps(
            value,
            sort_keys=True,
            allow_nan=False,
            ensure_ascii=False,
            indent=2 if pretty else None,
            separators=None if pretty else (",", ":"),
        )
        return text.encode()
    except (TypeError, ValueError, RecursionError) as error:
        msg = (
            f"{error}: a session keeps finite numbers, text, true, false, null, and lists of them."
        )
        raise SessionError(msg) from error


def one_line(text: str) -> str:
    """Return a text of unknown origin without line breaks and terminal commands."""
    return "".join(c if c.isprintable() else " " for c in text)


def sha256_of(source: Path | bytes) -> str:
    """Return the SHA-256 of a file, or of bytes, in hex."""
    if isinstance(source, bytes):
        return hashlib.sha256(source).hexdigest()
    with source.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def refuse_reserved(fields: Mapping[str, Any], reserved: set[str]) -> None:
    """Refuse names that the session gives itself."""
    if clash := sorted(fields.keys() & reserved):
        msg = f"{', '.join(clash)}: the session writes this itself; use another name."
        raise SessionError(msg)


def slug(name: str) -> str:
    """Return a name as part of a folder's: small letters, digits and dashes."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain)[:48].strip("-") or "session"


def software_versions() -> dict[str, str]:
    """Return the versions of what writes a session."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def png(key: str, image: NDArray[np.uint8]) -> bytes:
    """Return a projector image as a PNG file; ``key`` names it."""
    if not STEM.fullmatch(key) or image.dtype != np.uint8 or image.ndim != 2 or not image.size:
        msg = (
            f"pattern {key!r} is {image.dtype} of shape {image.shape}: "
            "give uint8 levels, (rows, cols), under a digest that can name a file."
        )
        raise SessionError(msg)
    return bytes(cv2.imencode(".png", image)[1])


def tiff(pixels: NDArray[np.uint16], about: Mapping[str, Any]) -> bytes:
    """Return a frame as a TIFF file that says itself what it is."""
    text = to_json({**about, "schema": SCHEMA})
    if b'"shape":' in text:
        msg = "details hold a 'shape', by which tifffile knows files of its own: use another name."
        raise SessionError(msg)
    return encode(pixels, text)
