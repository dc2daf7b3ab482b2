"""Write a session folder: each frame on the disk before it counts, a seal over all at the end.

docs/file-formats.md shows the folder; docs/decisions/0002-session-format.md says why it is so.
Callers import from `labrig.session`, which also reads what is written here.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import io
import json
import os
import platform
import re
import secrets
import unicodedata
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import tifffile
import xxhash
from numpy.typing import NDArray

from labrig.errors import SessionError, SessionLockedError

SCHEMA = "labrig-session/1"
JsonObject = dict[str, Any]

HEADER, JOURNAL, SEAL = "session.json", "journal.jsonl", "SEAL.json"
CAPTURED = ("calibration", "frames", "patterns", "rejected")
_LOCK, _RESERVE = "session.lock", "reserve.bin"
_RECORDABLE = ("drop", "note", "pause", "resume", "segment")
_PACKAGES = ("labrig", "numpy", "opencv-contrib-python-headless", "scipy", "tifffile", "xxhash")
_HEADER_KEYS = {"created", "host", "id", "schema", "software"}
_LINE_KEYS = {"crc32", "event", "n", "segment", "t"}
_FRAME_KEYS = {"attempt", "bytes", "cols", "file", "file_xxh3_128", "rows", "shot", "xxh3_128"}
_STEM = re.compile(r"[A-Za-z0-9._-]{1,200}")


class SessionWriter:
    """Write one session, from one thread; leaving it without an error seals the folder.

    A frame is saved once `commit` has returned, whatever then happens to the process or the
    power. An ``OSError`` from any method means that its step was not done: pause, mend the
    disk, and do the step again.
    """

    def __init__(self, path: Path, session_id: str, shots: Iterable[str]) -> None:
        self.path = path
        self._id = session_id
        self._saved = dict.fromkeys(shots, False)
        self._rejected: set[tuple[str, int]] = set()
        self._n_lines = self._n_dropped = self._journal_bytes = 0
        self._segment = 1
        self._lock = _take_lock(path)
        self._journal = os.open(path / JOURNAL, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._open = True

    @classmethod
    def create(
        cls,
        root: Path,
        name: str,
        header: Mapping[str, Any],
        *,
        patterns: Mapping[str, NDArray[np.uint8]] | None = None,
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
        _refuse_reserved(header, _HEADER_KEYS)
        created = datetime.now(UTC)
        folder = f"{created:%H%M%S}_{_slug(name)}_{secrets.token_hex(2)}"
        path = root / f"{created:%Y-%m-%d}" / folder
        about = {
            "schema": SCHEMA,
            "id": f"{created:%Y-%m-%d}_{folder}",
            "created": created.isoformat(timespec="milliseconds"),
            "host": platform.node(),
            "software": _software(),
        }
        head = to_json({"name": name, **header, **about}, pretty=True)
        images = {
            f"patterns/{key}.png": _png(key, image) for key, image in (patterns or {}).items()
        }
        digests = {file: sha256_of(content) for file, content in {HEADER: head, **images}.items()}

        path.mkdir(parents=True)
        for part in CAPTURED:
            (path / part).mkdir()
        writer = cls(path, str(about["id"]), shots)
        try:
            for file, content in images.items():
                _write_file(path / file, content)
            # random: a compressing file system keeps zeros in no room at all
            _write_file(path / _RESERVE, secrets.token_bytes(1 << 20))
            writer._append("open", {"session": about["id"], "files": digests})
            # last, so that a folder with a header is a whole session
            _write_file(path / HEADER, head)
            _sync_folder(path.parent)
            _sync_folder(root)
        except BaseException:
            writer._release()
            raise
        return writer

    def commit(
        self, shot_id: str, attempt: int, pixels: NDArray[np.uint16], details: Mapping[str, Any]
    ) -> Path:
        """Save the frame of a shot, (rows, cols) counts; on return it is on the disk.

        Raises
        ------
        SessionError
            If the shot is unknown or has its frame, or pixels or details cannot be kept.
        """
        if self._saved.get(shot_id):
            msg = f"shot {shot_id!r} already has its frame: give a second one to reject()."
            raise SessionError(msg)
        path = self._keep("commit", shot_id, attempt, pixels, details)
        self._saved[shot_id] = True
        return path

    def reject(
        self,
        shot_id: str,
        attempt: int,
        pixels: NDArray[np.uint16],
        reason: str,
        details: Mapping[str, Any],
    ) -> Path:
        """Keep a refused frame, (rows, cols) counts, beside the good ones, with the reason."""
        _refuse_reserved(details, {"reason"})
        if (shot_id, attempt) in self._rejected:
            msg = f"attempt {attempt} at shot {shot_id!r} was already rejected: count on."
            raise SessionError(msg)
        path = self._keep("reject", shot_id, attempt, pixels, {**details, "reason": reason})
        self._rejected.add((shot_id, attempt))
        return path

    def record(self, event: str, **details: Any) -> None:
        """Journal a drop, note, pause or resume, or a segment, whose line begins the next one."""
        if event not in _RECORDABLE:
            msg = f"the journal knows no event {event!r}: use {', '.join(_RECORDABLE)}."
            raise SessionError(msg)
        self._append(event, details)
        self._n_dropped += event == "drop"

    def close(self, outcome: str = "completed") -> None:
        """Journal the outcome, seal every captured file and let go of the lock."""
        if not self._open:
            return
        try:
            ending = {"outcome": outcome, **self._counts()}
            self._append("close", ending)
            (self.path / _RESERVE).unlink(missing_ok=True)
            files = [HEADER, JOURNAL, *(f for f in captured_files(self.path) if not is_part(f))]
            digests = {file: sha256_of(self.path / file) for file in files}
            seal = {"schema": SCHEMA, "id": self._id, **ending, "files": digests}
            seal["seal_sha256"] = sha256_of(to_json(seal))
            _write_file(self.path / SEAL, to_json(seal, pretty=True))
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
        elif self._open:
            why = one_line(f"{type(error).__name__}: {error}")
            try:
                # the error that brought us here matters more than a journal that cannot take it
                with suppress(OSError):
                    self._append("close", {"outcome": "failed", "error": why, **self._counts()})
            finally:
                self._release()

    def _counts(self) -> dict[str, int]:
        saved = sum(self._saved.values())
        return {"expected": len(self._saved), "saved": saved, "dropped": self._n_dropped}

    def _keep(
        self,
        event: str,
        shot_id: str,
        attempt: int,
        pixels: NDArray[np.uint16],
        details: Mapping[str, Any],
    ) -> Path:
        """Write file, then line: a frame without its journal line does not exist."""
        self._refuse_if_closed()
        if shot_id not in self._saved:
            msg = f"session {self._id} plans no shot {shot_id!r}: take ids from its header."
            raise SessionError(msg)
        if pixels.dtype != np.uint16 or pixels.ndim != 2 or not pixels.size:
            msg = (
                f"the frame of shot {shot_id!r} is {pixels.dtype} of shape {pixels.shape}: "
                "a session keeps uint16 counts, (rows, cols)."
            )
            raise SessionError(msg)
        _refuse_reserved(details, _FRAME_KEYS | _LINE_KEYS)
        facts = {
            **details,
            "shot": shot_id,
            "attempt": attempt,
            "rows": pixels.shape[0],
            "cols": pixels.shape[1],
            "xxh3_128": pixel_digest(pixels),
        }
        content = _tiff(pixels, {"session": self._id, "segment": self._segment, "frame": facts})
        file = frame_file(event, shot_id, attempt)
        _write_file(self.path / file, content)
        digest = xxhash.xxh3_128_hexdigest(content)
        line = {**facts, "file": file, "bytes": len(content), "file_xxh3_128": digest}
        self._append(event, line)
        return self.path / file

    def _append(self, event: str, fields: Mapping[str, Any]) -> None:
        self._refuse_if_closed()
        _refuse_reserved(fields, _LINE_KEYS)
        segment = self._segment + (event == "segment")
        t = datetime.now(UTC).isoformat(timespec="milliseconds")
        body = to_json(
            {**fields, "event": event, "n": self._n_lines + 1, "segment": segment, "t": t}
        )
        line = body[:-1] + b',"crc32":"%08x"}\n' % zlib.crc32(body)
        reserve = self.path / _RESERVE
        try:
            self._write_line(line)
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            if not (full and event in ("pause", "close") and reserve.exists()):
                raise
            reserve.unlink()
            self._write_line(line)
        self._n_lines, self._segment = self._n_lines + 1, segment
        self._journal_bytes += len(line)

    def _write_line(self, line: bytes) -> None:
        """Write behind the last good line, so that a failed line is never one in the middle."""
        try:
            os.lseek(self._journal, self._journal_bytes, os.SEEK_SET)
            rest = memoryview(line)
            while rest:
                rest = rest[os.write(self._journal, rest) :]
            os.fdatasync(self._journal)
        except BaseException:
            with suppress(OSError):
                os.ftruncate(self._journal, self._journal_bytes)
            raise

    def _refuse_if_closed(self) -> None:
        if not self._open:
            msg = f"session {self._id} is closed and takes nothing more: create another."
            raise SessionError(msg)

    def _release(self) -> None:
        self._open = False
        try:
            os.close(self._journal)
        finally:
            _held_locks.discard(self._lock)
            os.close(self._lock)


_held_locks: set[int] = set()


def _forget_locks() -> None:
    for lock in _held_locks:
        os.close(lock)
    _held_locks.clear()


# a forked helper shares the lock and would hold it after its parent was killed
os.register_at_fork(after_in_child=_forget_locks)


def _take_lock(folder: Path) -> int:
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = one_line(os.read(lock, 500).decode(errors="replace").strip())
        os.close(lock)
        msg = f"{folder.name} is being written by {holder or 'another'}: wait for it, or end it."
        raise SessionLockedError(msg) from None
    os.ftruncate(lock, 0)
    os.write(lock, f"pid {os.getpid()} on host {platform.node()} (boot {boot})\n".encode())
    _held_locks.add(lock)
    return lock


def shot_ids(shots: object) -> list[str]:
    """Return the ids of a header's shots, refused unless each can name a file of its own."""
    if not isinstance(shots, list | tuple) or not shots:
        msg = "the header lists no shots: give a list of dicts, each with an id."
        raise SessionError(msg)
    ids: dict[str, None] = {}
    for shot in shots:
        shot_id = shot.get("id") if isinstance(shot, Mapping) else None
        if not isinstance(shot_id, str) or not _STEM.fullmatch(shot_id):
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


