"""Calibration records on disk: record.yaml for people, arrays.nc for pictures and tables.

A record is a folder beside its session, written aside and renamed into place when whole.
"""

from __future__ import annotations

import hashlib
import math
import platform
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import h5netcdf
import numpy as np

from calibration.record import Conditions, NamedArray, Quantity, Record
from labrig.config import dump, load
from labrig.errors import ConfigError, RunError
from labrig.models.calibration import (
    ConditionsFile,
    QuantityFile,
    RecordFile,
    SourceFile,
)
from labrig.results import Field, write_fields

RECORD, ARRAYS = "record.yaml", "arrays.nc"
_PACKAGES = ("labrig", "numpy", "scipy", "opencv-contrib-python-headless", "h5netcdf")


def write_record(parent: Path, record: Record, *, session: str, path: Path) -> Path:
    """Write a record below ``parent`` and return its folder.

    Raises
    ------
    RunError
        If the place cannot be written; nothing is left behind then.
    """
    name = f"{record.kind}_{record.created:%Y%m%d-%H%M%S}_{secrets.token_hex(2)}"
    part = parent / f".{name}.part"
    try:
        part.mkdir(parents=True)
        digest = None
        if record.arrays:
            fields = {
                key: Field(dims=a.dims, values=a.values, unit=a.unit, meaning=a.meaning)
                for key, a in record.arrays.items()
            }
            write_fields(part / ARRAYS, fields, {"kind": record.kind, "id": name})
            digest = _sha256(part / ARRAYS)
        source = SourceFile(
            session=session, path=str(path), n_frames=record.n_frames, sha256=record.inputs
        )
        file = RecordFile(
            schema_="labrig-calibration/1",
            kind=record.kind,
            id=name,
            created=record.created,
            source=source,
            conditions=ConditionsFile(**asdict(record.conditions)),
            quantities={key: _quantity(q) for key, q in record.quantities.items()},
            settings=dict(record.settings),
            notes=record.notes,
            arrays_sha256=digest,
            software={"python": platform.python_version(), **{p: version(p) for p in _PACKAGES}},
        )
        (part / RECORD).write_text(dump(file), encoding="utf-8")
        part.rename(parent / name)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        reason = error.strerror or str(error)
        msg = f"{parent}: the record cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error
    return parent / name


def is_record(path: Path) -> bool:
    """Return whether a folder holds a calibration record."""
    return (path / RECORD).is_file()


def read_record(path: Path) -> tuple[RecordFile, Record]:
    """Read a record back: the file as it stands, and the record it holds.

    Raises
    ------
    ConfigError
        If there is none, or arrays.nc is not the one that was written.
    """
    file = load(path / RECORD, RecordFile)
    arrays: Mapping[str, NamedArray] = {}
    if file.arrays_sha256 is not None:
        arrays = _read_arrays(path / ARRAYS, file.arrays_sha256)
    return file, Record(
        kind=file.kind,
        created=file.created,
        conditions=Conditions(**file.conditions.model_dump()),
        inputs=file.source.sha256,
        n_frames=file.source.n_frames,
        quantities={
            key: Quantity(value=math.nan if q.value is None else q.value, unit=q.unit, std=q.std)
            for key, q in file.quantities.items()
        },
        arrays=arrays,
        settings=file.settings,
        notes=file.notes,
    )


def _read_arrays(path: Path, sha256: str) -> dict[str, NamedArray]:
    try:
        if _sha256(path) != sha256:
            msg = f"{path} is not the file its record names; restore it, or calibrate again."
            raise ConfigError(msg)
        with h5netcdf.File(path, "r") as file:
            return {
                name: NamedArray(
                    dims=tuple(v.dimensions),
                    values=np.asarray(v[...]),
                    unit=str(v.attrs.get("units", "")),
                    meaning=str(v.attrs.get("long_name", "")),
                )
                for name, v in file.variables.items()
            }
    except OSError as error:
        msg = f"{path} cannot be read ({' '.join(str(error).split())}); calibrate again."
        raise ConfigError(msg) from error


def _quantity(quantity: Quantity) -> QuantityFile:
    std = quantity.std
    return QuantityFile(
        value=quantity.value if math.isfinite(quantity.value) else None,
        std=std if std is not None and math.isfinite(std) else None,
        unit=quantity.unit,
    )


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
