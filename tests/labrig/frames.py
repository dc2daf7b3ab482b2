"""Pictures on disk, as a manifest of an import names them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile


def frame(folder: Path, name: str, counts: np.ndarray, role: str, exposure_s: float, **more: Any):
    folder.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(folder / name, np.clip(np.rint(counts), 0, 4095).astype(np.uint16))
    return {"file": name, "role": role, "exposure_s": exposure_s, **more}
