"""Helper processes: what is long in Python runs in one of them, and answers by messages.

Spawned, not forked, for Tk and a fork do not go together. A helper ends when the window does.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal

NICE = 5  # the window and the camera go first where processors are few


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What came back of a job: how far it is, what it made, or why it failed.

    ``job`` is the negative count of the process where that has ended.
    """

    job: int
    kind: Literal["progress", "done", "failed"]
    value: Any


class Helper:
    """One process that does a job of `labrig.station.jobs` after the other.

    `ask` and `poll` belong to the window's thread; another one reads the answers.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._then: dict[
            int, tuple[Callable[[Any], None], Callable[[str], None], Callable[[str], None]]
        ]
        self._then = {}
        self._next = 0
        self._ended, self._generation = False, 0
        self._start()

    @property
    def busy(self) -> bool:
        """Whether a job waits for its answer."""
        return bool(self._then)

    @property
    def pid(self) -> int | None:
        """The process, None if there is none."""
        return self._process.pid

    def ask(
        self,
        job: str,
        *arguments: Any,
        then: Callable[[Any], None],
        failed: Callable[[str], None] = lambda _why: None,
        progress: Callable[[str], None] = lambda _stage: None,
        **options: Any,
    ) -> None:
        """Let the helper do a job of `labrig.station.jobs`; the answer comes out of `poll`.

        A process that has ended is replaced by a new one.
        """
        if self._ended:
            self.restart()
        self._next += 1
        self._then[self._next] = (then, failed, progress)
        try:
            self._pipe.send((self._next, job, arguments, options))
        except OSError:
            self._answers.put(
                Answer(job=self._next, kind="failed", value="the helper process has ended.")
            )

    def poll(self) -> None:
        """Hand over what came back; never waits."""
        while True:
            try:
                answer = self._answers.get_nowait()
            except queue.Empty:
                return
            if answer.job < 0:  # a process has ended
                if -answer.job != self._generation:
                    continue  # one that was stopped, not the one that now works
                self._ended = True
                lost, self._then = self._then, {}
                for _, failed, _ in lost.values():
                    failed("the helper process ended in the middle of it; try again.")
                continue
            waiting = self._then.get(answer.job)
            if waiting is None:
                continue
            then, failed, progress = waiting
            if answer.kind == "progress":
                progress(answer.value)
                continue
            del self._then[answer.job]
            (then if answer.kind == "done" else failed)(answer.value)

    def stop(self) -> None:
        """End the process; what it was doing is lost."""
        self._then.clear()
        self._process.terminate()
        self._process.join(2.0)
        # The reader meets the end of the pipe; closed under its hands it would stumble.
        self._reader.join(1.0)
        self._pipe.close()

    def restart(self) -> None:
        """End what the helper does, and begin with a new one."""
        self.stop()
        self._start()

    def _start(self) -> None:
        self._ended, self._generation = False, self._generation + 1
        context = mp.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(other,), name=f"labrig-{self._name}", daemon=True
        )
        self._process.start()
        other.close()
        pipe = self._pipe
        self._reader = threading.Thread(
            target=self._read,
            args=(pipe, self._generation),
            name=f"labrig-{self._name}-answers",
            daemon=True,
        )
        self._reader.start()

    def _read(self, pipe: Connection, generation: int) -> None:
        while True:
            try:
                job, kind, value = pipe.recv()
            except (EOFError, OSError):
                self._answers.put(Answer(job=-generation, kind="failed", value=""))
                return
            self._answers.put(Answer(job=job, kind=kind, value=value))


def _serve(pipe: Connection) -> None:
    """Do jobs until the window is gone: the body of a helper process."""
    from labrig.errors import LabrigError  # noqa: PLC0415
    from labrig.station import jobs  # noqa: PLC0415 - in the helper alone

    os.nice(NICE)
    while True:
        try:
            number, name, arguments, options = pipe.recv()
        except (EOFError, OSError):
            return
        if name == "analyse":
            options["tell"] = lambda stage, n=number: pipe.send((n, "progress", stage))
        try:
            answer = (number, "done", getattr(jobs, name)(*arguments, **options))
        except (LabrigError, ValueError, OSError) as error:
            answer = (number, "failed", " ".join(str(error).split()))
        except Exception as error:
            text = f"a fault of the program, {type(error).__name__}: {error}"
            answer = (number, "failed", " ".join(text.split()))
        try:
            pipe.send(answer)
        except OSError:
            return
