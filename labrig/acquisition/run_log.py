"""What a run hears, tells and keeps: commands, status and events, and the way to the writer."""

from __future__ import annotations

import queue
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

from drivers.waiting import SLICE_S, CancelToken
from labrig.acquisition.agenda import Agenda
from labrig.acquisition.run_state import ENDS, NEXT, TAKES, Command, Event, State, Status
from labrig.acquisition.sequence import AttemptError
from labrig.errors import LabrigError
from labrig.session.items import Item
from labrig.session.keeper import Keeper

T = TypeVar("T")


class RunLog(ABC):
    """The part of a run that speaks to whoever follows it, and to the keeper of its frames."""

    def __init__(self, agenda: Agenda) -> None:
        self.status = Status(total=len(agenda.shots))
        self.problems: deque[str] = deque(maxlen=100)
        self._subscribers: list[Callable[[Event], None]] = []
        self._keeper: Keeper | None = None
        self._agenda = agenda
        self._owed: list[Item] = []
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._cancel = CancelToken()

    @abstractmethod
    def eta_s(self) -> float:
        """Return how long the shots that are left will take, s."""

    def post(self, command: Command) -> None:
        """Ask something of the run; may be called from any thread and in any state."""
        if command is Command.ABORT and self.status.state in TAKES[Command.ABORT]:
            # abort outranks all that is queued, and reaches into every wait
            self._cancel.cancel("aborted by the operator")
        self._commands.put(command)

    def _heard(self) -> Iterator[Command]:
        """Give commands as they come, until cancelled."""
        while True:
            self._cancel.check()
            with suppress(queue.Empty):
                yield self._commands.get(timeout=SLICE_S)

    def subscribe(self, callback: Callable[[Event], None]) -> None:
        """Let a callback hear every event, in the thread of the run."""
        self._subscribers.append(callback)

    def _keep(self, item: Item) -> None:
        need(self._keeper).put(item, CancelToken())

    def _journal_failure(self, shot: str, attempt: int, error: AttemptError) -> None:
        about = {**error.details, "cause": error.cause}
        if error.frame is not None:
            about["reason"] = str(error)
            self._keep(
                Item(
                    event="reject",
                    shot=shot,
                    attempt=attempt,
                    pixels=error.frame.pixels,
                    details=about,
                )
            )
        else:
            about |= {"shot": shot, "attempt": attempt, "why": str(error)}
            self._keep(Item(event="drop", details=about))
        self._problem(str(error))

    def _hear_saved(self) -> None:
        if self._keeper is None:
            return
        for item in self._keeper.collect_saved():
            if item.event == "commit":
                self._set(saved=self.status.saved + 1, eta_s=self.eta_s())
                self._emit("saved", item.shot)

    def _hear_failure(self) -> str:
        """Return why the disk failed, after letting its frames be taken again; else nothing."""
        keeper = need(self._keeper)
        failure = keeper.collect_failure()
        if failure is None:
            return ""
        if isinstance(failure.error, LabrigError) or not isinstance(failure.error, OSError):
            raise failure.error
        why = f"the disk failed: {failure.error.strerror or failure.error}"
        self._agenda.lose(item.shot for item in failure.unsaved)
        for item in failure.unsaved:
            if item.pixels is not None:
                about = {"shot": item.shot, "attempt": item.attempt, "why": why, "cause": "disk"}
                self._owed.append(Item(event="drop", details=about))
            elif item.event != "pause":
                self._owed.append(item)
        return f"{why}; make room or mend it, then resume."

    def _pay(self) -> None:
        """Journal the resume, and what a full disk did not take before."""
        owed, self._owed = self._owed, []
        for item in (Item(event="resume"), *owed):
            self._keep(item)

    def _refuse_command(self, command: Command) -> None:
        if command is not Command.ABORT:
            self._emit("note", f"{command} does nothing while {self.status.state}")

    def _problem(self, text: str) -> None:
        self.problems.append(text)
        self._set(problem=text)
        self._emit("problem", text)

    def _note(self, text: str, details: dict[str, Any]) -> None:
        if self._keeper is not None:
            self._keep(Item(event="note", details={"text": text, **details}))
        self._emit("note", text)

    def _go(self, state: State, reason: str = "") -> None:
        if state not in NEXT.get(self.status.state, frozenset()):
            msg = f"a run cannot go from {self.status.state} to {state}"
            raise AssertionError(msg)
        step = None if state in ENDS else self.status.step
        self._set(state=state, reason=reason, step=step)
        self._emit("state", state)

    def _set(self, **changes: Any) -> None:
        self.status = replace(self.status, **changes)

    def _emit(self, kind: Any, text: str) -> None:
        event = Event(kind=kind, status=self.status, text=str(text))
        for callback in tuple(self._subscribers):
            try:
                callback(event)
            except Exception as error:
                self._subscribers.remove(callback)
                self.problems.append(f"a listener failed and hears no more: {error!r}")


def need(found: T | None) -> T:
    """Return what an armed run has; before that it is a mistake of the program to ask."""
    if found is None:
        msg = "the run is not armed"
        raise AssertionError(msg)
    return found
