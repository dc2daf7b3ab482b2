"""Makes a session of pictures taken elsewhere."""

from __future__ import annotations

import hashlib
import io
import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from labrig.config import load
from labrig.errors import ConfigError
from labrig.models.manifest import ImportFrame, ImportManifest
from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import SessionWriter

TIFF_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def import_session(
    manifest: Path,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Read the image files a manifest names and return the sealed session folder.

    File names are relative to the manifest. PNG, TIFF and BMP of 8 or 16 bit, grey.

    Raises
    ------
    ConfigError
        If the manifest does not fit its schema, or an image is missing, damaged, coloured, of
        another size, or brighter than the declared bits can hold.
    """
    wanted = load(manifest, ImportManifest)
    shots = _shots(wanted.frames, manifest)
    pictures = [_read(manifest, frame) for frame in wanted.frames]
    _refuse_misfits(pictures, wanted, manifest)
    setup = Setup.model_validate(
        wanted.model_dump(include=set(Setup.model_fields)), from_attributes=False
    )
    header = {
        "manifest": wanted.model_dump(mode="json", by_alias=True),
        "setup": setup.model_dump(mode="json"),
        "imported": True,
        "simulated": False,
        "calibration": {
            kind: str((manifest.parent / path).resolve())
            for kind, path in wanted.calibration.items()
        },
        "shots": [shot.model_dump() for shot in shots],
    }
    with SessionWriter.create(out, wanted.name, header) as session:
        for number, (shot, frame, pixels) in enumerate(
            zip(shots, wanted.frames, pictures, strict=True), start=1
        ):
            source = manifest.parent / frame.file
            details = {
                "source": frame.file,
                "source_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
                "exposure_asked_s": frame.exposure_s,
                "proof": "imported",
            }
            session.commit(shot.id, 1, pixels, details)
            if progress is not None:
                progress(number, len(shots))
        session.close()
    return session.path


def _shots(frames: tuple[ImportFrame, ...], manifest: Path) -> list[Shot]:
    """Return one shot a frame, named as a plan would name it."""
    exposures = sorted({frame.exposure_s for frame in frames})
    counts: dict[tuple[Any, ...], int] = {}
    shots = []
    for frame in frames:
        bracket = exposures.index(frame.exposure_s)
        kind = (
            frame.role,
            bracket,
            frame.shift,
            frame.axis,
            frame.bit,
            frame.polarity,
            frame.level,
        )
        repeat = counts.get(kind, 0)
        counts[kind] = repeat + 1
        group = f"{frame.role}-e{bracket}-r{repeat}"
        shots.append(
            Shot(
                id=f"{group}{_which(frame)}",
                set=frame.role,
                role=frame.role,
                group=group,
                exposure_s=frame.exposure_s,
                repeat=repeat,
                shift=frame.shift,
                shifts=frame.shifts,
                axis=frame.axis,
                bit=frame.bit,
                polarity=frame.polarity,
                level=frame.level,
            )
        )
    _refuse_gaps(frames, manifest)
    return shots


def _which(frame: ImportFrame) -> str:
    """Return what tells pictures of one group apart, as the end of a shot's id."""
    if frame.shift is not None:
        return f"-p{frame.shift:02d}"
    if frame.bit is not None:
        return f"-{frame.axis}{frame.bit:02d}-{frame.polarity}"
    return "" if frame.level is None else f"-l{round(1e4 * frame.level):05d}"


def _refuse_gaps(frames: tuple[ImportFrame, ...], manifest: Path) -> None:
    stripes = [frame for frame in frames if frame.role == "stripes"]
    counted = {frame.shifts for frame in stripes}
    if len(counted) > 1:
        msg = f"{manifest}: stripes of {sorted(map(str, counted))} shifts; give one series."
        raise ConfigError(msg)
    n_shifts = counted.pop() if counted else None
    absent = sorted(set(range(n_shifts or 0)) - {frame.shift for frame in stripes})
    if absent:
        msg = f"{manifest}: shift {absent[0]} of {n_shifts} is missing; give all shifts."
        raise ConfigError(msg)


def _read(manifest: Path, frame: ImportFrame) -> NDArray[np.uint16]:
    """Return one grey picture; a damaged file is refused, never filled up."""
    path = manifest.parent / frame.file
    where = f"{manifest}: frame {frame.file}"
    try:
        encoded = path.read_bytes()
    except FileNotFoundError as error:
        msg = f"{where} does not exist; mend the path, which is relative to the manifest."
        raise ConfigError(msg) from error
    except OSError as error:
        msg = f"{where} cannot be read ({error.strerror}); mend it."
        raise ConfigError(msg) from error
    try:
        picture = _decode(encoded)
    except Exception as error:  # the decoders have no common base for what a broken file raises
        reason = " ".join(str(error).split()) or type(error).__name__
        msg = f"{where} is no readable PNG, TIFF or BMP ({reason}); is the file complete?"
        raise ConfigError(msg) from error
    if picture.ndim == 3 and picture.shape[2] in (2, 3, 4):
        colours = picture[..., : 1 if picture.shape[2] == 2 else 3]
        if (colours != colours[..., :1]).any():
            msg = f"{where} is in colour; give the grey picture of one channel."
            raise ConfigError(msg)
        picture = colours[..., 0]
    if picture.ndim != 2 or picture.dtype not in (np.uint8, np.uint16):
        msg = (
            f"{where} holds {picture.dtype} of shape {picture.shape}; one grey picture of 8 or "
            "16 bit is wanted."
        )
        raise ConfigError(msg)
    return np.ascontiguousarray(picture, dtype=np.uint16)


def _decode(encoded: bytes) -> NDArray[Any]:
    """Return the pixels of a TIFF, PNG or BMP; both decoders refuse what is cut or damaged."""
    file = io.BytesIO(encoded)
    if not encoded.startswith((*TIFF_MAGIC, b"\x89PNG", b"BM")):
        msg = "its first bytes are of another kind"
        raise ValueError(msg)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if encoded[:4] in TIFF_MAGIC:
            return np.asarray(_read_tiff(file))
        with Image.open(file, formats=("PNG", "BMP")) as image:
            image.verify()  # the checksum of every PNG chunk
        with Image.open(file, formats=("PNG", "BMP")) as image:
            # A palette is the usual form of a grey BMP.
            return np.asarray(image.convert("RGB") if image.mode == "P" else image)


def _read_tiff(file: io.BytesIO) -> NDArray[Any]:
    log = logging.getLogger("tifffile")
    heard, log.disabled = log.disabled, True  # what it complains of, it also raises
    try:
        return np.asarray(tifffile.imread(file))
    finally:
        log.disabled = heard


def _refuse_misfits(
    pictures: list[NDArray[np.uint16]], wanted: ImportManifest, manifest: Path
) -> None:
    first = pictures[0].shape
    bits = wanted.camera.bits
    for frame, picture in zip(wanted.frames, pictures, strict=True):
        if picture.shape != first:
            msg = (
                f"{manifest}: frame {frame.file} is {picture.shape[1]} x {picture.shape[0]} px, "
                f"{wanted.frames[0].file} is {first[1]} x {first[0]}; all must be equal."
            )
            raise ConfigError(msg)
        if int(picture.max()) >= 2**bits:
            msg = (
                f"{manifest}: frame {frame.file} holds {int(picture.max())} DN, more than "
                f"camera.bits = {bits} can; declare the right bits (data are right-aligned)."
            )
            raise ConfigError(msg)
    region = wanted.geometry.region_px
    if region is not None and (
        region[0] + region[2] > first[1] or region[1] + region[3] > first[0]
    ):
        msg = (
            f"{manifest}: geometry.region_px {list(region)} leaves the picture of "
            f"{first[1]} x {first[0]} px."
        )
        raise ConfigError(msg)
