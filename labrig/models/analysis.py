"""How a session is analysed."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from analysis.phase_function import UNRESOLVED
from labrig.models.base import Model, Positive

STAGES = (
    "linearise",
    "rectify",
    "separate",
    "attenuate",
    "stripes",
    "bounces",
    "invert",
    "write",
)


class Analysis(Model):
    """How a session is analysed."""

    schema_: Literal["labrig-analysis/1"] = Field(alias="schema")
    separation: Literal["auto", "extrema", "known-pattern", "harmonic"] = "auto"
    phase: Literal["hg-plane", "hg-paper"] = "hg-plane"
    cell_mm: Positive = Field(1.0, description="grid of the forward solver")
    n_theta: int = Field(64, ge=8, multiple_of=4)
    n_bounces: int = Field(12, ge=2, le=400)
    g_range: tuple[float, float] = Field((-0.5, 0.8))
    n_g: int = Field(7, ge=3, le=64, description="Chebyshev nodes in g")
    depth_range_mm: tuple[float, float] | None = Field(None, description="of Eq. 9; else chosen")

    slab_table: Literal["none", "kept"] = Field(
        "none",
        description="kept: the transport of a layer is solved once for media like the one found, "
        "and kept, so that fits of further sessions look it up",
    )
    calibration: dict[str, str] = Field(
        default_factory=dict,
        description="record folders by kind, relative to this file; they take precedence over the "
        "session's own",
    )

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Analysis:
        low, high = self.g_range
        if not -1.0 < low < high < 1.0:
            msg = f"g_range {[low, high]} is not -1 < low < high < 1"
            raise ValueError(msg)
        if max(-low, high) ** (self.n_theta // 2) > UNRESOLVED:
            msg = f"n_theta = {self.n_theta} angles cannot resolve g_range {[low, high]}; use more"
            raise ValueError(msg)
        if (
            self.depth_range_mm is not None
            and not 0 <= self.depth_range_mm[0] < (self.depth_range_mm[1])
        ):
            msg = f"depth_range_mm {list(self.depth_range_mm)} is not 0 <= from < to"
            raise ValueError(msg)
        return self
