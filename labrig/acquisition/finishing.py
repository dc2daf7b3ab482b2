"""How a run ends: dark, safe and whole, each step guarded so that none hides another."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from labrig.errors import LabrigError
from labrig.rig import OpenRig
from labrig.session.keeper import Keeper
from labrig.session.writer import SessionWriter


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ignore Ctrl-C meanwhile, where this thread would be the one to hear it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def finish_devices(rig: OpenRig) -> list[str]:
    """Make every device safe, light first; return what did not work."""
    steps: tuple[tuple[str, Callable[[], None]], ...] = (
        ("projector", rig.projector.make_safe),
        ("trigger", rig.trigger.make_safe),
        ("camera", rig.camera.make_safe),
    )
    problems = []
    for name, make_safe in steps:
        try:
            make_safe()
        except Exception as error:
            problems.append(f"the {name} could not be made safe: {error}")
    return problems


def finish_session(
    keeper: Keeper | None,
    writer: SessionWriter | None,
    outcome: str,
    reason: str,
    patience_s: float,
) -> list[str]:
    """Write what is queued, seal what is complete or was aborted, let go of the lock.

    A run that failed stays without a seal. Return what did not work.
    """
    problems = []
    if keeper is not None:
        keeper.drain(patience_s)
        failure = keeper.collect_failure()
        if failure is not None:
            problems.append(f"{len(failure.unsaved)} entries could not be kept: {failure.error}")
        if not keeper.stop(patience_s):
            # its thread still holds the journal: to close it here would tear a line
            problems.append(f"the disk did not answer for {patience_s:.0f} s; the lock is kept")
            return problems
    if writer is None:
        return problems
    try:
        if outcome == "failed" or (outcome == "completed" and problems):
            writer.leave("failed", reason or problems[0])
        else:
            writer.close(outcome)
    except (OSError, LabrigError) as error:
        problems.append(f"the session could not be sealed: {error}")
    return problems
