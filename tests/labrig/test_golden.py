"""Sessions written by earlier versions of the program, committed as they were, stay readable."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from samples import journal_lines

from labrig.errors import SessionError
from labrig.session import Session, verify
from labrig.session.recovery import reopen

GOLDEN = Path(__file__).parent / "golden"
SHOTS = [f"stripes-e0-r0-p{shift:02d}" for shift in range(3)]


def picture(seed: int) -> np.ndarray:
    """The picture as it was committed then; nothing random, for generators may change."""
    return (np.arange(192, dtype=np.uint16).reshape(12, 16) * 37 + 1000 * seed).astype(np.uint16)


@pytest.mark.parametrize("version", [1, 2])
def test_session_of_an_earlier_version_is_read_and_verified(version: int) -> None:
    path = GOLDEN / f"session-{version}"
    assert verify(path) == []
    session = Session.open(path)
    assert session.header["schema"] == f"labrig-session/{version}"
    assert session.header["operator"] == "Zoë"
    assert session.sealed
    assert session.missing == ()
    for seed, shot in enumerate(SHOTS):
        np.testing.assert_array_equal(session.read(shot), picture(seed))
    events = [e["event"] for e in session.events]
    begun = ["open", "reject", "drop", "commit", "pause", "resume", "segment", "commit"]
    assert events == [*begun, *(["commit", "void"] if version == 2 else []), "commit", "close"]
    assert [session.frames[shot].details["segment"] for shot in SHOTS] == [1, 2, 2]
    assert session.frames[SHOTS[0]].details["note"] == "Küvette 中"
    assert session.frames[SHOTS[2]].attempt == version


@pytest.mark.parametrize("version", [1, 2])
def test_session_of_an_earlier_version_is_taken_up_again(version: int, tmp_path: Path) -> None:
    path = shutil.copytree(GOLDEN / f"session-{version}", tmp_path / "s")
    with pytest.raises(SessionError, match="nothing to resume"):
        reopen(path)
    # as after a crash: no seal, no close line, the last frame not yet committed
    (path / "SEAL.json").unlink()
    (path / "journal.jsonl").write_bytes(b"".join(journal_lines(path)[:-2]))
    writer, recovery = reopen(path)
    assert recovery.saved == 2
    assert recovery.quarantined == (f"quarantine/{SHOTS[2]}.tif",)
    writer.commit(SHOTS[2], 3, picture(2), {})
    writer.close()
    assert verify(path) == []
    assert json.loads((path / "session.json").read_bytes())["schema"].endswith(f"/{version}")
    np.testing.assert_array_equal(Session.open(path).read(SHOTS[2]), picture(2))
