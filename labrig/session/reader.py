"""Read the files of a session folder one by one; what is not as it was written raises.

Names that leave the folder and symbolic links are refused, so that a folder from elsewhere cannot
lead outside itself.
"""

from __future__ import annotations

import io
import json
import os
import stat
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import tifffile
import xxhash
from numpy.typing import NDArray

from labrig.errors import SessionError
from labrig.session.format import (
    HEADER,
    JOURNAL,
    READABLE,
    SEAL,
    JsonObject,
    frame_file,
    one_line,
    pixel_digest,
    sha256_of,
    shot_ids,
    to_json,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommittedFrame:
    """A frame as its journal line promises it; ``details`` is everything else of the line."""

    shot: str
    attempt: int
    file: str
    bytes: int
    xxh3_128: str
    details: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One thing `verify` found: the file, relative to the session, and what is wrong with it."""

    file: str
    what: str


class DamageError(SessionError):
    """Raised when a file of a session is not as it was written."""

    def __init__(self, root: Path, file: str, what: str) -> None:
        super().__init__(one_line(f"{root.name}/{file} {what}"))
        self.problem = Problem(file=file, what=one_line(what))


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """Lines of a journal, and what is wrong with others; ``end`` is where the last good ends."""

    events: tuple[JsonObject, ...]
    damage: list[DamageError]
    torn: bool  # the last damage is a last line cut short
    end: int = 0


def root_of(path: Path) -> Path:
    """Return the absolute path of a session folder; raise `SessionError` if it is none."""
    root = path.absolute()
    if not any(os.path.lexists(root / name) for name in (HEADER, JOURNAL)):
        msg = f"{str(path)!r} is no session folder: give the one that holds {HEADER}."
        raise SessionError(msg)
    return root


def plain_file(root: Path, name: str) -> Path:
    """Return the path of a regular file inside the session; links could lead out of it."""
    parts = name.split("/")
    if {"", ".", ".."} & set(parts):
        raise DamageError(
            root, name, "is no plain name inside the session: do not trust this folder."
        )
    path, mode = root, 0
    for part in parts:
        path /= part
        try:
            mode = path.lstat().st_mode
        except FileNotFoundError:
            raise DamageError(root, name, "is missing: restore it, or capture it again.") from None
        except (OSError, ValueError) as error:
            raise DamageError(root, name, f"cannot be reached ({error}).") from error
        if stat.S_ISLNK(mode):
            raise DamageError(root, name, "is a symbolic link: put the file itself in its place.")
    if not stat.S_ISREG(mode):
        raise DamageError(root, name, "is no regular file: put the file itself in its place.")
    return path


def read_bytes(root: Path, name: str) -> bytes:
    """Return a file of the session; raise `DamageError` if it is not there or a link."""
    try:
        return plain_file(root, name).read_bytes()
    except OSError as error:
        raise DamageError(root, name, f"cannot be read ({error}).") from error


def _parse(text: bytes) -> JsonObject:
    """Return the object a JSON text holds; anything else is a ValueError."""
    try:
        value = json.loads(text.decode(), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError(*error.args) from error
    if not isinstance(value, dict):
        msg = "it holds no JSON object"
        raise ValueError(msg)  # noqa: TRY004 - every fault of the text is a ValueError
    return value


def _refuse_constant(name: str) -> NoReturn:
    msg = f"{name} is no number of JSON"
    raise ValueError(msg)


def read_header(root: Path) -> tuple[JsonObject, list[DamageError]]:
    """Return session.json, empty if it cannot be used, and why."""
    try:
        header = _parse(read_bytes(root, HEADER))
        if header.get("schema") not in READABLE:
            wanted = " and ".join(repr(schema) for schema in READABLE)
            what = f"has the schema {header.get('schema')!r}: this labrig reads {wanted}."
            return {}, [DamageError(root, HEADER, what)]
        shot_ids(header.get("shots"))
    except DamageError as damage:
        return {}, [damage]
    except (ValueError, SessionError) as error:
        return {}, [DamageError(root, HEADER, f"cannot be used ({error}): restore it.")]
    return header, []


def read_journal(root: Path) -> Journal:
    """Return the lines of the journal that can be trusted one by one."""
    events: list[JsonObject] = []
    damage: list[DamageError] = []
    try:
        lines = list(io.BytesIO(read_bytes(root, JOURNAL)))
    except DamageError as unreadable:
        return Journal(events=(), damage=[unreadable], torn=False)
    torn, shift, end = False, 0, 0
    for number, line in enumerate(lines, start=1):
        try:
            event = _parse_line(line)
        except ValueError as error:
            damage.append(DamageError(root, JOURNAL, f"is damaged in line {number}: {error}."))
            torn = number == len(lines)
            continue
        end += len(line)
        if event["n"] - number != shift:
            what = f"has line {event['n']} in line {number}: lines were removed or added before it."
            damage.append(DamageError(root, JOURNAL, what))
            shift = event["n"] - number
        events.append(event)
    if not events or events[0]["event"] != "open":
        damage.insert(0, DamageError(root, JOURNAL, "does not begin with an open line."))
    return Journal(events=tuple(events), damage=damage, torn=torn, end=end)


def _parse_line(line: bytes) -> JsonObject:
    body, _, mark = line.rpartition(b',"crc32":"')
    body += b"}"
    if mark != b'%08x"}\n' % zlib.crc32(body):
        msg = "it was edited or cut short and does not fit its crc32"
        raise ValueError(msg)
    event = _parse(body)
    if type(event.get("n")) is not int or not isinstance(event.get("event"), str):
        msg = "it has no number or names no event"
        raise ValueError(msg)
    return event


def promised_frames(
    root: Path, events: Iterable[JsonObject], header: JsonObject
) -> tuple[list[CommittedFrame], list[DamageError]]:
    """Return the frames of the commit and reject lines, and what is wrong with other such lines."""
    frames: dict[str, CommittedFrame] = {}
    damage: list[DamageError] = []
    known = {shot["id"] for shot in header.get("shots", ())}
    for event in events:
        if event["event"] == "void" and _take_back(event, frames):
            continue
        if event["event"] not in ("commit", "reject", "void"):
            continue
        frame = _promised_frame(event)
        if frame is None:
            what = "lacks a field, or names another file than its shot's"
        elif known and frame.shot not in known:
            what = f"is about shot {frame.shot!r}, which the header does not plan"
        elif frame.file in frames:
            what = f"saves {frame.file} a second time"
        else:
            frames[frame.file] = frame
            continue
        damage.append(DamageError(root, JOURNAL, f"line {event['n']} {what}: do not trust it."))
    return list(frames.values()), damage


def _take_back(event: JsonObject, frames: dict[str, CommittedFrame]) -> bool:
    """Let a void line turn a committed frame into a rejected one; False if there is none."""
    shot, attempt = event.get("shot"), event.get("attempt")
    if not isinstance(shot, str) or type(attempt) is not int:
        return False
    file, aside = frame_file("commit", shot, attempt), frame_file("reject", shot, attempt)
    if file not in frames or frames[file].attempt != attempt or aside in frames:
        return False
    frame = frames.pop(file)
    if not event.get("lost"):
        frames[aside] = replace(frame, file=aside)
    return True


def _promised_frame(event: JsonObject) -> CommittedFrame | None:
    match event:
        case {
            "shot": str(shot),
            "attempt": int(attempt),
            "file": str(file),
            "bytes": int(n_bytes),
            "rows": int(rows),
            "cols": int(cols),
            "xxh3_128": str(digest),
            "file_xxh3_128": str(),
        } if file == frame_file(event["event"], shot, attempt) and 0 < 2 * rows * cols < n_bytes:
            own = {"event", "shot", "attempt", "file", "bytes", "xxh3_128"}
            return CommittedFrame(
                shot=shot,
                attempt=attempt,
                file=file,
                bytes=n_bytes,
                xxh3_128=digest,
                details={key: value for key, value in event.items() if key not in own},
            )
    return None


def check_bytes(root: Path, frame: CommittedFrame) -> bytes:
    """Return a frame's file; raise `DamageError` if it is not the one that was committed."""
    file = frame.file
    size = plain_file(root, file).stat().st_size
    if size != frame.bytes:
        raise DamageError(
            root, file, f"holds {size} bytes, but {frame.bytes} were committed: restore it."
        )
    content = read_bytes(root, file)
    if xxhash.xxh3_128_hexdigest(content) != frame.details["file_xxh3_128"]:
        raise DamageError(root, file, "is not the file that was committed: restore it.")
    return content


def read_pixels(root: Path, frame: CommittedFrame) -> NDArray[np.uint16]:
    """Return the counts of a frame; raise `DamageError` if they are not those committed."""
    file, content = frame.file, check_bytes(root, frame)
    shape = (frame.details["rows"], frame.details["cols"])
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as tiff:
            page = tiff.pages[0]
            plain = page.shape == shape and page.dtype == np.uint16 and page.compression == 1
            pixels: NDArray[np.uint16] | None = page.asarray() if plain else None
    except Exception as error:  # tifffile has no common base for what a broken file raises
        raise DamageError(
            root, file, f"is no TIFF that can be read ({error}): restore it."
        ) from error
    if pixels is None:
        raise DamageError(root, file, f"is no plain 16-bit picture of {shape} px: restore it.")
    if pixel_digest(pixels) != frame.xxh3_128:
        raise DamageError(root, file, "does not hold the pixels that were committed: restore it.")
    return pixels


def read_seal(root: Path) -> tuple[JsonObject, list[DamageError]]:
    """Return the seal, empty if it cannot be used, and why."""
    if not os.path.lexists(root / SEAL):
        what = "not sealed: interrupted, or still being written."
        return {}, [DamageError(root, SEAL, what)]
    try:
        seal = _parse(read_bytes(root, SEAL))
        own = seal.pop("seal_sha256", None)
        if own == sha256_of(to_json(seal)) and seal.get("schema") in READABLE:
            return seal, []
        what = "does not fit its own digest and proves nothing: restore it."
    except DamageError as damage:
        return {}, [damage]
    except (ValueError, SessionError) as error:
        what = f"cannot be used ({error}): restore it."
    return {}, [DamageError(root, SEAL, what)]


def digests_of(record: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of each file that a seal or an open line names."""
    files = record.get("files")
    return {file: str(sha256) for file, sha256 in files.items()} if isinstance(files, dict) else {}
