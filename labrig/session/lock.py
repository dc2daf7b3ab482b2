"""The lock by which one process alone writes a session; the kernel frees it with its holder."""

from __future__ import annotations

import fcntl
import os
import platform
from pathlib import Path

from labrig.errors import SessionLockedError
from labrig.session.format import LOCK, one_line

_held_locks: set[int] = set()


def _forget_locks() -> None:
    for lock in _held_locks:
        os.close(lock)
    _held_locks.clear()


# a forked helper shares the lock and would hold it after its parent was killed
os.register_at_fork(after_in_child=_forget_locks)


def take_lock(folder: Path) -> int:
    """Lock a session; return the descriptor that holds it.

    Raises
    ------
    SessionLockedError
        If another holds it, naming who.
    """
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
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


def let_go(lock: int) -> None:
    """Free a session."""
    _held_locks.discard(lock)
    os.close(lock)


def holder(folder: Path) -> str | None:
    """Return who writes a session at this moment; None if nobody does, or no lock can be had."""
    try:
        lock = os.open(folder / LOCK, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return one_line(os.read(lock, 500).decode(errors="replace").strip()) or "another"
    except OSError:
        return None
    finally:
        os.close(lock)
    return None
