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


def need_typelib(name: str, version: str, *, package: str) -> None:
    """Skip unless PyGObject and a typelib are there; where CI is set, that is a failure."""
    try:
        import gi  # noqa: PLC0415 - what is asked for

        gi.require_version(name, version)
    except (ImportError, ValueError) as error:
        lack(f"{name} {version} cannot be used ({error}); run: make hardware-packages ({package})")
