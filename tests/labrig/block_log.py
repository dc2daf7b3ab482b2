"""A disk of one file that logs every write and flush, for the kernel's loop driver to sit on.

`python block_log.py IMAGE LOG FOLDER` serves FOLDER/disk by the FUSE protocol until it is
unmounted: as dm-log-writes does, but with nothing beside /dev/fuse. `replay` makes the disk of any
instant.
"""

from __future__ import annotations

import ctypes
import errno
import os
import random
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

FORGET, GETATTR, LOOKUP, OPEN, READ, WRITE = 2, 3, 1, 14, 15, 16
RELEASE, FSYNC, INIT, OPENDIR, RELEASEDIR, INTERRUPT, BATCH_FORGET = 18, 20, 26, 27, 29, 36, 42
BIG_WRITES = 1 << 5
MAX_WRITE = 1 << 17
SECTOR = 512
NAME, ROOT, FILE = b"disk", 1, 2
HEAD = struct.Struct("<cQI")  # kind, offset, bytes that follow


@dataclass(frozen=True, slots=True)
class Record:
    """A write at an offset, or a flush, after which all before it is on the disk."""

    end: int  # of the log after this record: when it happened
    offset: int
    content: bytes | None


def records(log: Path) -> Iterator[Record]:
    """Yield what happened, in order."""
    content, at = log.read_bytes(), 0
    while at + HEAD.size <= len(content):
        kind, offset, size = HEAD.unpack_from(content, at)
        at += HEAD.size
        yield Record(at + size, offset, content[at : at + size] if kind == b"w" else None)
        at += size


def replay(base: Path, log: Path, cut: int, target: Path, rng: random.Random) -> None:
    """Write the disk as it is after the power went when the log was ``cut`` bytes long.

    All writes before the last flush are there. Those after it lay in the disk's cache: each sector
    of them made it or did not, in no order.
    """
    happened = [r for r in records(log) if r.end <= cut]
    last_flush = max((n for n, r in enumerate(happened) if r.content is None), default=-1)
    disk = bytearray(base.read_bytes())
    for n, record in enumerate(happened):
        if record.content is None:
            continue
        step = len(record.content) if n < last_flush else SECTOR
        for k in range(0, len(record.content), step):
            if n < last_flush or rng.random() < 0.5:
                piece = record.content[k : k + step]
                disk[record.offset + k : record.offset + k + len(piece)] = piece
    target.write_bytes(disk)


def serve(image: Path, log: Path, folder: Path) -> None:
    """Answer the kernel until the folder is unmounted."""
    disk = os.open(image, os.O_RDWR)
    told = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    size = image.stat().st_size
    fuse = os.open("/dev/fuse", os.O_RDWR)
    libc = ctypes.CDLL(None, use_errno=True)
    how = f"fd={fuse},rootmode=40000,user_id=0,group_id=0".encode()
    if libc.mount(b"blocklog", bytes(folder), b"fuse", 6, how):
        raise OSError(ctypes.get_errno(), "mount")

    def attributes(node: int) -> bytes:
        mode, length = (0o40755, 0) if node == ROOT else (0o100600, size)
        about = (0, 0, 0, mode, 1, 0, 0, 0, 4096, 0)
        return struct.pack("<6Q10I", node, length, length // 512, 0, 0, 0, *about)

    def look_up(node: int, body: bytes) -> bytes | int:
        if node != ROOT or body.rstrip(b"\0") != NAME:
            return errno.ENOENT
        return struct.pack("<4Q2I", FILE, 0, 3600, 3600, 0, 0) + attributes(FILE)

    def read(_node: int, body: bytes) -> bytes:
        _, offset, length = struct.unpack_from("<2QI", body)
        return os.pread(disk, length, offset)

    def write(_node: int, body: bytes) -> bytes:
        _, offset, length = struct.unpack_from("<2QI", body)
        content = body[40 : 40 + length]
        os.pwrite(disk, content, offset)
        os.write(told, HEAD.pack(b"w", offset, length) + content)
        return struct.pack("<2I", length, 0)

    def flush(_node: int, _body: bytes) -> bytes:
        os.write(told, HEAD.pack(b"f", 0, 0))
        return b""

    limits = (7, 31, 65536, BIG_WRITES, 16, 12, MAX_WRITE, 1, 0, 0, *[0] * 8)
    answers: dict[int, Callable[[int, bytes], bytes | int]] = {
        INIT: lambda _node, _body: struct.pack("<4I2H2I2H8I", *limits),
        LOOKUP: look_up,
        GETATTR: lambda node, _body: struct.pack("<Q2I", 3600, 0, 0) + attributes(node),
        OPEN: lambda _node, _body: bytes(16),
        OPENDIR: lambda _node, _body: bytes(16),
        READ: read,
        WRITE: write,
        FSYNC: flush,
        RELEASE: lambda _node, _body: b"",
        RELEASEDIR: lambda _node, _body: b"",
    }

    while True:
        try:
            asked = os.read(fuse, MAX_WRITE + 8192)
        except OSError as error:
            if error.errno == errno.ENODEV:
                return
            if error.errno in (errno.EINTR, errno.ENOENT):
                continue
            raise
        _, code, unique, node = struct.unpack_from("<2I2Q", asked)
        if code in (FORGET, BATCH_FORGET, INTERRUPT):
            continue
        said = answers.get(code, lambda _node, _body: errno.ENOSYS)(node, asked[40:])
        error, content = (-said, b"") if isinstance(said, int) else (0, said)
        os.write(fuse, struct.pack("<IiQ", 16 + len(content), error, unique) + content)


if __name__ == "__main__":
    serve(*(Path(name) for name in sys.argv[1:]))
