"""Read a session folder back, and verify it: what is not as it was written is named, never guessed.

docs/file-formats.md shows the folder; docs/decisions/0002-session-format.md says why it is so.
"""

from __future__ import annotations

import io
import json
import os
import stat
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import tifffile
import xxhash
from numpy.typing import NDArray

from labrig.errors import SessionError
from labrig.session_writer import (
    HEADER,
    JOURNAL,
    SCHEMA,
    SEAL,
    JsonObject,
    SessionWriter,
    captured_files,
    frame_file,
    is_part,
    one_line,
    pixel_digest,
    sha256_of,
    shot_ids,
    to_json,
)

__all__ = [
    "SCHEMA",
    "CommittedFrame",
    "JsonObject",
    "Problem",
    "Session",
    "SessionWriter",
    "verify",
]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A session as it stands on the disk; nothing here writes."""

    path: Path
    header: Mapping[str, Any]
    events: tuple[Mapping[str, Any], ...]
    frames: Mapping[str, CommittedFrame]
    sealed: bool

    @classmethod
    def open(cls, path: Path) -> Session:
        """Read header and journal; the last line of an unsealed journal may be torn.

        Raises
        ------
        SessionError
            If the folder is no session, or its header or journal cannot be trusted.
        """
        root = _root_of(path)
        sealed = os.path.lexists(root / SEAL)
        header, damage = _read_header(root)
        journal = _read_journal(root)
        frames, bad_lines = _promised_frames(root, journal.events, header)
        tolerated = journal.torn and not sealed
        damage += (journal.damage[:-1] if tolerated else journal.damage) + bad_lines
        damage += _changed_header(root, journal.events)
        damage += _read_seal(root)[1] if sealed else []
        if damage:
            raise damage[0]
        committed = {f.shot: f for f in frames if f.file == frame_file("commit", f.shot, 0)}
        return cls(path=root, header=header, events=journal.events, frames=committed, sealed=sealed)

    @property
    def shots(self) -> tuple[Mapping[str, Any], ...]:
        """The shots of the plan, in order, as the header gives them."""
        return tuple(self.header["shots"])

    @property
    def missing(self) -> tuple[str, ...]:
        """Ids of the shots without a committed frame, in order."""
        return tuple(shot["id"] for shot in self.shots if shot["id"] not in self.frames)

    def read(self, shot_id: str) -> NDArray[np.uint16]:
        """Return the counts of a shot, (rows, cols), if they are those that were committed.

        Raises
        ------
        SessionError
            If the shot has no frame, or its file is missing, damaged or another one.
        """
        if shot_id not in self.frames:
            msg = (
                f"session {self.path.name!r} holds no frame of shot {shot_id!r}: capture it first."
            )
            raise SessionError(msg)
        return _read_pixels(self.path, self.frames[shot_id])


def verify(path: Path, progress: Callable[[int, int], None] | None = None) -> list[Problem]:
    """Check every line and every file of a session; a whole session has no problems.

    Parameters
    ----------
    path : the session folder
    progress : called after each file with the number checked and the number to check

    Raises
    ------
    SessionError
        If the folder is no session. Damage is not raised but listed.
    """
    root = _root_of(path)
    header, damage = _read_header(root)
    journal = _read_journal(root)
    frames, bad_lines = _promised_frames(root, journal.events, header)
    seal, seal_damage = _read_seal(root)
    damage += [*journal.damage, *bad_lines, *seal_damage]
    digests = _digests(seal or next(iter(journal.events), {}))

    checks: list[Callable[[], object]] = [partial(_read_pixels, root, frame) for frame in frames]
    checks += [partial(_check_digest, root, file, sha256) for file, sha256 in digests.items()]
    for done, check in enumerate(checks, start=1):
        try:
            check()
        except _DamageError as error:
            damage.append(error)
        if progress is not None:
            progress(done, len(checks))

    found = [error.problem for error in damage]
    found += _strays(root, {frame.file for frame in frames}, digests if seal else None)
    files = [frame_file("commit", shot["id"], 0) for shot in header.get("shots", ())]
    lacking = [file for file in files if file not in {frame.file for frame in frames}]
    found += [Problem(file=file, what="is planned and was never committed.") for file in lacking]
    # what is found first about a file says most; only a journal has many lines to be wrong
    first = {problem.file: problem for problem in reversed(found)}
    return [p for p in found if p.file == JOURNAL or p is first[p.file]]


class _DamageError(SessionError):
    """Raised when a file of a session is not as it was written."""

    def __init__(self, root: Path, file: str, what: str) -> None:
        super().__init__(one_line(f"{root.name}/{file} {what}"))
        self.problem = Problem(file=file, what=one_line(what))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Journal:
    events: tuple[JsonObject, ...]
    damage: list[_DamageError]
    torn: bool  # the last damage is a last line cut short


def _root_of(path: Path) -> Path:
    root = path.absolute()
    if not any(os.path.lexists(root / name) for name in (HEADER, JOURNAL)):
        msg = f"{str(path)!r} is no session folder: give the one that holds {HEADER}."
        raise SessionError(msg)
    return root


def _plain_file(root: Path, name: str) -> Path:
    """Return the path of a regular file inside the session; links could lead out of it."""
    parts = name.split("/")
    if {"", ".", ".."} & set(parts):
        raise _DamageError(
            root, name, "is no plain name inside the session: do not trust this folder."
        )
    path, mode = root, 0
    for part in parts:
        path /= part
        try:
            mode = path.lstat().st_mode
        except FileNotFoundError:
            raise _DamageError(root, name, "is missing: restore it, or capture it again.") from None
        except (OSError, ValueError) as error:
            raise _DamageError(root, name, f"cannot be reached ({error}).") from error
        if stat.S_ISLNK(mode):
            raise _DamageError(root, name, "is a symbolic link: put the file itself in its place.")
    if not stat.S_ISREG(mode):
        raise _DamageError(root, name, "is no regular file: put the file itself in its place.")
    return path


def _read(root: Path, name: str) -> bytes:
    try:
        return _plain_file(root, name).read_bytes()
    except OSError as error:
        raise _DamageError(root, name, f"cannot be read ({error}).") from error


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


def _read_header(root: Path) -> tuple[JsonObject, list[_DamageError]]:
    try:
        header = _parse(_read(root, HEADER))
        if header.get("schema") != SCHEMA:
            what = f"has the schema {header.get('schema')!r}: this labrig reads {SCHEMA!r}."
            return {}, [_DamageError(root, HEADER, what)]
        shot_ids(header.get("shots"))
    except _DamageError as damage:
        return {}, [damage]
    except (ValueError, SessionError) as error:
        return {}, [_DamageError(root, HEADER, f"cannot be used ({error}): restore it.")]
    return header, []


def _read_journal(root: Path) -> _Journal:
    events: list[JsonObject] = []
    damage: list[_DamageError] = []
    try:
        lines = list(io.BytesIO(_read(root, JOURNAL)))
    except _DamageError as unreadable:
        return _Journal(events=(), damage=[unreadable], torn=False)
    torn, shift = False, 0
    for number, line in enumerate(lines, start=1):
        try:
            event = _parse_line(line)
        except ValueError as error:
            damage.append(_DamageError(root, JOURNAL, f"is damaged in line {number}: {error}."))
            torn = number == len(lines)
            continue
        if event["n"] - number != shift:
            what = f"has line {event['n']} in line {number}: lines were removed or added before it."
            damage.append(_DamageError(root, JOURNAL, what))
            shift = event["n"] - number
        events.append(event)
    if not events or events[0]["event"] != "open":
        damage.insert(0, _DamageError(root, JOURNAL, "does not begin with an open line."))
    return _Journal(events=tuple(events), damage=damage, torn=torn)


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


def _promised_frames(
    root: Path, events: Iterable[JsonObject], header: JsonObject
) -> tuple[list[CommittedFrame], list[_DamageError]]:
    """Return the frames of the commit and reject lines, and what is wrong with other such lines."""
    frames: dict[str, CommittedFrame] = {}
    damage: list[_DamageError] = []
    known = {shot["id"] for shot in header.get("shots", ())}
    for event in events:
        if event["event"] not in ("commit", "reject"):
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
        damage.append(_DamageError(root, JOURNAL, f"line {event['n']} {what}: do not trust it."))
    return list(frames.values()), damage


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


def _read_pixels(root: Path, frame: CommittedFrame) -> NDArray[np.uint16]:
    file = frame.file
    size = _plain_file(root, file).stat().st_size
    if size != frame.bytes:
        raise _DamageError(
            root, file, f"holds {size} bytes, but {frame.bytes} were committed: restore it."
        )
    content = _read(root, file)
    if xxhash.xxh3_128_hexdigest(content) != frame.details["file_xxh3_128"]:
        raise _DamageError(root, file, "is not the file that was committed: restore it.")
    shape = (frame.details["rows"], frame.details["cols"])
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as tiff:
            page = tiff.pages[0]
            plain = page.shape == shape and page.dtype == np.uint16 and page.compression == 1
            pixels: NDArray[np.uint16] | None = page.asarray() if plain else None
    except Exception as error:  # tifffile has no common base for what a broken file raises
        raise _DamageError(
            root, file, f"is no TIFF that can be read ({error}): restore it."
        ) from error
    if pixels is None:
        raise _DamageError(root, file, f"is no plain 16-bit picture of {shape} px: restore it.")
    if pixel_digest(pixels) != frame.xxh3_128:
        raise _DamageError(root, file, "does not hold the pixels that were committed: restore it.")
    return pixels


def _read_seal(root: Path) -> tuple[JsonObject, list[_DamageError]]:
    if not os.path.lexists(root / SEAL):
        what = "not sealed: interrupted, or still being written."
        return {}, [_DamageError(root, SEAL, what)]
    try:
        seal = _parse(_read(root, SEAL))
        own = seal.pop("seal_sha256", None)
        if own == sha256_of(to_json(seal)) and seal.get("schema") == SCHEMA:
            return seal, []
        what = "does not fit its own digest and proves nothing: restore it."
    except _DamageError as damage:
        return {}, [damage]
    except (ValueError, SessionError) as error:
        what = f"cannot be used ({error}): restore it."
    return {}, [_DamageError(root, SEAL, what)]


def _digests(record: JsonObject) -> dict[str, str]:
    files = record.get("files")
    return {file: str(sha256) for file, sha256 in files.items()} if isinstance(files, dict) else {}


def _check_digest(root: Path, file: str, sha256: str) -> None:
    try:
        same = sha256_of(_plain_file(root, file)) == sha256
    except OSError as error:
        raise _DamageError(root, file, f"cannot be read ({error}).") from error
    if not same:
        raise _DamageError(root, file, "was changed after it was written: restore it.")


def _changed_header(root: Path, events: Iterable[Mapping[str, Any]]) -> list[_DamageError]:
    """Hold the header to the digest that the journal's first line took of it."""
    recorded = _digests(dict(next(iter(events), {})))
    try:
        if HEADER in recorded:
            _check_digest(root, HEADER, recorded[HEADER])
    except _DamageError as damage:
        return [damage]
    return []


def _strays(root: Path, promised: set[str], sealed: Mapping[str, str] | None) -> list[Problem]:
    """List what lies among the captured files and has no business there."""
    found = []
    for file in captured_files(root):
        if is_part(file):
            what = "is left over from an interrupted write."
        elif file.startswith(("frames", "rejected")) and file not in promised:
            what = "has no line in the journal: nobody saved it."
        elif sealed is not None and file not in sealed:
            what = "is not in the seal: it was added afterwards."
        else:
            continue
        found.append(Problem(file=file, what=what))
    return found
