"""Calibration records: made, read, drawn."""

from __future__ import annotations

from pathlib import Path

from labrig import calibration_records as _calibration_records
from labrig.api.files import StrPath
from labrig.config import parse
from labrig.models.calibration import BoardFile, RecordFile


def calibrate(
    kind: str,
    session: StrPath,
    *,
    out: StrPath | None = None,
    dark: StrPath | None = None,
    board: StrPath | None = None,
) -> Path:
    """Make a calibration record of a session, with its page; return its folder beside the session.

    Parameters
    ----------
    kind : dark, flat, photon-transfer, response, geometry or projector
    dark : dark record for a flat; else the session's own dark frames
    board : board file for the geometry; else the board that `draw_board` draws by default

    Raises
    ------
    labrig.errors.LabrigError, calibration.errors.CalibrationError
        If the session does not hold what the kind needs, or nothing trustworthy comes of it.
    """
    from labrig.calibrating import run as calibration_run  # noqa: PLC0415 - loads OpenCV

    record = calibration_run.calibrate(
        kind,
        Path(session),
        out=None if out is None else Path(out),
        dark=None if dark is None else Path(dark),
        board=None if board is None else Path(board),
    )
    report_calibration(record)
    return record


def read_calibration(path: StrPath) -> RecordFile:
    """Read a calibration record; raise `labrig.errors.ConfigError` if it is none or damaged."""
    return _calibration_records.read_record(Path(path))[0]


def report_calibration(record: StrPath, out: StrPath | None = None) -> Path:
    """Write figures and a self-contained HTML page of a calibration record; return the page."""
    from labrig.calibrating.page import write_record_page  # noqa: PLC0415 - matplotlib takes a second

    return write_record_page(Path(record), None if out is None else Path(out))


def draw_board(out: StrPath, **sizes: float) -> tuple[Path, ...]:
    """Write a ChArUco board in true size: ``board.pdf``, ``board.png`` and ``board.yaml``.

    ``sizes`` are squares_x, squares_y, square_mm and marker_mm.

    Raises
    ------
    labrig.errors.LabrigError, calibration.errors.CalibrationError
        If the sizes make no board, or the place cannot be written.
    """
    from labrig.calibrating import board  # noqa: PLC0415 - loads OpenCV

    content = {"schema": "labrig-board/1", **sizes}
    return board.draw_board(Path(out), parse(content, BoardFile, source="board"))
