"""A live picture kept on the disk, in its raw counts."""

from __future__ import annotations

import time
from pathlib import Path

from labrig.station.door import Level, Picture


def keep(picture: Picture, folder: Path) -> tuple[Level, str]:
    """Write a 16-bit TIFF named by the time; return what to say of it in the log."""
    import tifffile  # noqa: PLC0415 - for a snap alone

    path = folder / time.strftime("%Y-%m-%d-%H%M%S.tif")
    about = f"exposure {picture.exposure_s} s, {picture.shows}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(path, picture.pixels, description=about)
    except OSError as error:
        return "error", f"{path} cannot be written ({error.strerror or error})"
    return "info", f"kept {path}, {about}"
