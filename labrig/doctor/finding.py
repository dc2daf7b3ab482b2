"""One thing that `labrig doctor` looked at."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing looked at.

    ``remedy`` is the command or deed that mends it; without what is ``needed`` the rig, or labrig
    itself, does not run.
    """

    name: str
    ok: bool
    text: str
    remedy: str = ""
    needed: bool = False
