"""Every transition and every command in every state; no way to a stuck or an unsafe rig."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import toy

from drivers.errors import DeadlineError
from labrig.acquisition.run_state import ENDS, NEXT, TAKES, Command, Event, State
from labrig.acquisition.sequence import Step
from labrig.session import Session, verify
from labrig.session.lock import holder

SHOT = "stripes-e0-r0-p02"
WAITS = 60.0  # s of real time, after which a run counts as stuck


def dark_and_let_go(rig, runner) -> None:
    """The rig shows black or nothing, the camera takes no frames, the session has no writer."""
    assert rig.projector.current() is None
    assert rig.camera._mode is None
    assert runner._writer is None or holder(runner.path) is None


def run_in_thread(runner, **how):
    """Run in a thread, which must end."""
    ended = []
    thread = threading.Thread(target=lambda: ended.append(toy.run(runner, **how)), daemon=True)
    thread.start()
    thread.join(WAITS)
    assert ended, f"stuck in {runner.status}"
    return ended[0]


def post_when(runner, condition, *commands: Command) -> None:
    """Post commands once, when an event first fulfils a condition."""
    done: list[bool] = []

    def hear(event: Event) -> None:
        if not done and condition(event):
            done.append(True)
            for command in commands:
                runner.post(command)

    runner.subscribe(hear)


def reaches(state: State):
    return lambda event: event.kind == "state" and event.status.state is state


FAULT_FOR = {
    State.PAUSED: {"kind": "drop", "shot": SHOT, "times": 3},
    State.RECOVERING: {"kind": "camera-lost", "shot": SHOT},
}


@pytest.mark.parametrize("command", Command)
@pytest.mark.parametrize("state", [s for s in State if s not in ENDS and s is not State.IDLE])
def test_every_command_in_every_state_leads_to_a_safe_end(state, command, tmp_path: Path) -> None:
    faults = [FAULT_FOR[state]] if state in FAULT_FOR else []
    events: list[Event] = []
    with toy.rig_of(*faults) as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        post_when(runner, reaches(state), command)
        finish, session = run_in_thread(runner, events=events)
        dark_and_let_go(rig, runner)
    path = [e.status.state for e in events if e.kind == "state"]
    assert state in path
    for before, after in zip([State.IDLE, *path], path, strict=False):
        assert after in NEXT[before]
    if command is Command.ABORT and state is not State.FINISHING:
        assert finish.status.state is State.ABORTED
    elif state is State.PAUSED and command not in (Command.RESUME, Command.RETRY):
        assert finish.status.state in (State.ABORTED, State.COMPLETED)
    if session is not None and finish.status.state is State.COMPLETED:
        skipped = {f"stripes-e0-r0-p{p:02d}" for p in range(4)}
        missing = set(session.missing)
        assert missing == set() or (command is Command.SKIP_GROUP and missing <= skipped | missing)
        assert all(p.what.startswith("is planned") for p in verify(session.path))


def test_every_transition_is_seen(tmp_path: Path) -> None:
    """The table holds no transition that a run cannot make, but those of an abort in a state."""
    assert set(NEXT) | ENDS == set(State)
    assert all(State.FINISHING in NEXT[s] for s in NEXT if s is not State.FINISHING)
    assert set(TAKES) == set(Command)


def test_abort_after_group_ends_at_the_groups_end(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        post_when(runner, lambda e: e.status.shot == SHOT, Command.ABORT_AFTER_GROUP)
        finish, session = run_in_thread(runner)
    assert finish.status.state is State.ABORTED
    assert set(session.frames) == {f"stripes-e0-r0-p{p:02d}" for p in range(4)}


def test_skipped_group_is_missing_and_the_rest_is_there(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        post_when(runner, lambda e: e.status.shot == SHOT, Command.SKIP_GROUP)
        finish, session = run_in_thread(runner)
    assert finish.status.state is State.COMPLETED
    assert "stripes-e0-r0-p03" in session.missing
    assert "stripes-e1-r0-p03" in session.frames


def test_lamp_that_changed_during_a_pause_begins_a_segment(tmp_path: Path) -> None:
    lamp = {"lamp": {"drift_per_h": -0.5}}
    with toy.rig_of(simulation=lamp) as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        post_when(runner, lambda e: e.status.shot == "white-e0-r0", Command.PAUSE)
        runner.subscribe(lambda e: reaches(State.PAUSED)(e) and rig.clock.sleep(600.0))
        finish, session = toy.run(runner, Command.RESUME)
    assert finish.status.state is State.COMPLETED
    (segment,) = [e for e in session.events if e["event"] == "segment"]
    assert "since the last one" in segment["reason"]
    groups: dict[str, set[int]] = {}
    for shot in session.shots:
        line = session.frames[shot["id"]].details
        groups.setdefault(shot["group"], set()).add(line["segment"])
    assert all(len(segments) == 1 for segments in groups.values())


@pytest.mark.parametrize("step", [Step.SETTLE, Step.COLLECT])
def test_abort_reaches_into_waits_of_a_real_clock(step, tmp_path: Path) -> None:
    slow = {"exposures": {"bracket_s": [5.0]}, "timing": {"settle_s": 5.0}}
    with toy.rig_of(simulation={"clock": "real"}) as rig:
        runner = toy.prepare(toy.plan_of(**slow), rig, tmp_path)
        runner.references.measure = lambda *_: type(
            "M", (), {"text": "", "levels": {}, "changed": False}
        )
        thread = threading.Thread(target=lambda: toy.run(runner), daemon=True)
        thread.start()
        begun = time.monotonic()
        wanted = Step.SETTLE if step is Step.SETTLE else Step.COLLECT
        while runner.status.step is not wanted and time.monotonic() - begun < WAITS:
            time.sleep(0.01)
        asked = time.monotonic()
        runner.post(Command.ABORT)
        thread.join(WAITS)
        took_s = time.monotonic() - asked
        assert runner.status.state is State.ABORTED
        dark_and_let_go(rig, runner)
    # measured 0.01 and 0.03 s, of the 5 s that the step would have taken
    assert took_s < 4.0


def test_abort_waits_no_longer_than_a_deaf_drivers_deadline(tmp_path: Path) -> None:
    """A driver that hears no cancel still ends at its deadline; the run ends with it."""
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        show, deaf = rig.projector.show, []

        def show_late(handle, *, deadline_s, cancel):
            if runner.status.shot == SHOT:
                deaf.append(deadline_s - rig.now_s())
                runner.post(Command.ABORT)
                time.sleep(deaf[0])
                msg = "the projector did not answer before its deadline"
                raise DeadlineError(msg)
            return show(handle, deadline_s=deadline_s, cancel=cancel)

        rig.projector.show = show_late
        finish, session = run_in_thread(runner)
        dark_and_let_go(rig, runner)
    assert finish.status.state in (State.ABORTED, State.FAILED)
    assert deaf == [1.0], "it was asked again"
    assert len(session.frames) == 2


@pytest.fixture
def interrupts() -> Iterator[None]:
    """Let Ctrl-C interrupt, whatever another test of this process has made of it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before or signal.default_int_handler)


