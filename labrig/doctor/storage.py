"""What a disk does with what is written to it, tried out where sessions will be."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from pathlib import Path

from labrig.doctor.finding import Finding

SLOW_SYNC_S, INSTANT_SYNC_S = 0.05, 5e-6
ENOUGH_BYTES = 1 << 30
VOLATILE = {"tmpfs", "ramfs"}
REMOTE = {"nfs", "nfs4", "cifs", "smb3", "9p", "fuse.sshfs", "ceph", "glusterfs"}


def disk(out: Path) -> Finding:
    """Write, fsync, rename and lock a small file in the data root; say what that took."""
    place = next(p for p in (out.absolute(), *out.absolute().parents) if p.is_dir())
    try:
        median_s = _try_out(place)
    except OSError as error:
        text = f"{place} cannot be written as sessions are ({error.strerror})"
        return Finding(name="disk", ok=False, text=text, remedy="choose another folder by --out")
    free, kind = shutil.disk_usage(place).free, file_system(place)
    text = (
        f"{place} ({kind}): {free / 1e9:.1f} GB free, fsync of 64 kB takes {1e3 * median_s:.2f} ms"
    )
    remedy = ""
    if kind in VOLATILE:
        text, remedy = f"{text}; it is memory, gone with the power", "choose a disk by --out"
    elif kind in REMOTE:
        text += "; over a network, where locks and fsync may not hold"
        remedy = "capture to a local disk by --out, and copy afterwards"
    elif median_s < INSTANT_SYNC_S:
        text += "; so fast that nothing reaches the disk"
        remedy = "end what switches fsync off, such as eatmydata"
    elif median_s > SLOW_SYNC_S or free < ENOUGH_BYTES:
        remedy = "make room, or choose a faster local disk by --out"
    return Finding(name="disk", ok=not remedy, text=text, remedy=remedy)


def file_system(place: Path, mounts: Path = Path("/proc/self/mountinfo")) -> str:
    """Return the kind of the file system that holds a folder: ext4, xfs, tmpfs, nfs4, ..."""
    best, kind = -1, "unknown"
    folder = str(place.resolve())
    for line in mounts.read_text(encoding="utf-8").splitlines():
        told, _, about = line.partition(" - ")
        at = told.split()[4].encode().decode("unicode_escape")
        inside = folder == at or folder.startswith(at.rstrip("/") + "/")
        if inside and len(at) >= best:
            best, kind = len(at), about.split()[0]
    return kind


def _try_out(place: Path) -> float:
    """Return the median time of an fsync, s; every other call that a session needs is tried."""
    times = []
    with tempfile.TemporaryDirectory(dir=place, prefix=".labrig-doctor-") as name:
        file = Path(name, "file.part")
        with file.open("wb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for _ in range(10):
                stream.write(bytes(1 << 16))
                stream.flush()
                begun = time.perf_counter()
                os.fsync(stream.fileno())
                times.append(time.perf_counter() - begun)
        file.replace(Path(name, "file"))
        folder = os.open(name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    return sorted(times)[len(times) // 2]
