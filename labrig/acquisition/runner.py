"""Runs a plan on an open rig: a state machine over all shots, in which nothing is lost.

Commands may be posted and the status read from any thread; devices and callbacks are used by the
thread that calls `Runner.run` alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CancelledError, DriverError
from labrig.acquisition.agenda import Agenda, Block
from labrig.acquisition.finishing import finish_devices, finish_session, undisturbed
from labrig.acquisition.latency import check_latency
from labrig.acquisition.looks import poor
from labrig.acquisition.preflight import Verdict, refuse
from labrig.acquisition.references import References
from labrig.acquisition.remedies import Remedy, remedy_for
from labrig.acquisition.run_log import RunLog, need
from labrig.acquisition.run_state import TAKES, Command, Finish, State, Status
from labrig.acquisition.sequence import AttemptError, Cause, Sequencer, Step, Taken
from labrig.errors import RunError
from labrig.models.plan import Shot
from labrig.plan import CapturePlan
from labrig.rig import OpenRig
from labrig.session.items import Item
from labrig.session.keeper import Keeper
from labrig.session.writer import SessionWriter

PATIENCE_S = 10.0  # the longest that finishing may wait for the disk
_NOT_COUNTED = frozenset({Cause.NOT_FIRED, Cause.DEVICE_LOST})  # no frame was lost


class _AbortedError(Exception):
    """Raised inside a run that shall end; the text says why."""


class _GroupEndedError(Exception):
    """Raised where a group is skipped or must be taken again from its start."""


class Runner(RunLog):
    """One run of a plan. Make it, subscribe, and call `run`."""

    def __init__(
        self,
        expanded: CapturePlan,
        rig: OpenRig,
        open_session: Callable[[], SessionWriter],
        *,
        verdicts: Callable[[], list[Verdict]] = list,
        references: References | None = None,
    ) -> None:
        super().__init__(Agenda(expanded.shots))
        self._plan = expanded.plan
        self._expanded = expanded
        self._rig = rig
        self._open_session = open_session
        self._verdicts = verdicts
        self._after_group = False
        self._pause_asked = False
        self.latest: tuple[Shot, NDArray[np.uint16]] | None = None
        self.references = references or References(self._plan, rig)
        self._writer: SessionWriter | None = None
        self._sequencer: Sequencer | None = None
        self._attempts: Counter[str] = Counter()
        self._losses = 0

    @property
    def path(self) -> Path:
        """The session's folder; it exists once the run is armed."""
        return need(self._writer).path

    @property
    def armed(self) -> bool:
        """Whether there is a session's folder."""
        return self._writer is not None

    def run(self) -> Finish:
        """Run to the end, whatever happens; the rig is then dark and the session let go."""
        error: BaseException | None = None
        end, reason = State.COMPLETED, ""
        try:
            self._idle()
            self._preflight()
            self._arm()
            self._take_all()
        except (_AbortedError, CancelledError) as stop:
            end, reason = State.ABORTED, str(stop)
        except KeyboardInterrupt as stop:
            end, reason, error = State.ABORTED, "interrupted", stop
        except Exception as failure:
            end, error = State.FAILED, failure
            reason = str(failure) or type(failure).__name__
        if self.status.state is State.PREFLIGHT and end is State.FAILED:
            self._go(State.REFUSED, reason)
            return Finish(status=self.status, error=error)
        with undisturbed():
            return Finish(status=self._finish(end, reason), error=error)

    # Each of these is one state.

    def _idle(self) -> None:
        for command in self._heard():
            if command is Command.START:
                return
            self._refuse_command(command)

    def _preflight(self) -> None:
        self._go(State.PREFLIGHT)
        verdicts = self._verdicts()
        for verdict in verdicts:
            if not verdict.ok:
                self._problem(verdict.text)
        refuse(verdicts)
        self._cancel.check()

    def _arm(self) -> None:
        self._go(State.ARMING)
        checked = check_latency(self._rig, self._cancel)
        self._writer = self._open_session()
        self._agenda.taken.update(self._writer.progress.saved)
        self._attempts.update(self._writer.progress.last_attempt)
        self._keeper = Keeper(self._writer)
        if checked:
            self._note(checked, {})
        self._sequencer = self.references.sequencer(self._expanded, self._step)
        self._set(saved=len(self._agenda.taken), eta_s=self.eta_s())
        for text, details in self.references.warm_up(self._sequencer, self._cancel):
            self._note(text, details)
        self._go(State.RUNNING)

    def _take_all(self) -> None:
        with suppress(_GroupEndedError):
            self._refer()
        while True:
            block = self._agenda.next_block()
            try:
                if block is not None:
                    self._take_block(block)
                    self._boundary(block)
                else:
                    need(self._keeper).drain(PATIENCE_S)
                    self._boundary(self._agenda.blocks[-1])
                    if self._agenda.next_block() is None:
                        self._refer(last=True)
                        return
            except _GroupEndedError:
                continue
            if self._after_group:
                msg = "aborted by the operator after the group"
                raise _AbortedError(msg)

    def _take_block(self, block: Block) -> None:
        for shot in block:
            while self._agenda.wants(shot):
                self._boundary(block)
                self._repeat_if_torn(block)
                self._take(shot, block)

    def _take(self, shot: Shot, block: Block) -> None:
        """Try at a shot until it is taken, given up or the operator decides."""
        counts: Counter[Cause] = Counter()
        again = True
        while True:
            self._attempts[shot.id] += 1
            self._set(shot=shot.id, attempt=self._attempts[shot.id])
            try:
                taken = need(self._sequencer).attempt(shot, self._cancel, again=again)
                break
            except AttemptError as error:
                counts[error.cause] += 1
                self._journal_failure(shot.id, self._attempts[shot.id], error)
                again = self._mend(shot, block, error, counts)
                self._boundary(block)
        self._step(shot.id, Step.COMMIT)
        self.latest = (shot, taken.frame.pixels)
        self._commit(shot, taken)
        self._agenda.take(shot, block, self._rig.now_s())
        self._hear_saved()
        self._hold_together(shot, block)

    def _hold_together(self, shot: Shot, block: Block) -> None:
        """Take a group again whose shifts contradict one another; ask where that does not help."""
        doubt = need(self._sequencer).looks.group_doubt(shot)
        if doubt is None:
            return
        if self._agenda.doubted(block):
            self._pause(f"{doubt} It is so for the second time.", block)
            return
        self._problem(doubt)
        self._begin_again(block, doubt)

    def _begin_again(self, block: Block, why: str, other: str = "") -> NoReturn:
        """Take a block again, and that of another shot, with new references.

        Pictures contradict one another, and it is not known which of them is wrong.
        """
        for doubted in self._agenda.doubt(block, other):
            self._void(doubted, why)
        need(self._sequencer).looks.begin_again()
        self._refer()
        raise _GroupEndedError

    def _mend(self, shot: Shot, block: Block, error: AttemptError, counts: Counter[Cause]) -> bool:
        """Do what the cause asks for; return whether the pattern is still up for the next try."""
        cause = error.cause
        self._set(failures=self.status.failures + (cause not in _NOT_COUNTED))
        n_shots, limits = self.status.total, self._plan.limits
        remedy, why = remedy_for(cause, counts, self.status.failures, n_shots, limits)
        if remedy is Remedy.REPEAT_GROUP:
            self._losses += 1
            if self._losses > 1:
                self._pause(f"{error} It is the second loss of this run.", block)
            self._recover(block, str(error))
            self._void(block, "the device was lost in the middle of the group")
            raise _GroupEndedError
        if remedy is Remedy.COMPARE_ANEW and not self._agenda.doubted(block):
            other = need(self._sequencer).looks.compared_with(shot)
            self._begin_again(block, str(error), other)
        if remedy in (Remedy.PAUSE, Remedy.COMPARE_ANEW):
            self._pause(f"{error} {why}", block)
            counts.clear()
            self._set(failures=0)
            return False
        if remedy is Remedy.REARM:
            self._recover(block, str(error))
        if remedy is Remedy.SET_AGAIN:
            need(self._sequencer).forget_exposure()
        return remedy in (Remedy.AGAIN, Remedy.SET_AGAIN)

    def _recover(self, block: Block, why: str) -> None:
        """Close and open the devices again; pause where they do not come back."""
        self._go(State.RECOVERING, why)
        while True:
            try:
                self._cancel.check()
                self.references.rearm(need(self._sequencer))
                break
            except (DriverError, RunError) as error:
                if isinstance(error, CancelledError):
                    raise
                self._problem(str(error))
                self._pause(f"the devices did not come back: {error}", block)
                self._go(State.RECOVERING)
        self._go(State.RUNNING)

    def _pause(self, reason: str, block: Block) -> None:
        """Stand still, dark, until the operator decides; then begin with new references."""
        self._problem(reason)
        if self._plan.limits.on_failure == "abort" and reason != "asked by the operator":
            raise RunError(reason)
        self._pause_asked = False
        self._go(State.PAUSED, reason)
        self._rig.projector.make_safe()
        self._keep(Item(event="pause", details={"reason": reason}))
        need(self._keeper).drain(PATIENCE_S)
        self._hear_failure()
        self._decide(block)
        self._go(State.RUNNING)
        need(self._sequencer).forget()
        self._pay()
        self._refer()

    def _decide(self, block: Block) -> None:
        for command in self._heard():
            if command in (Command.RESUME, Command.RETRY):
                return
            if command in (Command.ABORT, Command.ABORT_AFTER_GROUP):
                msg = "aborted by the operator"
                raise _AbortedError(msg)
            if command is Command.SKIP_GROUP:
                self._skip(block)
                self._go(State.RUNNING)
                self._pay()
                raise _GroupEndedError
            self._refuse_command(command)

    def _finish(self, end: State, reason: str) -> Status:
        """Leave the rig dark and the session whole; no step hides another or the first error."""
        self._go(State.FINISHING, reason)
        for problem in finish_devices(self._rig):
            self._problem(problem)
        for problem in finish_session(self._keeper, self._writer, str(end), reason, PATIENCE_S):
            self._problem(problem)
            end = State.FAILED if end is State.COMPLETED else end
            reason = reason or problem
        self._hear_saved()
        self._go(end, reason)
        return self.status

    # What happens between two attempts.

    def _boundary(self, block: Block) -> None:
        """Hear the disk and the operator."""
        self._cancel.check()
        self._hear_saved()
        failure = self._hear_failure()
        if failure:
            self._pause(failure, block)
            raise _GroupEndedError
        while not self._commands.empty():
            command = self._commands.get()
            if self.status.state not in TAKES[command]:
                self._refuse_command(command)
            elif command is Command.PAUSE:
                self._pause_asked = True
            elif command is Command.ABORT_AFTER_GROUP:
                self._after_group = True
            elif command is Command.SKIP_GROUP:
                self._skip(block)
                raise _GroupEndedError
        if self._pause_asked:
            self._pause("asked by the operator", block)

    def _repeat_if_torn(self, block: Block) -> None:
        """Take a group again from its start if it stood still for too long."""
        gap_s = self._agenda.stood_still_s(block, self._rig.now_s())
        if gap_s > self._plan.limits.max_gap_in_group_s:
            self._void(block, f"the group stood still for {gap_s:.0f} s")
            raise _GroupEndedError

    def _void(self, block: Block, reason: str) -> None:
        keeper, writer = need(self._keeper), need(self._writer)
        keeper.drain(PATIENCE_S)
        self._hear_saved()
        if failure := self._hear_failure():
            self._pause(failure, block)
        # the writer's thread has nothing in hand now, so that this one may write
        self._agenda.restart(block)
        for shot in block:
            if shot.id in writer.progress.saved:
                writer.void(shot.id, reason)
        self._set(saved=len(self._agenda.taken))
        self._note(f"group {block[0].group} is taken again: {reason}", {})

    def _skip(self, block: Block) -> None:
        self._agenda.skip(block)
        self._note(f"group {block[0].group} was skipped by the operator", {})

    def _refer(self, *, last: bool = False) -> None:
        """Measure white and black light; begin a new segment if the lamp has changed.

        After the ``last`` shot a lamp that changed is only told of, and so is one not seen.
        """
        self._set(shot="", attempt=0)
        for _ in range(self._plan.limits.attempts_per_shot):
            try:
                found = self.references.measure(need(self._sequencer), self._cancel)
            except AttemptError as error:
                self._problem(f"reference: {error}")
                if error.cause is Cause.WRONG_EXPOSURE:
                    need(self._sequencer).forget_exposure()
                if not last and error.cause in (Cause.DEVICE_LOST, Cause.NOT_FIRED):
                    self._recover(self._agenda.blocks[0], str(error))
                continue
            self._note(found.text, {"reference": found.levels})
            if found.changed:
                self._problem(found.text)
                if not last:
                    self._keep(Item(event="segment", details={"reason": found.text}))
            return
        if not last:
            msg = f"no reference could be taken; check lamp and camera. {self.status.problem}"
            raise RunError(msg)

    # What is kept and told of an attempt.

    def _commit(self, shot: Shot, taken: Taken) -> None:
        # the long exposures of a bracket are meant to clip
        shortest = shot.exposure_s == self._agenda.shortest_s
        allowed = self._plan.limits.saturated_fraction if shortest else None
        for text in poor(taken.details, self._rig.camera_can.white_level_dn, allowed):
            self._problem(f"shot {shot.id}: {text}")
        self._keep(
            Item(
                event="commit",
                shot=shot.id,
                attempt=self._attempts[shot.id],
                pixels=taken.frame.pixels,
                details=taken.details,
            )
        )

    def eta_s(self) -> float:
        """Return how long the shots that are left will take, s."""
        return self.references.seconds(self._agenda.left())

    def _step(self, shot: str, step: Step) -> None:
        self._set(step=step)
        self._rig.notice(shot, step)
        self._emit("step", step)
