"""The command line: a sub-command a verb, each one call of the Python API."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import labrig
from analysis.errors import AnalysisError
from calibration.errors import CalibrationError
from drivers.errors import DriverError
from labrig import demo as demonstration
from labrig.config import json_schema
from labrig.errors import LabrigError, RunError, SessionError

app = typer.Typer(
    name="labrig",
    help="Measure how light travels in scattering media.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
out_console = Console()
err_console = Console(stderr=True)

EXIT_BAD_INPUT = 2
EXIT_DAMAGED = 3
EXIT_DEVICE = 4
EXIT_INTERRUPTED = 130

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder to write to.")]


class SchemaKind(StrEnum):
    """Kinds of configuration files."""

    plan = "plan"
    rig = "rig"
    scene = "scene"
    analysis = "analysis"
    import_ = "import"


class Until(StrEnum):
    """Where an analysis stops."""

    separation = "separation"
    results = "results"


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


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for session and report.")] = Path(
        "demo"
    ),
    scene: Annotated[Path | None, typer.Option(help="Scene file; else diluted milk.")] = None,
    as_json: AsJson = False,
) -> None:
    """Capture, analyse and report diluted milk on the simulated rig."""
    with _bars() as follow:
        found = demonstration.run(out, scene=scene, progress=follow)
    if as_json:
        _print_json(
            {
                **{name: asdict(p) for name, p in found.parameters.items()},
                "session": str(found.session),
                "report": str(found.report),
            }
        )
        return
    table = Table(title="recovered from the simulated capture")
    for heading in ("parameter", "truth", "recovered", "deviation"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, p in found.parameters.items():
        std = "—" if p.std is None else f"{p.std:.2g}"
        off = (
            f"{p.value - p.truth:+.3f}"
            if name == "g"
            else f"{100 * (p.value / p.truth - 1):+.1f} %"
        )
        table.add_row(name, f"{p.truth:.5g}", f"{p.value:.5g} ± {std}", off)
    out_console.print(table)
    _print("± is statistical; the deviation is the known bias of the paper's separation.")
    _print(f"session  {found.session}")
    _print(f"report   {found.report}")


@app.command()
def capture(
    plan: Annotated[Path, typer.Argument(help="Plan file.")],
    rig: Annotated[Path, typer.Option(help="Rig file.")],
    scene: Annotated[Path, typer.Option(help="Scene file, for a simulated rig.")],
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    as_json: AsJson = False,
) -> None:
    """Run a capture plan and keep it as a session."""
    wanted = labrig.load_plan(plan)
    with (
        _bars() as follow,
        labrig.open_rig(rig, scene, wanted, progress=_one(follow, "light")) as opened,
    ):
        path = labrig.capture(wanted, opened, out, progress=_one(follow, "capture"))
    _say_session(path, as_json)


@app.command(name="import")
def import_(
    manifest: Annotated[Path, typer.Argument(help="Manifest of existing image files.")],
    out: Annotated[Path, typer.Option("--out", help="Data root.")] = Path("sessions"),
    as_json: AsJson = False,
) -> None:
    """Make a session of existing image files."""
    with _bars() as follow:
        path = labrig.import_session(manifest, out, progress=_one(follow, "import"))
    _say_session(path, as_json)


@app.command()
def verify(
    session: Annotated[Path, typer.Argument(help="Session folder.")], as_json: AsJson = False
) -> int:
    """Check every file of a session; the exit code is 3 if anything is wrong."""
    with _bars() as follow:
        problems = labrig.verify(session, progress=_one(follow, "verify"))
    if as_json:
        _print_json({"session": str(session), "problems": [asdict(p) for p in problems]})
    else:
        for problem in problems:
            _print(f"{problem.file}: {problem.what}")
        _print(f"{session}: {len(problems)} problems" if problems else f"{session}: whole")
    return EXIT_DAMAGED if problems else 0


@app.command()
def analyse(
    session: Annotated[Path, typer.Argument(help="Session folder.")],
    config: Annotated[Path | None, typer.Option(help="Analysis file.")] = None,
    until: Annotated[Until, typer.Option(help="Stop after a stage.")] = Until.results,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Separate a session and find sigma_t, sigma_s and g."""
    with _spinner() as follow:
        result = labrig.analyse(session, config, until=until.value, out=out, progress=follow)
    if as_json:
        _print_json({**result.run, "path": str(result.path)})
        return
    _print(f"session  {result.run['session']['id']}")
    table = Table()
    table.add_column("parameter")
    table.add_column("value", justify="right")
    for name, found in result.run.items():
        if isinstance(found, dict) and "value" in found:
            std = "—" if found["std"] is None else f"{found['std']:.2g}"
            table.add_row(name, f"{found['value']:.5g} ± {std}")
    closure = result.run["quality"].get("closure")
    if closure is not None and closure["mean"] is not None:
        table.add_row("closure, mean", f"{100 * closure['mean']:+.2f} %")
    out_console.print(table)
    for note in result.run["notes"]:
        _print(f"note: {note}")
    _print(f"results  {result.path}")


@app.command()
def report(
    session: Annotated[Path, typer.Argument(help="Session or results folder.")],
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Write figures and a self-contained HTML page of a session's newest results."""
    page = labrig.report(session, out)
    if as_json:
        _print_json({"report": str(page)})
    else:
        _print(str(page))


@app.command()
def schema(kind: Annotated[SchemaKind, typer.Argument(help="Kind of file.")]) -> None:
    """Print the JSON Schema of a configuration file."""
    _print_json(json_schema(kind.value))


def _say_session(path: Path, as_json: bool) -> None:
    if as_json:
        _print_json({"session": str(path)})
    else:
        _print(str(path))


@contextmanager
def _bars() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar for each thing in progress, on standard error if that is a terminal."""
    columns = (TextColumn("{task.description:10}"), BarColumn(), TimeElapsedColumn())
    progress = Progress(
        *columns, console=err_console, transient=True, disable=not err_console.is_terminal
    )
    tasks: dict[str, Any] = {}

    def follow(what: str, done: int, total: int) -> None:
        progress.start()
        if what not in tasks:
            tasks[what] = progress.add_task(what, total=total)
        progress.update(tasks[what], completed=done)

    try:
        yield follow
    finally:
        progress.stop()


@contextmanager
def _spinner() -> Iterator[Callable[[str], None]]:
    """Show the stage in progress, on standard error."""
    if not err_console.is_terminal:
        yield lambda _: None
        return
    with err_console.status("open") as status:
        yield status.update


def _one(follow: Callable[[str, int, int], None], what: str) -> Callable[[int, int], None]:
    return lambda done, total: follow(what, done, total)


def _print(text: str) -> None:
    out_console.print(text, markup=False, highlight=False, soft_wrap=True)


def _print_json(value: Any) -> None:
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")


def _fail(message: str, code: int) -> int:
    sys.stderr.write(f"labrig: {' '.join(message.split())}\n")
    return code
