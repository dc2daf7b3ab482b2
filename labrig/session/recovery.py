"""Take up a session whose writer was killed: what was saved is checked, the rest set aside."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.errors import SessionError
from labrig.session.disk import Disk
from labrig.session.format import (
    CAPTURED,
    HEADER,
    JOURNAL,
    RESERVE,
    SEAL,
    JsonObject,
    captured_files,
    frame_file,
    shot_ids,
)
from labrig.session.items import Progress
from labrig.session.lock import let_go, take_lock
from labrig.session.reader import (
    CommittedFrame,
    DamageError,
    Journal,
    check_bytes,
    plain_file,
    promised_frames,
    read_header,
    read_journal,
    root_of,
)
from labrig.session.writer import SessionWriter, free_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """What was found when a session was taken up again.

    Attributes
    ----------
    header : session.json
    saved : frames that are as they were committed
    lost : shots whose committed frame is missing or damaged; they are to be taken again
    quarantined : files that no line promised, by their new names
    torn : whether the last line of the journal was cut short, and set aside
    events : the lines of the journal
    """

    header: Mapping[str, Any]
    saved: int
    lost: tuple[str, ...]
    quarantined: tuple[str, ...]
    torn: bool
    events: tuple[Mapping[str, Any], ...]


def reopen(path: Path, *, disk: Disk | None = None) -> tuple[SessionWriter, Recovery]:
    """Lock a session that has no whole seal, check it, and return its writer.

    Only the last line of a journal may be torn; it was never acknowledged. A session that was
    sealed with shots missing (aborted, failed) is opened again.

    Raises
    ------
    SessionError, SessionLockedError
        If it is whole, cannot be trusted, or is being written.
    """
    root, disk = root_of(path), disk or Disk()
    header, journal, frames = _read_trusted(root)
    try:
        lock = take_lock(root)
    except OSError as error:
        msg = f"{root.name}/session.lock cannot be opened ({error.strerror}): remove it."
        raise SessionError(msg) from error
    try:
        # what was read before the lock may have grown since
        header, journal, frames = _read_trusted(root)
        quarantined = _mend_journal(root, journal, disk)
        lost = _lost(root, frames)
        quarantined += _set_aside(root, frames, lost, disk)
        progress = _progress(journal, frames)
        writer = SessionWriter(
            root,
            str(header["id"]),
            shot_ids(header["shots"]),
            progress=progress,
            lock=lock,
            disk=disk,
        )
    except BaseException:
        let_go(lock)
        raise
    _give_up_lost(writer, lost, disk)
    return writer, Recovery(
        header=header,
        saved=len(progress.saved),
        lost=lost,
        quarantined=tuple(quarantined),
        torn=journal.torn,
        events=journal.events,
    )


def _give_up_lost(writer: SessionWriter, lost: Iterable[str], disk: Disk) -> None:
    """Journal what was lost, and have the reserve again."""
    try:
        for shot in lost:
            writer.forget(shot, "its file was missing or damaged when the session was resumed")
        if not os.path.lexists(writer.path / RESERVE):
            disk.write_file(writer.path / RESERVE, secrets.token_bytes(1 << 20))
    except BaseException:
        writer.leave("failed", "could not be taken up again")
        raise


def _read_trusted(root: Path) -> tuple[JsonObject, Journal, list[CommittedFrame]]:
    """Return header, journal and promised frames, or raise what is wrong with them."""
    header, damage = read_header(root)
    journal = read_journal(root)
    frames, bad_lines = promised_frames(root, journal.events, header)
    torn = journal.torn and not os.path.lexists(root / SEAL)
    damage += (journal.damage[:-1] if torn else journal.damage) + bad_lines
    if damage:
        raise damage[0]
    committed = {f.shot for f in frames if f.file == frame_file("commit", f.shot, 0)}
    if os.path.lexists(root / SEAL) and committed == set(shot_ids(header["shots"])):
        msg = f"{root.name} is complete and sealed: there is nothing to resume."
        raise SessionError(msg)
    for part in CAPTURED:
        if (root / part).is_symlink():
            raise DamageError(root, part, "is a symbolic link: put the folder in its place.")
    plain_file(root, HEADER)
    return header, journal, frames


def _mend_journal(root: Path, journal: Journal, disk: Disk) -> list[str]:
    """Set a seal with gaps and a torn last line aside; return their new names."""
    moved = []
    if os.path.lexists(root / SEAL):
        target = free_name(root / "quarantine", SEAL)
        disk.move(root / SEAL, target)
        moved.append(target.relative_to(root).as_posix())
    if journal.torn:
        path = plain_file(root, JOURNAL)
        target = free_name(root / "quarantine", "torn-line")
        with path.open("rb+") as stream:
            stream.seek(journal.end)
            disk.write_file(target, stream.read())
            stream.truncate(journal.end)
            os.fsync(stream.fileno())
        moved.append(target.relative_to(root).as_posix())
    return moved


def _lost(root: Path, frames: Iterable[CommittedFrame]) -> tuple[str, ...]:
    lost = []
    for frame in frames:
        if frame.file == frame_file("commit", frame.shot, 0):
            try:
                check_bytes(root, frame)
            except DamageError:
                lost.append(frame.shot)
    return tuple(lost)


def _set_aside(
    root: Path, frames: Iterable[CommittedFrame], lost: Iterable[str], disk: Disk
) -> list[str]:
    """Move what no line promises to the quarantine, after moves that a crash cut short."""
    promised = {frame.file: frame for frame in frames}
    damaged = {frame_file("commit", shot, 0) for shot in lost}
    for file, frame in promised.items():
        stray = frame_file("commit", frame.shot, 0)
        cut_short = stray not in promised and not os.path.lexists(root / file)
        if file != stray and cut_short and os.path.lexists(root / stray):
            disk.move(root / stray, root / file)
    moved = []
    for file in captured_files(root):
        kept = file in promised and file not in damaged
        if kept or (
            file.startswith(("patterns/", "calibration/", "quarantine/"))
            and not file.endswith(".part")
        ):
            continue
        if "/" not in file and not file.endswith(".part"):
            continue
        target = free_name(root / "quarantine", Path(file).name)
        disk.move(root / file, target)
        moved.append(target.relative_to(root).as_posix())
    return moved


def _progress(journal: Journal, frames: Iterable[CommittedFrame]) -> Progress:
    progress = Progress(
        n_lines=len(journal.events),
        n_dropped=sum(event["event"] == "drop" for event in journal.events),
        segment=max((int(event.get("segment", 1)) for event in journal.events), default=1),
        journal_bytes=journal.end,
    )
    for frame in frames:
        if frame.file == frame_file("commit", frame.shot, 0):
            progress.saved[frame.shot] = frame.attempt
        else:
            progress.rejected.add((frame.shot, frame.attempt))
    for event in journal.events:
        shot, attempt = event.get("shot"), event.get("attempt")
        if isinstance(shot, str) and type(attempt) is int:
            progress.last_attempt[shot] = max(progress.last_attempt.get(shot, 0), attempt)
    return progress
