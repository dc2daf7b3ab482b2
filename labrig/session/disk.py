"""The only door to the disk while a session is written; a test stands in it and lets calls fail."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path


class Disk:
    """Puts files in place so that each is either whole on the disk or not there."""

    def write_files(self, files: Mapping[Path, bytes]) -> None:
        """Write, fsync, rename, and fsync each folder once; take back what fails."""
        parts = {path: path.with_name(path.name + ".part") for path in files}
        placed: list[Path] = []
        try:
            for path, content in files.items():
                self._write_part(parts[path], content)
            for path, part in parts.items():
                part.replace(path)
                placed.append(path)
            for folder in dict.fromkeys(path.parent for path in files):
                self.sync_folder(folder)
        except BaseException:
            for path in [*placed, *parts.values()]:
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            raise

    def write_file(self, path: Path, content: bytes) -> None:
        """Write one file."""
        self.write_files({path: content})

    def move(self, source: Path, target: Path) -> None:
        """Rename a file, and fsync the folders it leaves and enters."""
        source.replace(target)
        for folder in dict.fromkeys((source.parent, target.parent)):
            self.sync_folder(folder)

    def remove(self, path: Path) -> None:
        """Remove a file; harmless if it is not there."""
        path.unlink(missing_ok=True)

    def append(self, descriptor: int, content: bytes, at: int) -> None:
        """Write behind the last good byte, so that what fails is never in the middle."""
        try:
            os.lseek(descriptor, at, os.SEEK_SET)
            rest = memoryview(content)
            while rest:
                rest = rest[self._write(descriptor, rest) :]
            os.fdatasync(descriptor)
        except BaseException:
            with suppress(OSError):
                os.ftruncate(descriptor, at)
            raise

    def sync_folder(self, path: Path) -> None:
        """Let the names in a folder reach the disk."""
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _write(self, descriptor: int, content: memoryview) -> int:
        return os.write(descriptor, content)

    def _write_part(self, part: Path, content: bytes) -> None:
        # a new inode: after a failed fsync the pages of the old one count as clean
        with suppress(FileNotFoundError):
            part.unlink()
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(part, flags, 0o644)
        try:
            rest = memoryview(content)
            while rest:
                rest = rest[self._write(descriptor, rest) :]
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
