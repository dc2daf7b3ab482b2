"""How a run is followed and steered from a terminal."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from labrig.acquisition.capturing import AbortedError, finish
from labrig.acquisition.run_state import Command, Event, State
from labrig.acquisition.runner import Runner
from labrig.cli.say import err_console
from labrig.errors import RunError

POLL_S = 0.1


def drive(runner: Runner) -> Path:
    """Run to the end in a thread of its own, so that this one can hear Ctrl-C; return the folder.

    Ctrl-C aborts; a second one is ignored, because the rig is being made safe. A run that pauses
    asks here if somebody is there, else it is aborted and can be resumed.

    Raises
    ------
    Exception
        What made the run fail; KeyboardInterrupt if it was aborted by Ctrl-C.
    """
    ended: list[Path | BaseException] = []
    why: list[str] = []

    def work() -> None:
        try:
            ended.append(finish(runner))
        except BaseException as error:
            ended.append(error)

    thread = threading.Thread(target=work, name="labrig-run")
    runner.post(Command.START)
    with _bar(runner), _interrupts(runner) as interrupted:
        thread.start()
        while thread.is_alive():
            thread.join(POLL_S)
            if runner.status.state is State.PAUSED and not interrupted:
                why.append(runner.status.reason)
                runner.post(_answer(runner.status.reason))
                while runner.status.state is State.PAUSED and thread.is_alive():
                    thread.join(POLL_S)
    (result,) = ended
    if interrupted:
        raise KeyboardInterrupt
    if isinstance(result, AbortedError) and why:
        msg = f"{why[-1]} The run was aborted; labrig resume {runner.path} goes on with it."
        raise RunError(msg) from None
    if isinstance(result, BaseException):
        raise result
    return result


def _answer(reason: str) -> Command:
    """Ask what to do about a pause; nobody there is an abort."""
    if not (sys.stdin.isatty() and err_console.is_terminal):
        return Command.ABORT
    err_console.print(f"paused: {reason}", markup=False, highlight=False)
    said = err_console.input("resume, skip the group, or abort? [r/s/a] ").strip().lower()
    return {"r": Command.RESUME, "s": Command.SKIP_GROUP}.get(said[:1], Command.ABORT)


@contextmanager
def _interrupts(runner: Runner) -> Iterator[list[bool]]:
    """Turn Ctrl-C into an abort; the list is filled when it came.

    Once it came this process only says goodbye, so that no later one tears that: it stays ignored.
    """
    interrupted: list[bool] = []
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return

    def abort(_number: int, _frame: object) -> None:
        interrupted.append(True)
        runner.post(Command.ABORT)

    before = signal.signal(signal.SIGINT, abort)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN if interrupted else before)


@contextmanager
def _bar(runner: Runner) -> Iterator[None]:
    """Show shots saved, time left and the last problem, on standard error if a terminal."""
    progress = Progress(
        TextColumn("{task.description:10}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[eta]} {task.fields[problem]}", markup=False),
        console=err_console,
        transient=True,
        disable=not err_console.is_terminal,
    )
    task = progress.add_task("capture", total=runner.status.total, eta="", problem="")

    def hear(event: Event) -> None:
        status = event.status
        progress.update(
            task,
            completed=status.saved,
            description=str(status.state),
            eta=f"{status.eta_s:.0f} s left" if status.eta_s else "",
            problem=status.problem,
        )

    runner.subscribe(hear)
    with progress:
        yield
