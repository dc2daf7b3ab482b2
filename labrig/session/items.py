"""What a session is given to keep, and the count of what it holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Item:
    """What shall stand in the journal: a frame to be kept, or an event without one."""

    event: Literal["commit", "reject", "drop", "note", "pause", "resume", "segment", "void"]
    shot: str = ""
    attempt: int = 0
    pixels: NDArray[np.uint16] | None = None
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Progress:
    """What a session holds so far, by shot: the attempt that counts, and the last one made."""

    saved: dict[str, int] = field(default_factory=dict)
    last_attempt: dict[str, int] = field(default_factory=dict)
    rejected: set[tuple[str, int]] = field(default_factory=set)
    n_dropped: int = 0
    n_lines: int = 0
    segment: int = 1
    journal_bytes: int = 0
