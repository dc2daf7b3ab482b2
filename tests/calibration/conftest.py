"""Real captures, and a camera whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

Counts = np.ndarray


class Ccd:
    """The EMVA 1288 reference set: counts by kind (b, d), exposure in ms and number of frames."""

    def __init__(self, folder: Path) -> None:
        self.files: dict[tuple[str, float, int], list[Path]] = {}
        current: list[Path] = []
        kinds: list[tuple[str, float, list[Path]]] = []
        for line in (folder / "EMVA1288_Data_subset.txt").read_text().splitlines():
            part = line.split()
            if part and part[0] in ("b", "d"):
                current = []
                kinds.append((part[0], round(float(part[1]) * 1e-6, 3), current))
            elif part and part[0] == "i":
                current.append(folder / part[1])
        for kind, exposure_ms, files in kinds:
            self.files[kind, exposure_ms, len(files)] = files

    def exposures_ms(self) -> list[float]:
        return sorted({t for kind, t, n in self.files if n == 2 and kind == "b"})

    def read(self, kind: str, exposure_ms: float, n: int = 2) -> list[Counts]:
        return [
            np.asarray(Image.open(file), dtype=np.uint16)
            for file in self.files[kind, exposure_ms, n]
        ]


@pytest.fixture(scope="session")
def ccd(real_data: Path) -> Ccd:
    """A real 12-bit CCD, 22 exposures of uniform light."""
    folder = real_data / "emva1288_ccd12"
    if not folder.is_dir():
        pytest.skip(f"no EMVA 1288 reference set: {folder} is no folder")
    return Ccd(folder)


@pytest.fixture(scope="session")
def stripes_on_paper(real_data: Path) -> list[Counts]:
    """Forty Grey-code pictures of paper, plain and inverse by turns, then white and black."""
    folder = real_data / "procam_stripes" / "capture_0"
    return [
        np.asarray(Image.open(folder / f"graycode_{k:02d}.png"), dtype=np.uint16) for k in range(42)
    ]
