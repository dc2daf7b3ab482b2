"""The command that prints JSON Schemas."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from labrig.cli.say import say_json
from labrig.config import json_schema


class SchemaKind(StrEnum):
    """Kinds of configuration files."""

    plan = "plan"
    rig = "rig"
    scene = "scene"
    analysis = "analysis"
    import_ = "import"
    board = "board"
    calibration = "calibration"


def schema(kind: Annotated[SchemaKind, typer.Argument(help="Kind of file.")]) -> None:
    """Print the JSON Schema of a configuration file."""
    say_json(json_schema(kind.value))
