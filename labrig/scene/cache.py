"""Where computed light is kept."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return where computed responses are kept; everything in it can be deleted."""
    root = os.environ.get("LABRIG_CACHE") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    return base / "labrig"
