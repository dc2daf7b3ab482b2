"""Commands that make calibration records of sessions, a sub-command a kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

import labrig
from labrig.cli.calibrate_latency import latency
from labrig.cli.say import AsJson, Out, out_console, say, say_json

SessionFolder = Annotated[Path, typer.Argument(help="Session folder.")]

app = typer.Typer(
    help="Make calibration records of sessions, beside them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def _say_record(path: Path, as_json: bool) -> None:
    """Print what a record found and where it is."""
    file = labrig.read_calibration(path)
    if as_json:
        say_json({**file.model_dump(mode="json", by_alias=True), "path": str(path)})
        return
    table = Table()
    table.add_column(file.kind)
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, found in file.quantities.items():
        value = "—" if found.value is None else f"{found.value:.5g}"
        std = "" if found.std is None else f" ± {found.std:.2g}"
        table.add_row(name, value + std, found.unit)
    out_console.print(table)
    for note in file.notes:
        say(f"note: {note}")
    say(f"record   {path}")


def _of_session(kind: str, what: str) -> Callable[..., None]:
    """Return the command of a kind that needs nothing but a session."""

    def command(session: SessionFolder, out: Out = None, as_json: AsJson = False) -> None:
        _say_record(labrig.calibrate(kind, session, out=out), as_json)

    command.__doc__ = what
    return command


app.command()(latency)
for _kind, _what in {
    "dark": "Find offset, dark current and hot pixels from dark frames.",
    "photon-transfer": "Find gain, noise and linearity from pairs of flat and dark frames.",
    "response": "Check linearity, or fit an 8-bit camera's response, of a ramp or of inverses.",
    "projector": "Find map, contrast, gamma and leak of the projector.",
}.items():
    app.command(name=_kind)(_of_session(_kind, _what))


@app.command()
def flat(
    session: SessionFolder,
    dark: Annotated[
        Path | None, typer.Option(help="Dark record; else the session's own dark frames.")
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Find the relative response of every pixel from frames of uniform light."""
    _say_record(labrig.calibrate("flat", session, dark=dark, out=out), as_json)


@app.command()
def geometry(
    session: SessionFolder,
    board: Annotated[
        Path | None, typer.Option(help="Board file; else the board that is drawn by default.")
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> None:
    """Find lens and tank plane from pictures of a board, the first lying in the plane."""
    _say_record(labrig.calibrate("geometry", session, board=board, out=out), as_json)


@app.command()
def board(
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("board"),
    squares_x: Annotated[int, typer.Option(help="Squares along x.")] = 9,
    squares_y: Annotated[int, typer.Option(help="Squares along y, odd.")] = 7,
    square_mm: Annotated[float, typer.Option(help="Side of a square, mm.")] = 10.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker, mm.")] = 7.0,
) -> None:
    """Draw a ChArUco board to print in true size: board.pdf, board.png, board.yaml."""
    for path in labrig.draw_board(
        out, squares_x=squares_x, squares_y=squares_y, square_mm=square_mm, marker_mm=marker_mm
    ):
        say(str(path))
    say("Print board.pdf at 100 %, then measure a square and give its side in board.yaml.")
