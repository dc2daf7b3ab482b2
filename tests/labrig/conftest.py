"""Sessions that many tests read or damage."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples import write


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    return write(tmp_path)


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, shots=4, fail=True)
    return next(tmp_path.glob("*/*"))
