"""Results on disk: run.json for scalars, fields.nc for pictures and light fields.

A results folder is written beside its place and renamed into it when complete. Everything the
figures and the report show is read back from these two files.
"""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
from numpy.typing import NDArray

from labrig.errors import RunError, SessionError

SCHEMA = "labrig-run/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One array with its axes, unit and meaning."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A results folder, read back.

    Attributes
    ----------
    run : contents of run.json
    fields : every array of fields.nc by name
    attributes : attributes of fields.nc
    """

    path: Path
    run: Mapping[str, Any]
    fields: Mapping[str, Field]
    attributes: Mapping[str, Any]


def value_of(found: Mapping[str, Any]) -> float:
    """Return a parameter's value, or what was assumed where the data did not tell it."""
    return float(found["assumed"] if found["value"] is None else found["value"])


def write_results(
    parent: Path,
    run: Mapping[str, Any],
    fields: Mapping[str, Field],
    attributes: Mapping[str, Any],
) -> Path:
    """Write a results folder below ``parent`` and return its path.

    Raises
    ------
    RunError
        If the place cannot be written, as on read-only media; nothing is left behind then.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    name = f"{stamp}-{secrets.token_hex(2)}"
    part = parent / f".{name}.part"
    try:
        part.mkdir(parents=True)
        write_fields(part / "fields.nc", fields, attributes)
        record = {"schema": SCHEMA, "id": name, **run}
        text = json.dumps(record, indent=2, sort_keys=False, allow_nan=False)
        (part / "run.json").write_text(text + "\n", encoding="utf-8")
        part.rename(parent / name)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        reason = error.strerror or str(error)
        msg = f"{parent}: results cannot be written ({reason}); name another place with --out."
        raise RunError(msg) from error
    return parent / name


def results_of(session: Path) -> Path:
    """Return the folder of a session's results; raise `SessionError` if it could lead outside."""
    folder = session / "results"
    if folder.is_symlink():
        msg = f"{folder} is a symbolic link, which could lead anywhere: remove it, or use --out."
        raise SessionError(msg)
    return folder


def write_fields(path: Path, fields: Mapping[str, Field], attributes: Mapping[str, Any]) -> None:
    """Write arrays with named dimensions as NetCDF-4, with checksums."""
    sizes: dict[str, int] = {}
    for field in fields.values():
        sizes.update(zip(field.dims, field.values.shape, strict=True))
    with h5netcdf.File(path, "w") as file:
        file.dimensions = sizes
        for name, field in fields.items():
            chunks = tuple(
                1 if dim in {"bounce", "scattered_bounce"} else size
                for dim, size in zip(field.dims, field.values.shape, strict=True)
            )
            stored = file.create_variable(
                name, field.dims, data=field.values, chunks=chunks, fletcher32=True
            )
            stored.attrs["units"] = field.unit
            stored.attrs["long_name"] = field.meaning
        for name, value in attributes.items():
            file.attrs[name] = value


def written(folder: Path, fields: Mapping[str, Field], attributes: Mapping[str, Any]) -> Result:
    """Return what was just written, without reading the arrays again."""
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return Result(path=folder, run=run, fields=dict(fields), attributes=dict(attributes))


def read_results(path: Path) -> Result:
    """Read a results folder, or the newest one of a session folder.

    Raises
    ------
    SessionError
        If there are none, or a file is missing or damaged.
    """
    folder = _newest(path)
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        with h5netcdf.File(folder / "fields.nc", "r") as file:
            fields = {
                name: Field(
                    dims=tuple(v.dimensions),
                    values=np.asarray(v[...]),
                    unit=str(v.attrs.get("units", "")),
                    meaning=str(v.attrs.get("long_name", "")),
                )
                for name, v in file.variables.items()
            }
            attributes = dict(file.attrs)
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        msg = f"{folder}: results are damaged ({' '.join(str(error).split())}); analyse again."
        raise SessionError(msg) from error
    if not isinstance(run, dict) or run.get("schema") != SCHEMA:
        msg = f"{folder}: run.json is no {SCHEMA}; analyse again with this version."
        raise SessionError(msg)
    return Result(path=folder, run=run, fields=fields, attributes=attributes)


def _newest(path: Path) -> Path:
    if (path / "run.json").is_file():
        return path
    folders = [file.parent for file in results_of(path).glob("*/run.json")]
    found = sorted(folder for folder in folders if not folder.is_symlink())
    if not found:
        msg = f"{path}: holds no results; run `labrig analyse` on the session first."
        raise SessionError(msg)
    return found[-1]
