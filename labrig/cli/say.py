"""How commands speak: lines, tables and JSON on standard output, progress on standard error."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

out_console = Console()
err_console = Console(stderr=True)

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder to write to.")]


def say_session(path: Path, as_json: bool) -> None:
    """Print where a session is."""
    if as_json:
        say_json({"session": str(path)})
    else:
        say(str(path))


@contextmanager
def bars() -> Iterator[Callable[[str, int, int], None]]:
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
def spinner() -> Iterator[Callable[[str], None]]:
    """Show the stage in progress, on standard error."""
    if not err_console.is_terminal:
        yield lambda _: None
        return
    with err_console.status("open") as status:
        yield status.update


def one(follow: Callable[[str, int, int], None], what: str) -> Callable[[int, int], None]:
    """Return the follower of one thing out of the follower of many."""
    return lambda done, total: follow(what, done, total)


def say(text: str) -> None:
    """Print one line as it is."""
    out_console.print(text, markup=False, highlight=False, soft_wrap=True)


def say_json(value: Any) -> None:
    """Print JSON; NaN has no place in it."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")
