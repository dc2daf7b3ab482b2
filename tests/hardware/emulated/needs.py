"""What a test needs of the machine: skipped with the reason at a desk, an error in CI."""

from __future__ import annotations

import os
import shutil

import pytest


def need(*programs: str, package: str) -> None:
    """Skip unless every program is there; where CI is set, its absence is a failure.

    Parameters
    ----------
    package : the Debian packages that bring them
    """
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        lack(f"{', '.join(missing)} not installed; run: sudo apt-get install {package}")


def lack(reason: str) -> None:
    """Skip for a reason at a desk, fail for it in CI."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)