@pytest.mark.usefixtures("interrupts")
def test_ctrl_c_twice_does_no_harm(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)

        def hear(event: Event) -> None:
            if event.status.shot == SHOT and event.status.state is State.RUNNING:
                raise_once()
            if event.kind == "state" and event.status.state is State.FINISHING:
                signal.raise_signal(signal.SIGINT)

        raised: list[bool] = []

        def raise_once() -> None:
            if not raised:
                raised.append(True)
                signal.raise_signal(signal.SIGINT)

        runner.subscribe(hear)
        runner.post(Command.START)
        finish = runner.run()
        dark_and_let_go(rig, runner)
    assert finish.status.state is State.ABORTED
    assert isinstance(finish.error, KeyboardInterrupt)
    assert Session.open(runner.path).sealed


def test_listener_that_fails_does_not_stop_the_run(tmp_path: Path) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)
        runner.subscribe(lambda _: 1 / 0)
        finish, _ = toy.run(runner)
    assert finish.status.state is State.COMPLETED
    assert any("ZeroDivisionError" in text for text in runner.problems)


def test_device_that_cannot_be_made_safe_is_told_and_hides_nothing(tmp_path, monkeypatch) -> None:
    with toy.rig_of() as rig:
        runner = toy.prepare(toy.plan_of(), rig, tmp_path)

        def fail() -> None:
            msg = "the wire is cut"
            raise OSError(msg)

        monkeypatch.setattr(rig.projector, "make_safe", fail)
        finish, session = toy.run(runner)
        assert rig.camera._mode is None
    assert finish.status.state is State.COMPLETED
    assert any("the wire is cut" in text for text in runner.problems)
    assert session.sealed