def _refuse_reserved(fields: Mapping[str, Any], reserved: set[str]) -> None:
    if clash := sorted(fields.keys() & reserved):
        msg = f"{', '.join(clash)}: the session writes this itself; use another name."
        raise SessionError(msg)


def _slug(name: str) -> str:
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain)[:48].strip("-") or "session"


def _software() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions


def _png(key: str, image: NDArray[np.uint8]) -> bytes:
    if not _STEM.fullmatch(key) or image.dtype != np.uint8 or image.ndim != 2 or not image.size:
        msg = (
            f"pattern {key!r} is {image.dtype} of shape {image.shape}: "
            "give uint8 levels, (rows, cols), under a digest that can name a file."
        )
        raise SessionError(msg)
    return bytes(cv2.imencode(".png", image)[1])


def _tiff(pixels: NDArray[np.uint16], about: Mapping[str, Any]) -> bytes:
    text = to_json({**about, "schema": SCHEMA})
    if b'"shape":' in text:
        msg = "details hold a 'shape', by which tifffile knows files of its own: use another name."
        raise SessionError(msg)
    stream = io.BytesIO()
    tifffile.imwrite(
        stream,
        pixels,
        byteorder="<",
        bigtiff=False,
        photometric="minisblack",
        description=text,
        metadata=None,
        software="labrig",
    )
    return stream.getvalue()


def _write_file(path: Path, content: bytes) -> None:
    """Put a file in place so that it is either whole on the disk or not there."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
