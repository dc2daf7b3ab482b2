"""States of a run, what may follow what, the commands it takes and the events it tells."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from labrig.acquisition.sequence import Step


class State(StrEnum):
    """Where a run is."""

    IDLE = "idle"
    PREFLIGHT = "preflight"
    ARMING = "arming"
    RUNNING = "running"
    PAUSED = "paused"
    RECOVERING = "recovering"
    FINISHING = "finishing"
    COMPLETED = "completed"
    ABORTED = "aborted"
    FAILED = "failed"
    REFUSED = "refused"


class Command(StrEnum):
    """What an operator may ask of a run."""

    START = "start"
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    ABORT_AFTER_GROUP = "abort-after-group"
    RETRY = "retry"
    SKIP_GROUP = "skip-group"


_S = State
NEXT: dict[State, frozenset[State]] = {
    _S.IDLE: frozenset({_S.PREFLIGHT, _S.FINISHING}),
    _S.PREFLIGHT: frozenset({_S.ARMING, _S.REFUSED, _S.FINISHING}),
    _S.ARMING: frozenset({_S.RUNNING, _S.FINISHING}),
    _S.RUNNING: frozenset({_S.PAUSED, _S.RECOVERING, _S.FINISHING}),
    _S.PAUSED: frozenset({_S.RUNNING, _S.RECOVERING, _S.FINISHING}),
    _S.RECOVERING: frozenset({_S.RUNNING, _S.PAUSED, _S.FINISHING}),
    _S.FINISHING: frozenset({_S.COMPLETED, _S.ABORTED, _S.FAILED}),
}
ENDS = frozenset({_S.COMPLETED, _S.ABORTED, _S.FAILED, _S.REFUSED})
_LIVE = frozenset({_S.ARMING, _S.RUNNING, _S.PAUSED, _S.RECOVERING})
TAKES: dict[Command, frozenset[State]] = {
    Command.START: frozenset({_S.IDLE}),
    Command.PAUSE: frozenset({_S.ARMING, _S.RUNNING, _S.RECOVERING}),
    Command.RESUME: frozenset({_S.PAUSED}),
    Command.RETRY: frozenset({_S.PAUSED}),
    Command.ABORT: _LIVE | {_S.IDLE, _S.PREFLIGHT},
    Command.ABORT_AFTER_GROUP: _LIVE,
    Command.SKIP_GROUP: frozenset({_S.RUNNING, _S.PAUSED, _S.RECOVERING}),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """All there is to know about a run at an instant.

    ``problem`` is the last one; ``reason`` says why a run ended or stands still.
    """

    state: State = State.IDLE
    step: Step | None = None
    shot: str = ""
    attempt: int = 0
    saved: int = 0
    total: int = 0
    failures: int = 0
    eta_s: float = 0.0
    problem: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened, with the status after it."""

    kind: Literal["state", "step", "saved", "problem", "note"]
    status: Status
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finish:
    """How a run ended; ``error`` is what made it fail or refuse."""

    status: Status
    error: BaseException | None
