"""A Hypothesis state machine steers runs at every event; none gets stuck or leaves a rig unsafe."""

from __future__ import annotations

import shutil
import tempfile
import threading
from pathlib import Path

import pytest
import toy
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from drivers.simulation.faults import Fault, FaultKind
from labrig.acquisition.run_state import ENDS, NEXT, Command, Event, State
from labrig.session import Session, verify
from labrig.session.lock import holder

KINDS = sorted(set(FaultKind.__args__) - {"kill"})
STANDING = (State.IDLE, State.PAUSED)  # where a run waits for a command, and tells of nothing
WAITS_S = 60.0  # of real time, after which a run counts as stuck


class AnyRun(RuleBasedStateMachine):
    """A run that stands still after each event, until the machine lets it go on."""

    @initialize(
        trigger=st.sampled_from(["software", "simulated", "free-run"]),
        gone=st.one_of(st.none(), st.integers(1, 150)),
    )
    def begin(self, trigger: str, gone: int | None) -> None:
        self.out = Path(tempfile.mkdtemp(prefix="labrig-any-"))
        self.rig = toy.rig_of(trigger={"driver": trigger})
        self.runner = toy.prepare(toy.plan_of(), self.rig, self.out)
        self.events: list[Event] = []
        self.gated = True
        self.told = False
        self.stands = threading.Event()
        self.may_go = threading.Semaphore(0)
        self.finish: list = []
        self.runner.subscribe(self._hear)
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()
        if gone is not None:
            self.is_started()
            self.goes_on(gone)

    def _work(self) -> None:
        self.finish.append(self.runner.run())
        self.stands.set()

    def _hear(self, event: Event) -> None:
        self.events.append(event)
        self.stands.set()
        if self.gated:
            assert self.may_go.acquire(timeout=2 * WAITS_S)

    @rule(n=st.integers(1, 120))
    def goes_on(self, n: int) -> None:
        for _ in range(n):
            waiting = not self.stands.is_set() and self.runner.status.state in STANDING
            if waiting or self.finish:
                return
            assert self.stands.wait(WAITS_S), f"stuck in {self.runner.status}"
            self.stands.clear()
            self.may_go.release()
            if self.runner.status.state not in STANDING:
                assert self.stands.wait(WAITS_S), f"stuck in {self.runner.status}"

    @rule(command=st.sampled_from(list(Command)))
    def is_told(self, command: Command) -> None:
        self.told = True
        self.runner.post(command)

    # Of what was posted, not of the run's state: that changes when its thread gets to it.
    @precondition(lambda self: not self.told)
    @rule()
    def is_started(self) -> None:
        self.is_told(Command.START)
        assert self.stands.wait(WAITS_S)

    @rule(kind=st.sampled_from(KINDS), times=st.integers(1, 4))
    def is_spoilt(self, kind: FaultKind, times: int) -> None:
        script = self.rig._world.faults
        fault = Fault(kind=kind, times=times, seconds=0.2 if kind == "projector-late" else 5.0)
        script._left.append(times)
        script._faults += (fault,)

    @rule(seconds=st.sampled_from([0.05, 31.0, 600.0]))
    def waits(self, seconds: float) -> None:
        self.rig.clock.sleep(seconds)

    @invariant()
    def is_lawful(self) -> None:
        path = [e.status.state for e in getattr(self, "events", ()) if e.kind == "state"]
        for before, after in zip([State.IDLE, *path], path, strict=False):
            assert after in NEXT[before]

    def teardown(self) -> None:
        if not hasattr(self, "runner"):
            return
        self.gated = False
        self.may_go.release(2)
        self.runner.post(Command.ABORT)
        self.thread.join(WAITS_S)
        assert not self.thread.is_alive(), f"stuck in {self.runner.status}"
        (finish,) = self.finish
        assert finish.status.state in ENDS
        assert self.rig.projector.current() is None
        assert self.rig.camera._mode is None
        self.rig.close()
        if self.runner._writer is not None:
            self._is_explained(Session.open(self.runner.path))
        shutil.rmtree(self.out)

    def _is_explained(self, session: Session) -> None:
        assert holder(session.path) is None
        told = [p for p in verify(session.path) if not p.what.startswith(("is planned", "not se"))]
        assert told == []
        # a frame is counted once, and each attempt without one is explained
        lines = [e for e in session.events if e["event"] in ("commit", "reject")]
        assert len(lines) == len({(e["event"], e["shot"], e["attempt"]) for e in lines})
        assert all(e.get("cause") for e in session.events if e["event"] in ("reject", "drop"))
        for frame in session.frames.values():
            assert frame.details["exposure_asked_s"] == pytest.approx(
                frame.details["exposure_reported_s"], rel=1e-3
            )


AnyRun.TestCase.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
)
TestAnyRun = AnyRun.TestCase
