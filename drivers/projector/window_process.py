"""The process that holds the projector's window, as its driver sees it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from typing import Any

from drivers.errors import CancelledError, DeadlineError, DeviceLostError, DriverError
from drivers.transport.messages import MessageReader, write_message
from drivers.transport.x_display import Output
from drivers.waiting import CancelToken

START_S = 15.0  # Python and Tk on a loaded machine; measured 0.4 s on an idle one
QUIT_S = 2.0


class WindowProcess:
    """The window's process and the messages to and from it."""

    def __init__(self, display: str, output: Output) -> None:
        self._output = output
        self._tag = 0
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `kill`
        self._process = subprocess.Popen(
            [sys.executable, "-m", "drivers.projector.screen"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env={**os.environ, "DISPLAY": display},
            # Ctrl-C at the terminal is for the program, which then turns the light off in order.
            start_new_session=True,
        )
        if self._process.stdin is None or self._process.stdout is None:  # pragma: no cover
            raise AssertionError
        self._to = self._process.stdin
        self._from = self._process.stdout
        os.set_blocking(self._to.fileno(), False)
        self._reader = MessageReader(self._from.fileno())

    def start(self) -> dict[str, Any]:
        """Wait for the window; return its geometry as Tk reports it."""
        place = {key: getattr(self._output, key) for key in ("x", "y", "width", "height")}
        limit_s = time.monotonic() + START_S
        return self.ask("start", place, deadline_s=limit_s, cancel=CancelToken())

    def ask(
        self,
        order: str,
        words: dict[str, Any],
        *,
        deadline_s: float,
        cancel: CancelToken,
        payload: bytes = b"",
    ) -> dict[str, Any]:
        """Send one order and return its answer; answers to orders given up are passed over.

        Raises
        ------
        DeadlineError, DeviceLostError, CancelledError
        """
        self._tag += 1
        try:
            self._write({"order": order, "tag": self._tag, **words}, payload, deadline_s)
            while True:
                self._reader.await_bytes(deadline_s=deadline_s, cancel=cancel)
                answer = self._reader.next()
                if answer["tag"] == self._tag:
                    return answer
        except CancelledError:
            raise
        except DeadlineError as error:
            msg = (
                f"the window on output {self._output.name} did not {order} before the deadline; "
                "the X server is overloaded or stopped: close what else draws on it."
            )
            raise DeadlineError(msg) from error
        except (DeviceLostError, OSError, ValueError) as error:
            msg = f"the window on output {self._output.name} has ended ({self._last_words()})."
            raise DeviceLostError(msg) from error

    def stop(self) -> None:
        """Black, then end; killed if it does not."""
        with suppress(DriverError):
            limit_s = time.monotonic() + QUIT_S
            self.ask("show", {"index": None}, deadline_s=limit_s, cancel=CancelToken())
        with suppress(OSError, ValueError):
            self._write({"order": "quit"}, b"", time.monotonic() + QUIT_S)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=QUIT_S)
        self.kill()

    def kill(self) -> None:
        """End the process whatever it does: the server then removes its window."""
        self._process.kill()
        self._process.wait()
        with suppress(OSError):
            self._to.close()
        self._from.close()
        self._said.close()

    def _write(self, message: dict[str, Any], payload: bytes, deadline_s: float) -> None:
        try:
            write_message(self._to.fileno(), message, payload, deadline_s=deadline_s)
        except DeadlineError:
            self.kill()  # half a message was sent: what follows would not be understood
            raise

    def _last_words(self) -> str:
        if self._said.closed:
            return "it was removed"
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it was killed"
