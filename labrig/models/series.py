"""Concentrations of the sessions of a dilution series."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from labrig.models.base import Model, NonNegative


class Concentrations(Model):
    """What each session of a series was filled with."""

    schema_: Literal["labrig-series/1"] = Field(alias="schema")
    unit: str = Field(min_length=1, description="of the concentrations, as ml/l")
    concentration: dict[str, NonNegative] = Field(
        min_length=1,
        description="by session folder, session id, or name of a simulated session's scene",
    )
