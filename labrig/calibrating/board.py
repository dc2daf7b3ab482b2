"""Draws the calibration board in true size: PDF and PNG to print, YAML to remember it by."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from calibration.geometry import Board
from labrig.config import dump, load
from labrig.errors import RunError
from labrig.models.calibration import BoardFile

DPI = 600
MARGIN_MM = 10.0
MM_PER_INCH = 25.4


def load_board(path: Path | None) -> Board:
    """Return the board of a file, or the default one."""
    if path is None:
        return Board()
    return board_of(load(path, BoardFile))


def board_of(file: BoardFile) -> Board:
    """Return the calibration's record of a board."""
    return Board(
        squares_x=file.squares_x,
        squares_y=file.squares_y,
        square_mm=file.square_mm,
        marker_mm=file.marker_mm,
        dictionary=file.dictionary,
    )


def draw_board(out: Path, file: BoardFile) -> tuple[Path, ...]:
    """Write ``board.pdf``, ``board.png`` (600 dpi) and ``board.yaml``; return their paths.

    The page is the board and a white margin of 10 mm, which its outer markers need.

    Raises
    ------
    CalibrationError
        If the sizes make no board.
    RunError
        If the place cannot be written.
    """
    px_per_mm = DPI / MM_PER_INCH
    drawn = Image.fromarray(board_of(file).draw(px_per_mm))
    margin = round(MARGIN_MM * px_per_mm)
    page = Image.new("L", (drawn.width + 2 * margin, drawn.height + 2 * margin), 255)
    page.paste(drawn, (margin, margin))
    # one bit a pixel: a PDF of greys would hold it as JPEG, with blurred edges
    sharp = page.convert("1", dither=Image.Dither.NONE)
    paths = tuple(out / f"board.{end}" for end in ("pdf", "png", "yaml"))
    try:
        out.mkdir(parents=True, exist_ok=True)
        sharp.save(paths[0], "PDF", resolution=DPI)
        sharp.save(paths[1], "PNG", dpi=(DPI, DPI))
        paths[2].write_text(dump(file), encoding="utf-8")
    except OSError as error:
        msg = f"{out}: the board cannot be written ({error.strerror or error}); name another place."
        raise RunError(msg) from error
    return paths
