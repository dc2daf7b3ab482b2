"""The command line: a sub-command a verb, each one call of the Python API."""

from __future__ import annotations

import sys

import typer

from analysis.errors import AnalysisError
from calibration.errors import CalibrationError
from drivers.errors import DriverError
from labrig.cli.accuracy import app as accuracy
from labrig.cli.analyse import analyse, report
from labrig.cli.calibrate import app as calibrate
from labrig.cli.capture import capture, import_, ls, resume, verify
from labrig.cli.check import check
from labrig.cli.demo import demo
from labrig.cli.devices import devices
from labrig.cli.doctor import doctor
from labrig.cli.exits import EXIT_BAD_INPUT, EXIT_DAMAGED, EXIT_DEVICE, EXIT_INTERRUPTED
from labrig.cli.schema import schema
from labrig.cli.series import series
from labrig.cli.simulate import simulate_
from labrig.cli.solve import solve
from labrig.errors import LabrigError, RunError, SessionError

app = typer.Typer(
    name="labrig",
    help="Measure how light travels in scattering media.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for command in (
    demo,
    check,
    capture,
    resume,
    verify,
    ls,
    analyse,
    report,
    series,
    solve,
    devices,
    doctor,
    schema,
):
    app.command()(command)
app.command(name="import")(import_)
app.command(name="simulate")(simulate_)
app.add_typer(calibrate, name="calibrate")
app.add_typer(accuracy, name="accuracy")


def main() -> None:
    """Run the command line; print each error as one line and leave with its code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code."""
    command = typer.main.get_command(app)
    try:
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
