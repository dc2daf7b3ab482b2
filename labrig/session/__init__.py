"""Read a session folder back, and verify it: what is not as it was written is named, never guessed.

docs/file-formats.md shows the folder; docs/decisions/0002-session-format.md says why it is so.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.errors import SessionError
from labrig.session.format import (
    HEADER,
    JOURNAL,
    SCHEMA,
    SEAL,
    JsonObject,
    captured_files,
    frame_file,
    is_part,
    sha256_of,
)
from labrig.session.reader import (
    CommittedFrame,
    DamageError,
    Problem,
    digests_of,
    plain_file,
    promised_frames,
    read_header,
    read_journal,
    read_pixels,
    read_seal,
    root_of,
)
from labrig.session.writer import SessionWriter

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
        root = root_of(path)
        sealed = os.path.lexists(root / SEAL)
        header, damage = read_header(root)
        journal = read_journal(root)
        frames, bad_lines = promised_frames(root, journal.events, header)
        tolerated = journal.torn and not sealed
        damage += (journal.damage[:-1] if tolerated else journal.damage) + bad_lines
        damage += _changed_header(root, journal.events)
        damage += read_seal(root)[1] if sealed else []
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
        return read_pixels(self.path, self.frames[shot_id])


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
    root = root_of(path)
    header, damage = read_header(root)
    journal = read_journal(root)
    frames, bad_lines = promised_frames(root, journal.events, header)
    seal, seal_damage = read_seal(root)
    damage += [*journal.damage, *bad_lines, *seal_damage]
    digests = digests_of(seal or next(iter(journal.events), {}))

    checks: list[Callable[[], object]] = [partial(read_pixels, root, frame) for frame in frames]
    checks += [partial(_check_digest, root, file, sha256) for file, sha256 in digests.items()]
    for done, check in enumerate(checks, start=1):
        try:
            check()
        except DamageError as error:
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


def _check_digest(root: Path, file: str, sha256: str) -> None:
    try:
        same = sha256_of(plain_file(root, file)) == sha256
    except OSError as error:
        raise DamageError(root, file, f"cannot be read ({error}).") from error
    if not same:
        raise DamageError(root, file, "was changed after it was written: restore it.")


def _changed_header(root: Path, events: Iterable[Mapping[str, Any]]) -> list[DamageError]:
    """Hold the header to the digest that the journal's first line took of it."""
    recorded = digests_of(next(iter(events), {}))
    try:
        if HEADER in recorded:
            _check_digest(root, HEADER, recorded[HEADER])
    except DamageError as damage:
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
