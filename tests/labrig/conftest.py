"""Sessions that many tests read or damage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from samples import write

Complaint = Callable[..., str]


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    return write(tmp_path)


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, shots=4, fail=True)
    return next(tmp_path.glob("*/*"))


@pytest.fixture
def complaint(command: Callable[..., Any]) -> Complaint:
    """Return ``complaint(*arguments, code=None)``: the one line with which a command fails."""

    def of(*arguments: object, code: int | None = None) -> str:
        said = command(*arguments)
        assert said.code != 0
        assert code is None or said.code == code
        assert said.err.startswith("labrig: "), said.err
        assert said.err.count("\n") == 1
        assert "Traceback" not in said.out
        return str(said.err)

    return of
