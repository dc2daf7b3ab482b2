"""R4, R13: the power goes at any write to the disk; a session lies on a read-only medium.

Both need root. The disk is a file behind the kernel's own loop driver and ext4; `block_log` keeps
every write and flush that reached it, and makes the disk of any instant from them.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import block_log
import numpy as np
import pytest
import toy

from labrig.acquisition.run_state import State
from labrig.session import Session, keeper, verify
from labrig.session.catalogue import catalogue
from labrig.session.items import Item
from labrig.session.writer import SessionWriter

# `make torture` cuts at every flush and twice between
CUTS = int(os.environ.get("LABRIG_CUTS", "20"))
SIZE = 24 << 20


def lacking() -> str:
    """What this machine lacks for the tests here, in words; nothing if it has all."""
    if os.geteuid() != 0:
        return "needs root, to mount"
    for node in ("/dev/fuse", "/dev/loop-control"):
        if not os.access(node, os.R_OK | os.W_OK):
            return f"needs {node}"
    tools = [t for t in ("mkfs.ext4", "losetup", "mount", "umount") if shutil.which(t) is None]
    if tools:
        return f"needs {', '.join(tools)}"
    try:
        call("unshare", "--mount", "true")
    except subprocess.CalledProcessError:
        return "may not mount here"
    return ""


def call(*words: object) -> str:
    done = subprocess.run([*map(str, words)], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@contextmanager
def mounted(source: Path, folder: Path, options: str) -> Iterator[Path]:
    folder.mkdir(exist_ok=True)
    call("mount", "-o", options, source, folder)
    try:
        yield folder
    finally:
        call("umount", folder)


@pytest.fixture(autouse=True)
def _root() -> None:
    if why := lacking():
        pytest.skip(why)


@pytest.fixture
def logged_disk(tmp_path: Path) -> Iterator[tuple[Path, Path, Path]]:
    """An empty ext4: the folder it is mounted on, its image when empty, the log of its writes."""
    base, image, log, server = (tmp_path / n for n in ("base", "image", "log", "server"))
    with base.open("wb") as stream:
        stream.truncate(SIZE)
    call("mkfs.ext4", "-q", "-E", "lazy_itable_init=0,lazy_journal_init=0", base)
    shutil.copy(base, image)
    server.mkdir()
    code = [sys.executable, block_log.__file__, str(image), str(log), str(server)]
    with subprocess.Popen(code) as process:
        until = time.monotonic() + 60.0
        while not (server / "disk").exists():
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        try:
            loop = call("losetup", "--find", "--show", server / "disk")
            try:
                with mounted(Path(loop), tmp_path / "disk", "noatime") as folder:
                    yield folder, base, log
            finally:
                call("losetup", "--detach", loop)
        finally:
            call("umount", server)
            process.wait(20.0)


@pytest.mark.parametrize("group", [1, 8])
def test_r4_power_cut_at_any_flush_loses_nothing_acknowledged(
    group, logged_disk, tmp_path: Path, monkeypatch
) -> None:
    folder, base, log = logged_disk
    monkeypatch.setattr(keeper, "GROUP", group)
    acknowledged: list[tuple[int, str]] = []  # length of the log by then, shot
    keep = SessionWriter.keep

    def keep_and_note(self: SessionWriter, items: Sequence[Item]) -> None:
        keep(self, items)
        now = log.stat().st_size
        acknowledged.extend((now, item.shot) for item in items if item.event == "commit")

    with toy.rig_of() as rig, monkeypatch.context() as patch:
        patch.setattr(SessionWriter, "keep", keep_and_note)
        finish, session = toy.run(toy.prepare(toy.plan_of(), rig, folder / "data"))
    assert finish.status.state is State.COMPLETED
    unbroken = toy.pixels(session)
    sealed_at = log.stat().st_size
    happened = [r for r in block_log.records(log) if r.end <= sealed_at]
    ends = [r.end for n, r in enumerate(happened) if r.content is None or n % 3 == 0]
    # measured 340 flushes and writes for 12 frames one by one, 130 in groups
    assert len(ends) > 30
    rng = random.Random(group)  # noqa: S311 - a disk's cache keeps no secrets
    cuts = [*sorted(rng.sample(ends, min(CUTS // 2, len(ends)) - 1)), sealed_at]
    disk = tmp_path / "cut"
    survived = []
    for cut in cuts:
        block_log.replay(base, log, cut, disk, rng)
        promised = [shot for at, shot in acknowledged if at <= cut]
        with mounted(disk, tmp_path / "after", "loop,noatime") as after:
            survived.append(check_after(after / "data", promised, unbroken))
    assert len(set(survived)) > 2
    assert survived[-1] == len(unbroken)


def check_after(root: Path, promised: list[str], unbroken: dict[str, np.ndarray]) -> int:
    """Hold a disk after a cut to what was acknowledged; return how many frames that were."""
    found = [p.parent for p in root.glob("*/*/session.json")]
    if not found:
        assert promised == []
        return 0
    (path,) = found
    whole = Session.open(path)
    for shot in promised:
        np.testing.assert_array_equal(whole.read(shot), unbroken[shot])
    if not (whole.sealed and not whole.missing):
        finish, _ = toy.resume(path)
        assert finish.status.state is State.COMPLETED, finish.status.reason
    assert verify(path) == []
    for shot, expected in unbroken.items():
        np.testing.assert_array_equal(Session.open(path).read(shot), expected)
    return len(promised)


def test_r13_session_on_a_read_only_mount(session_copy: Path, command, tmp_path: Path) -> None:
    data = tmp_path / "copy"
    with mounted(data, tmp_path / "medium", "bind") as medium:
        call("mount", "-o", "remount,bind,ro", medium)
        with pytest.raises(OSError, match="Read-only"):
            (medium / "proof").touch()
        path = medium / session_copy.name
        said = command("verify", path)
        assert (said.code, said.err) == (0, "")
        assert len(Session.open(path).frames) == 20
        said = command("analyse", path)
        assert said.code == 4
        assert "--out" in said.err
        said = command("analyse", path, "--out", tmp_path / "results")
        assert said.code == 0, said.err
        (result,) = (tmp_path / "results").iterdir()
        assert command("report", result, "--out", tmp_path / "page").code == 0
        said = command("resume", path)
        assert said.code == 3
        assert "nothing to resume" in said.err


def test_r13_catalogue_of_a_read_only_root_is_made_in_memory(tmp_path: Path) -> None:
    toy.capture(tmp_path / "data")
    before = catalogue(tmp_path / "data")
    with mounted(tmp_path / "data", tmp_path / "medium", "bind") as medium:
        call("mount", "-o", "remount,bind,ro", medium)
        assert catalogue(medium) == before
        (medium.parent / "data" / "catalogue.sqlite").unlink()
        assert catalogue(medium) == before
