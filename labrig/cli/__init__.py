"""The command line: a sub-command a verb, each one call of the Python API."""

from __future__ import annotations

import signal
import sys

import typer

from analysis.errors import AnalysisError
from calibration.errors import CalibrationError
from drivers.errors import DriverError
from labrig.cli.commands import PLACES, app_of
from labrig.errors import LabrigError, RunError, SessionError
from labrig.exits import EXIT_BAD_INPUT, EXIT_DAMAGED, EXIT_DEVICE, EXIT_INTERRUPTED


def main() -> None:
    """Run the command line; print each error as one line and leave with its code."""
    code = run(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # there is nothing left to interrupt
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code."""
    try:
        # A window must not wait for the solvers, nor any command for the others.
        called = arguments[:1] if arguments and arguments[0] in PLACES else PLACES
        command = typer.main.get_command(app_of(called))
        code = command.main(arguments or ["--help"], prog_name="labrig", standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), EXIT_BAD_INPUT)
    except SessionError as error:
        return _fail(str(error), EXIT_DAMAGED)
    except (RunError, DriverError) as error:
        return _fail(str(error), EXIT_DEVICE)
    except (LabrigError, CalibrationError, AnalysisError) as error:
        return _fail(str(error), EXIT_BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", EXIT_DEVICE)
    except (KeyboardInterrupt, typer.Abort):
        code = EXIT_INTERRUPTED
    if code == EXIT_INTERRUPTED:  # typer returns it where it was first to hear Ctrl-C
        return _fail("interrupted; what was saved stays saved.", EXIT_INTERRUPTED)
    return code if isinstance(code, int) else 0


def _fail(message: str, code: int) -> int:
    sys.stderr.write(f"labrig: {' '.join(message.split())}\n")
    return code
