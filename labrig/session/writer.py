"""Write a session folder: each frame on the disk before it counts, a seal over all at the end.

docs/file-formats.md shows the folder; docs/decisions/0002-session-format.md says why it is so.
Callers import from `labrig.session`, which also reads what is written here.
"""

from __future__ import annotations

import errno
import os
import platform
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray

from labrig.errors import SessionError
from labrig.session.disk import Disk
from labrig.session.format import (
    CAPTURED,
    FRAME_KEYS,
    HEADER,
    HEADER_KEYS,
    JOURNAL,
    LINE_KEYS,
    RECORDABLE,
    RESERVE,
    SCHEMA,
    SEAL,
    captured_files,
    frame_file,
    is_part,
    journal_line,
    one_line,
    pixel_digest,
    png,
    refuse_reserved,
    sha256_of,
    shot_ids,
    slug,
    software_versions,
    tiff,
    to_json,
)
from labrig.session.items import Item, Progress
from labrig.session.lock import let_go, take_lock


class SessionWriter:
    """Write one session, from one thread; leaving it without an error seals the folder.

    A frame is saved once `commit` or `keep` has returned, whatever then happens to the process or
    the power. An ``OSError`` from any method means that its step was not done: pause, mend the
    disk, and do the step again.
    """

    def __init__(
        self,
        path: Path,
        session_id: str,
        shots: Iterable[str],
        *,
        progress: Progress | None = None,
        lock: int | None = None,
        disk: Disk | None = None,
    ) -> None:
        self.path = path
        self.shots = tuple(shots)
        self.progress = progress or Progress()
        self._id = session_id
        self._known = frozenset(self.shots)
        self._disk = disk or Disk()
        self._lock = take_lock(path) if lock is None else lock
        flags = os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC
        flags |= os.O_CREAT | os.O_EXCL if progress is None else 0
        try:
            self._journal = os.open(path / JOURNAL, flags, 0o644)
        except BaseException:
            if lock is None:
                let_go(self._lock)
            raise
        self._open = True

    @classmethod
    def create(
        cls,
        root: Path,
        name: str,
        header: Mapping[str, Any],
        *,
        patterns: Mapping[str, NDArray[np.uint8]] | None = None,
        disk: Disk | None = None,
    ) -> SessionWriter:
        """Make ``<root>/<YYYY-MM-DD>/<HHMMSS>_<name>_<4 hex>/`` (UTC) and begin its journal.

        Parameters
        ----------
        root : the data root, made if missing
        name : what the operator calls the session
        header : what session.json shall say; ``shots`` are dicts, each with an ``id`` of its own
        patterns : digest to projector image, (rows, cols) uint8

        Raises
        ------
        SessionError
            If header or patterns cannot be kept; nothing is made then.
        """
        shots = shot_ids(header.get("shots"))
        refuse_reserved(header, HEADER_KEYS)
        created = datetime.now(UTC)
        folder = f"{created:%H%M%S}_{slug(name)}_{secrets.token_hex(2)}"
        path = root / f"{created:%Y-%m-%d}" / folder
        about = {
            "schema": SCHEMA,
            "id": f"{created:%Y-%m-%d}_{folder}",
            "created": created.isoformat(timespec="milliseconds"),
            "host": platform.node(),
            "software": software_versions(),
        }
        head = to_json({"name": name, **header, **about}, pretty=True)
        images = {f"patterns/{key}.png": png(key, image) for key, image in (patterns or {}).items()}
        digests = {file: sha256_of(content) for file, content in {HEADER: head, **images}.items()}

        path.mkdir(parents=True)
        for part in CAPTURED:
            (path / part).mkdir()
        writer = cls(path, str(about["id"]), shots, disk=disk)
        try:
            writer._begin(images, head, digests)
            writer._disk.sync_folder(root)
        except BaseException:
            writer._release()
            raise
        return writer

    def _begin(self, images: Mapping[str, bytes], head: bytes, digests: Mapping[str, str]) -> None:
        if images:
            self._disk.write_files({self.path / file: image for file, image in images.items()})
        # random: a compressing file system keeps zeros in no room at all
        self._disk.write_file(self.path / RESERVE, secrets.token_bytes(1 << 20))
        self._append([("open", {"session": self._id, "files": dict(digests)})])
        # last, so that a folder with a header is a whole session
        self._disk.write_file(self.path / HEADER, head)
        self._disk.sync_folder(self.path.parent)

    def commit(
        self, shot_id: str, attempt: int, pixels: NDArray[np.uint16], details: Mapping[str, Any]
    ) -> Path:
        """Save the frame of a shot, (rows, cols) counts; on return it is on the disk.

        Raises
        ------
        SessionError
            If the shot is unknown or has its frame, or pixels or details cannot be kept.
        """
        item = Item(event="commit", shot=shot_id, attempt=attempt, pixels=pixels, details=details)
        self.keep([item])
        return self.path / frame_file("commit", shot_id, attempt)

    def reject(
        self,
        shot_id: str,
        attempt: int,
        pixels: NDArray[np.uint16],
        reason: str,
        details: Mapping[str, Any],
    ) -> Path:
        """Keep a refused frame, (rows, cols) counts, beside the good ones, with the reason."""
        refuse_reserved(details, {"reason"})
        told = {**details, "reason": reason}
        item = Item(event="reject", shot=shot_id, attempt=attempt, pixels=pixels, details=told)
        self.keep([item])
        return self.path / frame_file("reject", shot_id, attempt)

    def record(self, event: str, **details: Any) -> None:
        """Journal a drop, note, pause or resume, or a segment, whose line begins the next one."""
        if event not in RECORDABLE or event == "void":
            msg = f"the journal knows no event {event!r}: use {', '.join(RECORDABLE[:-1])}."
            raise SessionError(msg)
        self._append([(event, details)])
        self.progress.n_dropped += event == "drop"

    def void(self, shot_id: str, reason: str) -> None:
        """Take back a commit: its frame counts no more and lies with the rejected ones."""
        attempt = self.progress.saved.get(shot_id)
        if attempt is None:
            msg = f"shot {shot_id!r} has no frame that could be taken back."
            raise SessionError(msg)
        self._append([("void", {"shot": shot_id, "attempt": attempt, "reason": reason})])
        del self.progress.saved[shot_id]
        self.progress.rejected.add((shot_id, attempt))
        self._disk.move(
            self.path / frame_file("commit", shot_id, attempt),
            self.path / frame_file("reject", shot_id, attempt),
        )

    def forget(self, shot_id: str, reason: str) -> None:
        """Journal that a committed frame is lost; its shot can then be taken again."""
        about = {"shot": shot_id, "attempt": self.progress.saved[shot_id], "reason": reason}
        self._append([("void", {**about, "lost": True})])
        del self.progress.saved[shot_id]

    def keep(self, items: Sequence[Item]) -> None:
        """Keep frames and events together: all are on the disk on return, or none counts.

        Raises
        ------
        SessionError
            If a shot is unknown or has its frame, or pixels or details cannot be kept.
        """
        self._refuse_if_closed()
        files: dict[Path, bytes] = {}
        lines: list[tuple[str, Mapping[str, Any]]] = []
        for item in items:
            if item.pixels is None:
                lines.append((item.event, item.details))
                continue
            self._refuse_second(item)
            facts, content = self._encode(item, item.pixels)
            file = frame_file(item.event, item.shot, item.attempt)
            if self.path / file in files:
                msg = f"shot {item.shot!r} would be saved twice at once: keep one frame of it."
                raise SessionError(msg)
            files[self.path / file] = content
            digest = xxhash.xxh3_128_hexdigest(content)
            about = {**facts, "file": file, "bytes": len(content), "file_xxh3_128": digest}
            lines.append((item.event, about))
        if files:
            self._disk.write_files(files)
        self._append(lines)
        for item in items:
            self._count(item)

    def close(self, outcome: str = "completed") -> None:
        """Journal the outcome, seal every captured file and let go of the lock."""
        if not self._open:
            return
        try:
            self._set_aside_strays()
            ending = {"outcome": outcome, **self._counts()}
            self._append([("close", ending)])
            self._disk.remove(self.path / RESERVE)
            files = [HEADER, JOURNAL, *(f for f in captured_files(self.path) if not is_part(f))]
            digests = {file: sha256_of(self.path / file) for file in files}
            seal = {"schema": SCHEMA, "id": self._id, **ending, "files": digests}
            seal["seal_sha256"] = sha256_of(to_json(seal))
            self._disk.write_file(self.path / SEAL, to_json(seal, pretty=True))
        finally:
            self._release()

    def leave(self, outcome: str, why: str) -> None:
        """Let go of the session without a seal: it can be resumed."""
        if not self._open:
            return
        try:
            # the error that brought us here matters more than a journal that cannot take it
            with suppress(OSError):
                ending = {"outcome": outcome, "error": one_line(why), **self._counts()}
                self._append([("close", ending)])
        finally:
            self._release()

    def __enter__(self) -> SessionWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self.leave("failed", f"{type(error).__name__}: {error}")

    def _counts(self) -> dict[str, int]:
        p = self.progress
        return {"expected": len(self.shots), "saved": len(p.saved), "dropped": p.n_dropped}

    def _refuse_second(self, item: Item) -> None:
        if item.shot not in self._known:
            msg = f"session {self._id} plans no shot {item.shot!r}: take ids from its header."
            raise SessionError(msg)
        if item.event == "commit" and item.shot in self.progress.saved:
            msg = f"shot {item.shot!r} already has its frame: give a second one to reject()."
            raise SessionError(msg)
        if item.event == "reject" and (item.shot, item.attempt) in self.progress.rejected:
            msg = f"attempt {item.attempt} at shot {item.shot!r} was already rejected: count on."
            raise SessionError(msg)

    def _encode(self, item: Item, pixels: NDArray[np.uint16]) -> tuple[dict[str, Any], bytes]:
        if pixels.dtype != np.uint16 or pixels.ndim != 2 or not pixels.size:
            msg = (
                f"the frame of shot {item.shot!r} is {pixels.dtype} of shape {pixels.shape}: "
                "a session keeps uint16 counts, (rows, cols)."
            )
            raise SessionError(msg)
        refuse_reserved(item.details, FRAME_KEYS | LINE_KEYS)
        facts = {
            **item.details,
            "shot": item.shot,
            "attempt": item.attempt,
            "rows": pixels.shape[0],
            "cols": pixels.shape[1],
            "xxh3_128": pixel_digest(pixels),
        }
        about = {"session": self._id, "segment": self.progress.segment, "frame": facts}
        return facts, tiff(pixels, about)

    def _count(self, item: Item) -> None:
        p = self.progress
        p.n_dropped += item.event == "drop"
        if item.shot:
            p.last_attempt[item.shot] = max(p.last_attempt.get(item.shot, 0), item.attempt)
        if item.event == "commit":
            p.saved[item.shot] = item.attempt
        elif item.event == "reject":
            p.rejected.add((item.shot, item.attempt))

    def _append(self, lines: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
        self._refuse_if_closed()
        p = self.progress
        segment, written = p.segment, []
        for number, (event, fields) in enumerate(lines, start=p.n_lines + 1):
            segment += event == "segment"
            written.append(journal_line(event, number, segment, fields))
        content = b"".join(written)
        reserve = self.path / RESERVE
        try:
            self._disk.append(self._journal, content, p.journal_bytes)
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            if not (full and lines[0][0] in ("pause", "close") and reserve.exists()):
                raise
            self._disk.remove(reserve)
            self._disk.append(self._journal, content, p.journal_bytes)
        p.n_lines, p.segment = p.n_lines + len(lines), segment
        p.journal_bytes += len(content)

    def _set_aside_strays(self) -> None:
        """Move files that no line promises, such as of a failed commit, out of the good ones."""
        p = self.progress
        promised = {frame_file("commit", shot, 0) for shot in p.saved}
        promised |= {frame_file("reject", shot, attempt) for shot, attempt in p.rejected}
        for file in captured_files(self.path):
            if file.startswith(("frames/", "rejected/")) and file not in promised:
                free = free_name(self.path / "quarantine", Path(file).name)
                self._disk.move(self.path / file, free)

    def _refuse_if_closed(self) -> None:
        if not self._open:
            msg = f"session {self._id} is closed and takes nothing more: create another."
            raise SessionError(msg)

    def _release(self) -> None:
        self._open = False
        try:
            os.close(self._journal)
        finally:
            let_go(self._lock)


def free_name(folder: Path, name: str) -> Path:
    """Return a path in a folder that nothing has yet: the name, with a number if need be."""
    folder.mkdir(exist_ok=True)
    name = name.removesuffix(".part") + ("-part" if name.endswith(".part") else "")
    path, k = folder / name, 1
    while os.path.lexists(path):
        path, k = folder / f"{name}.{k}", k + 1
    return path
