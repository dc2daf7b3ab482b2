"""Where the files are that come with the program, and where computed ones are kept."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def config_folder() -> Path:
    """Return the folder of the configurations that come with the program."""
    beside = Path(__file__).resolve().parents[1] / "configs"
    return beside if beside.is_dir() else Path(sys.prefix) / "share" / "labrig" / "configs"


def cache_folder() -> Path:
    """Return where computed responses are kept; everything in it can be deleted."""
    root = os.environ.get("LABRIG_CACHE") or os.environ.get("XDG_CACHE_HOME")
    base = Path(root) if root else Path.home() / ".cache"
    return base / "labrig"
