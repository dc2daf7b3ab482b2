"""The record of a projector's latency, as it was measured on a rig."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Literal

from pydantic import Field, model_validator

from labrig.models.base import Model, NonNegative


class LatencyRecord(Model):
    """When the light of a requested pattern has surely come, and is steady.

    ``earliest_s`` and ``latest_s`` are after the request; the latter is the 99.9 % bound of the
    flips and one refresh period.
    """

    schema_: Literal["labrig-latency/1"] = Field(alias="schema")
    date: str = Field(description="of the measurement, ISO 8601, UTC")
    earliest_s: NonNegative
    latest_s: NonNegative
    settle_s: NonNegative
    jitter_s: NonNegative = Field(description="standard deviation of the latency")
    flips: int = Field(ge=1)
    timestamps: Literal["start", "end", "unknown"] = Field(
        description="what the camera's time stamps were found to mean"
    )
    camera: str = Field(description="model and serial of the camera that looked")
    projector: str = Field(description="model and serial")

    @model_validator(mode="after")
    def _in_order(self) -> LatencyRecord:
        if self.earliest_s > self.latest_s:
            msg = f"earliest_s {self.earliest_s} is after latest_s {self.latest_s}"
            raise ValueError(msg)
        self.measured()
        return self

    def measured(self) -> datetime:
        """Return when it was measured."""
        try:
            moment = datetime.fromisoformat(self.date)
        except ValueError as error:
            msg = f"date {self.date!r} is no ISO 8601 date and time"
            raise ValueError(msg) from error
        return moment if moment.tzinfo else moment.replace(tzinfo=UTC)

    def age_h(self) -> float:
        """Return hours since it was measured."""
        return (datetime.now(UTC) - self.measured()).total_seconds() / 3600.0
