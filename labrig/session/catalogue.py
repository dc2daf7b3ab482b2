"""An index of the sessions below a data root: derived from the journals, deletable, in SQLite."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing, suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from labrig.errors import SessionError
from labrig.session.format import HEADER, JOURNAL, SEAL, frame_file
from labrig.session.lock import holder
from labrig.session.reader import promised_frames, read_header, read_journal

FILE = "catalogue.sqlite"
SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One session: its folder relative to the data root, and how it stands.

    ``state`` is running, completed, aborted, failed, interrupted or damaged; ``stamp`` tells
    whether the folder has changed since it was looked at.
    """

    path: str
    name: str
    state: str
    planned: int
    saved: int
    segments: int
    bytes: int
    created: str
    stamp: str


def catalogue(root: Path) -> list[Entry]:
    """Return the sessions below a data root in order of time, and renew the index there.

    Where the root cannot be written, the index is made anew each time in memory.

    Raises
    ------
    SessionError
        If the root is no folder.
    """
    if not root.is_dir():
        msg = f"{str(root)!r} is no folder: give the data root, below which sessions lie."
        raise SessionError(msg)
    known = _read(root / FILE)
    entries = []
    for path in sorted(p.parent for p in root.glob(f"*/*/{HEADER}")):
        if path.is_symlink() or path.parent.is_symlink():
            continue
        name = path.relative_to(root).as_posix()
        stamp = _stamp(path)
        before = known.get(name)
        if before is not None and before.stamp == stamp and before.state != "running":
            entries.append(before)
        else:
            entries.append(_look(path, name, stamp))
    if list(known.values()) != entries:
        # an index that cannot be kept costs the next call time, nothing else
        with suppress(sqlite3.Error, OSError):
            _write(root / FILE, entries)
    return entries


def _stamp(path: Path) -> str:
    stamps = []
    for name in (HEADER, JOURNAL, SEAL):
        with suppress(OSError):
            found = (path / name).lstat()
            stamps.append(f"{name}:{found.st_size}:{found.st_mtime_ns}")
    return " ".join(stamps)


def _look(path: Path, name: str, stamp: str) -> Entry:
    """Read a session's journal; a session that cannot be trusted is damaged, not an error."""
    header, damage = read_header(path)
    journal = read_journal(path)
    frames, bad = promised_frames(path, journal.events, header)
    sealed = os.path.lexists(path / SEAL)
    torn = journal.torn and not sealed
    damage += (journal.damage[:-1] if torn else journal.damage) + bad
    last = journal.events[-1] if journal.events else {}
    state = "interrupted"
    if damage:
        state = "damaged"
    elif holder(path) is not None:
        state = "running"
    elif last.get("event") == "close" and (sealed or last.get("outcome") != "completed"):
        state = str(last.get("outcome"))
    saved = [frame for frame in frames if frame.file == frame_file("commit", frame.shot, 0)]
    return Entry(
        path=name,
        name=str(header.get("name", "")),
        state=state,
        planned=len(header.get("shots", ())),
        saved=len(saved),
        segments=len({frame.details.get("segment") for frame in saved}),
        bytes=sum(frame.bytes for frame in frames),
        created=str(header.get("created", "")),
        stamp=stamp,
    )


def _read(file: Path) -> dict[str, Entry]:
    """Return the index by path; one that cannot be read is made anew."""
    names = [field.name for field in fields(Entry)]
    try:
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as base:
            if base.execute("PRAGMA user_version").fetchone() != (SCHEMA,):
                return {}
            rows = base.execute("SELECT * FROM sessions ORDER BY path").fetchall()
    except sqlite3.Error:
        return {}
    return {row[0]: Entry(**dict(zip(names, row, strict=True))) for row in rows}


def _write(file: Path, entries: list[Entry]) -> None:
    part = file.with_name(f"{file.name}.{os.getpid()}")
    part.unlink(missing_ok=True)
    columns = ", ".join(field.name for field in fields(Entry))
    marks = ", ".join("?" for _ in fields(Entry))
    with closing(sqlite3.connect(part)) as base, base:
        base.execute(f"CREATE TABLE sessions ({columns})")
        base.executemany(f"INSERT INTO sessions VALUES ({marks})", map(astuple, entries))  # noqa: S608 - only marks
        base.execute(f"PRAGMA user_version = {SCHEMA}")
    part.replace(file)
