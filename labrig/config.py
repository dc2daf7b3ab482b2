"""YAML files into frozen, validated models: the one place that reads and writes YAML.

Every file names its schema. Unknown keys are refused by name, with the nearest key that exists.
"""

from __future__ import annotations

import difflib
import reprlib
import typing
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from labrig.errors import ConfigError
from labrig.models.analysis import Analysis
from labrig.models.base import Model
from labrig.models.calibration import BoardFile, RecordFile
from labrig.models.latency import LatencyRecord
from labrig.models.manifest import ImportManifest
from labrig.models.plan import Plan
from labrig.models.rig import Rig
from labrig.models.scene import Scene
from labrig.models.series import Concentrations

SCHEMAS: dict[str, type[Model]] = {
    "plan": Plan,
    "rig": Rig,
    "scene": Scene,
    "analysis": Analysis,
    "import": ImportManifest,
    "board": BoardFile,
    "calibration": RecordFile,
    "series": Concentrations,
}

M = TypeVar("M", bound=Model)


def latency_file(rig: Path) -> Path:
    """Return where the latency of a rig's projector is kept: beside its rig file."""
    return rig.with_name(f"{rig.stem}.latency.yaml")


def latency_beside(rig: Path) -> LatencyRecord | None:
    """Return the latency record beside a rig file; None if it was never measured.

    Raises
    ------
    ConfigError
        If there is one that cannot be understood.
    """
    file = latency_file(rig)
    return load(file, LatencyRecord) if file.exists() else None


def save(path: Path, record: Model) -> None:
    """Write a record as YAML, whole or not at all."""
    content = record.model_dump(mode="json", by_alias=True)
    part = path.with_name(path.name + ".part")
    part.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    part.replace(path)


class _UniqueKeyLoader(yaml.SafeLoader):
    """The safe loader, which also refuses a key given twice instead of taking the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        twice = next((key for n, key in enumerate(keys) if key in keys[:n]), None)
        if twice is not None:
            msg = f"key {twice!r} is given twice"
            raise yaml.constructor.ConstructorError(None, None, msg, node.start_mark)
        return super().construct_mapping(node, deep=deep)


def load(path: Path, model: type[M]) -> M:
    """Read a YAML file into a frozen model.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no YAML mapping, or does not fit the model; the message
        names file and key.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _UniqueKeyLoader)  # noqa: S506
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        msg = f"{path}: cannot be read ({reason}); give the path of a YAML file."
        raise ConfigError(msg) from error
    except (yaml.YAMLError, RecursionError) as error:
        msg = f"{path}: is not valid YAML ({_one_line(str(error))})."
        raise ConfigError(msg) from error
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        msg = f"{path}: holds {found}, a mapping of keys was expected."
        raise ConfigError(msg)
    return parse(content, model, source=str(path))


def dump(model: Model) -> str:
    """Return a model as YAML, keys in the model's order."""
    content = model.model_dump(mode="json", by_alias=True)
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100)


def parse(content: Any, model: type[M], *, source: str) -> M:
    """Validate a mapping; ``source`` names it in messages.

    Raises
    ------
    ConfigError
        For the first thing that does not fit, naming source and key.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(_explain(error, model, source)) from error


def json_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file; `SCHEMAS` names them.

    Raises
    ------
    ConfigError
        If the kind is none of these.
    """
    if kind not in SCHEMAS:
        msg = f"there is no schema {kind!r}; choose one of {', '.join(SCHEMAS)}."
        raise ConfigError(msg)
    return SCHEMAS[kind].model_json_schema(by_alias=True)


def _explain(error: ValidationError, model: type[BaseModel], source: str) -> str:
    """Return one line for the first error: an unknown key if there is one, it explains others."""
    found = error.errors(include_url=False)
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    more = f" ({len(found) - 1} more)" if len(found) > 1 else ""
    keys, known = _walk(model, first["loc"])
    key = ".".join(keys)
    if first["type"] == "extra_forbidden":
        near = difflib.get_close_matches(keys[-1], known, n=1, cutoff=0.0)
        hint = f"; did you mean {near[0]!r}?" if near else "."
        return _one_line(f"{source}: key {key!r} is unknown{hint}{more}")
    if first["type"] == "missing":
        return _one_line(f"{source}: key {key!r} is missing.{more}")
    message = str(first["msg"]).removeprefix("Value error, ")
    if first["type"] == "model_type":
        message = "a mapping of its own keys is wanted"
    shown = ""
    if not isinstance(first["input"], dict | BaseModel):
        shown = f" (found {reprlib.repr(first['input'])[:80]})"
    where = f"key {key!r}: " if key else ""
    return _one_line(f"{source}: {where}{message}{shown}{more}")


def _walk(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[list[str], list[str]]:
    """Return the keys of the file along a location, and the keys known where the last one stands.

    A location holds also the kind by which pydantic chose among several models, which is no key.
    """
    here: list[type[BaseModel]] = [model]
    keys: list[str] = []
    known: list[str] = []
    for part in location:
        fields = [(f.alias or n, f.annotation) for m in here for n, f in m.model_fields.items()]
        inner = [annotation for name, annotation in fields if name == part]
        chosen = [m for m in here if len(here) > 1 and _kind_of(m) == part]
        if chosen and not inner:
            here = chosen
            continue
        keys.append(str(part))
        if isinstance(part, str):
            known = [name for name, _ in fields]
            here = [m for annotation in inner for m in _models_in(annotation)]
    return keys, known


def _kind_of(model: type[BaseModel]) -> str | None:
    field = model.model_fields.get("kind") or model.model_fields.get("driver")
    return None if field is None else str(typing.get_args(field.annotation)[0])


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for inner in typing.get_args(annotation) for m in _models_in(inner)]


def _one_line(text: str) -> str:
    return " ".join(text.split())
