"""From a session to a calibration record beside it, with its page."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from calibration.record import Record
from labrig.calibrating.board import load_board
from labrig.calibrating.camera import RECORDS, Source, flat_record
from labrig.calibrating.optics import geometry_record, projector_record
from labrig.calibrating.response import response_record
from labrig.calibration_records import read_record, write_record
from labrig.errors import AnalysisRefusedError, ConfigError
from labrig.steps.corrections import dark_of

KINDS = (*RECORDS, "response", "geometry", "projector")


def calibrate(
    kind: str,
    session: Path,
    *,
    out: Path | None = None,
    dark: Path | None = None,
    board: Path | None = None,
) -> Path:
    """Make a record of a session and return its folder.

    Parameters
    ----------
    kind : one of `KINDS`
    out : where the record's folder is made; else beside the session
    dark : dark record for a flat; else the session's own dark frames
    board : board file for the geometry; else the default board

    Raises
    ------
    LabrigError, CalibrationError
        If the session does not hold what the kind needs, or nothing trustworthy comes of it.
    """
    source = Source.open(session)
    path = session.resolve()
    record = _record(kind, source, dark, board)
    return write_record(
        out or path.parent,
        record,
        session=str(source.session.header.get("id", path.name)),
        path=path,
    )


def _record(kind: str, source: Source, dark: Path | None, board: Path | None) -> Record:
    if kind == "flat" and dark is not None:
        _, found = read_record(dark)
        if found.kind != "dark":
            msg = f"{dark} is a record of {found.kind}; name a dark record."
            raise AnalysisRefusedError(msg)
        return flat_record(source, dark_of(found))
    makers: dict[str, Callable[[Source], Record]] = {
        **RECORDS,
        "response": response_record,
        "geometry": partial(geometry_record, board=load_board(board)),
        "projector": projector_record,
    }
    if kind not in makers:
        msg = f"there is no calibration {kind!r}; choose one of {', '.join(KINDS)}."
        raise ConfigError(msg)
    return makers[kind](source)
