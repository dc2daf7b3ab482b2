"""Pixel formats as bytes on the wire, and what they become: (rows, cols) uint16 counts."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from drivers.errors import FrameCorruptError


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelFormat:
    """A format: its name, its four letters in V4L2, its depth and its bytes a pixel.

    ``note`` says what keeps its counts from being what the sensor saw; "" if nothing does.
    """

    name: str
    letters: str
    bits: int
    bytes_per_px: int
    note: str = ""

    @property
    def white_level_dn(self) -> int:
        """The count at which it clips."""
        return int(2**self.bits - 1)


GREY = PixelFormat(name="GREY", letters="GREY", bits=8, bytes_per_px=1)
Y10 = PixelFormat(name="Y10", letters="Y10", bits=10, bytes_per_px=2)
Y12 = PixelFormat(name="Y12", letters="Y12", bits=12, bytes_per_px=2)
Y16 = PixelFormat(name="Y16", letters="Y16", bits=16, bytes_per_px=2)
YUYV = PixelFormat(
    name="YUYV-luma",
    letters="YUYV",
    bits=8,
    bytes_per_px=2,
    note="luma mixed from colours by the camera",
)
MJPEG = PixelFormat(
    name="MJPEG-luma",
    letters="MJPG",
    bits=8,
    bytes_per_px=0,
    note="compressed: counts are not proportional to light",
)
MONO8 = PixelFormat(name="Mono8", letters="", bits=8, bytes_per_px=1)
MONO10 = PixelFormat(name="Mono10", letters="", bits=10, bytes_per_px=2)
MONO12 = PixelFormat(name="Mono12", letters="", bits=12, bytes_per_px=2)
MONO16 = PixelFormat(name="Mono16", letters="", bits=16, bytes_per_px=2)
GENICAM_FORMATS = (MONO16, MONO12, MONO10, MONO8)
V4L2_FORMATS = (Y16, Y12, Y10, GREY, YUYV, MJPEG)


def decode(
    raw: bytes | memoryview, fmt: PixelFormat, rows: int, cols: int, stride: int
) -> NDArray[np.uint16]:
    """Return the counts of a picture, owned and read-only.

    Parameters
    ----------
    stride : bytes from one row to the next

    Raises
    ------
    FrameCorruptError
        If bytes are missing, or a compressed picture cannot be decoded.
    """
    if fmt is MJPEG:
        return _decode_jpeg(bytes(raw), rows, cols)
    width = cols * fmt.bytes_per_px
    if len(raw) < stride * (rows - 1) + width:
        msg = (
            f"a frame of {cols}x{rows} {fmt.name} came with {len(raw)} bytes, "
            f"{stride * (rows - 1) + width} were wanted; check cable and bandwidth."
        )
        raise FrameCorruptError(msg)
    kind = np.dtype("<u2" if fmt.bytes_per_px == 2 and fmt is not YUYV else "u1")
    step = 2 if fmt is YUYV else kind.itemsize
    view = np.ndarray((rows, cols), kind, raw, 0, (stride, step))
    return _owned(view.astype(np.uint16))


def _decode_jpeg(raw: bytes, rows: int, cols: int) -> NDArray[np.uint16]:
    try:
        with Image.open(io.BytesIO(raw), formats=["JPEG"]) as picture:
            luma = np.asarray(picture.convert("L"), dtype=np.uint16)
    except (OSError, UnidentifiedImageError) as error:
        msg = f"a compressed frame of {len(raw)} bytes cannot be decoded; take another."
        raise FrameCorruptError(msg) from error
    if luma.shape != (rows, cols):
        msg = f"a compressed frame is {luma.shape}, {(rows, cols)} was wanted; take another."
        raise FrameCorruptError(msg)
    return _owned(luma.copy())


def _owned(pixels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    pixels.setflags(write=False)
    return pixels
