"""The few V4L2 calls that a camera needs, as the kernel's videodev2.h has them (64-bit Linux)."""

from __future__ import annotations

import ctypes as ct
import fcntl
import mmap
import os
import select

CAPTURE, MMAP = 1, 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_MEMORY_MMAP
CAP_VIDEO_CAPTURE, CAP_STREAMING, CAP_DEVICE_CAPS = 0x1, 0x04000000, 0x80000000
BUF_FLAG_ERROR = 0x40
TIMESTAMP_MASK, TIMESTAMP_MONOTONIC = 0xE000, 0x2000
TSTAMP_SRC_MASK, TSTAMP_SRC_SOE = 0x70000, 0x10000
FIELD_NONE = 1
SEL_TGT_CROP, SEL_TGT_CROP_DEFAULT, SEL_TGT_CROP_BOUNDS = 0, 1, 2
CTRL_FLAG_DISABLED, CTRL_FLAG_GRABBED, CTRL_FLAG_READ_ONLY = 0x1, 0x2, 0x4
CTRL_FLAG_INACTIVE, CTRL_FLAG_WRITE_ONLY = 0x10, 0x40
CTRL_NEXT = 0x80000000


class Capability(ct.Structure):
    """struct v4l2_capability."""

    _fields_ = [
        ("driver", ct.c_char * 16),
        ("card", ct.c_char * 32),
        ("bus_info", ct.c_char * 32),
        ("version", ct.c_uint32),
        ("capabilities", ct.c_uint32),
        ("device_caps", ct.c_uint32),
        ("reserved", ct.c_uint32 * 3),
    ]


class FormatDescription(ct.Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = [
        ("index", ct.c_uint32),
        ("type", ct.c_uint32),
        ("flags", ct.c_uint32),
        ("description", ct.c_char * 32),
        ("pixelformat", ct.c_uint32),
        ("mbus_code", ct.c_uint32),
        ("reserved", ct.c_uint32 * 3),
    ]


class PixelFormat(ct.Structure):
    """struct v4l2_pix_format."""

    _fields_ = [
        (name, ct.c_uint32)
        for name in (
            *("width", "height", "pixelformat", "field", "bytesperline", "sizeimage"),
            *("colorspace", "priv", "flags", "ycbcr_enc", "quantization", "xfer_func"),
        )
    ]


class _FormatUnion(ct.Union):
    # The kernel's union also holds a struct with pointers, which aligns it to eight bytes.
    _fields_ = [("pix", PixelFormat), ("raw", ct.c_uint8 * 200), ("align", ct.c_uint64)]


class Format(ct.Structure):
    """struct v4l2_format."""

    _fields_ = [("type", ct.c_uint32), ("fmt", _FormatUnion)]


class StreamParameters(ct.Structure):
    """struct v4l2_streamparm, of the capture kind."""

    _fields_ = [
        ("type", ct.c_uint32),
        ("capability", ct.c_uint32),
        ("capturemode", ct.c_uint32),
        ("numerator", ct.c_uint32),
        ("denominator", ct.c_uint32),
        ("extendedmode", ct.c_uint32),
        ("readbuffers", ct.c_uint32),
        ("rest", ct.c_uint8 * 176),
    ]


class RequestBuffers(ct.Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = [
        ("count", ct.c_uint32),
        ("type", ct.c_uint32),
        ("memory", ct.c_uint32),
        ("capabilities", ct.c_uint32),
        ("flags", ct.c_uint8),
        ("reserved", ct.c_uint8 * 3),
    ]


class TimeVal(ct.Structure):
    """struct timeval."""

    _fields_ = [("tv_sec", ct.c_long), ("tv_usec", ct.c_long)]


class _BufferUnion(ct.Union):
    _fields_ = [("offset", ct.c_uint32), ("userptr", ct.c_ulong)]


class Buffer(ct.Structure):
    """struct v4l2_buffer."""

    _fields_ = [
        ("index", ct.c_uint32),
        ("type", ct.c_uint32),
        ("bytesused", ct.c_uint32),
        ("flags", ct.c_uint32),
        ("field", ct.c_uint32),
        ("timestamp", TimeVal),
        ("timecode", ct.c_uint8 * 16),
        ("sequence", ct.c_uint32),
        ("memory", ct.c_uint32),
        ("m", _BufferUnion),
        ("length", ct.c_uint32),
        ("reserved2", ct.c_uint32),
        ("request_fd", ct.c_int32),
    ]


class QueryControl(ct.Structure):
    """struct v4l2_queryctrl."""

    _fields_ = [
        ("id", ct.c_uint32),
        ("type", ct.c_uint32),
        ("name", ct.c_char * 32),
        ("minimum", ct.c_int32),
        ("maximum", ct.c_int32),
        ("step", ct.c_int32),
        ("default_value", ct.c_int32),
        ("flags", ct.c_uint32),
        ("reserved", ct.c_uint32 * 2),
    ]


class Control(ct.Structure):
    """struct v4l2_control."""

    _fields_ = [("id", ct.c_uint32), ("value", ct.c_int32)]


class Selection(ct.Structure):
    """struct v4l2_selection; ``rectangle`` is left, top, width, height."""

    _fields_ = [
        ("type", ct.c_uint32),
        ("target", ct.c_uint32),
        ("flags", ct.c_uint32),
        ("rectangle", ct.c_int32 * 4),
        ("reserved", ct.c_uint32 * 9),
    ]


def _request(direction: int, number: int, structure: type[ct.Structure] | type[ct.c_int]) -> int:
    return direction << 30 | ct.sizeof(structure) << 16 | ord("V") << 8 | number


_READ, _WRITE, _BOTH = 2, 1, 3
QUERYCAP = _request(_READ, 0, Capability)
ENUM_FMT = _request(_BOTH, 2, FormatDescription)
G_FMT = _request(_BOTH, 4, Format)
S_FMT = _request(_BOTH, 5, Format)
REQBUFS = _request(_BOTH, 8, RequestBuffers)
QUERYBUF = _request(_BOTH, 9, Buffer)
QBUF = _request(_BOTH, 15, Buffer)
DQBUF = _request(_BOTH, 17, Buffer)
STREAMON = _request(_WRITE, 18, ct.c_int)
STREAMOFF = _request(_WRITE, 19, ct.c_int)
G_PARM = _request(_BOTH, 21, StreamParameters)
G_CTRL = _request(_BOTH, 27, Control)
S_CTRL = _request(_BOTH, 28, Control)
QUERYCTRL = _request(_BOTH, 36, QueryControl)
G_SELECTION = _request(_BOTH, 94, Selection)
S_SELECTION = _request(_BOTH, 95, Selection)


def fourcc(name: str) -> int:
    """Return the number of a four-letter pixel format."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


def fourcc_name(number: int) -> str:
    """Return the letters of a pixel format, without trailing blanks."""
    return number.to_bytes(4, "little").decode("ascii", "replace").rstrip()


class VideoNode:
    """A video device of the kernel, opened without blocking. Every call may raise OSError."""

    def __init__(self, path: str) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def call(self, request: int, argument: ct.Structure) -> None:
        """Make one ioctl; the argument is read and overwritten."""
        fcntl.ioctl(self._descriptor, request, argument)

    def switch(self, *, on: bool) -> None:
        """Start or stop the stream."""
        fcntl.ioctl(self._descriptor, STREAMON if on else STREAMOFF, CAPTURE.to_bytes(4, "little"))

    def map(self, length: int, offset: int) -> mmap.mmap:
        """Return a buffer of the kernel as memory."""
        flags, protection = mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE
        return mmap.mmap(self._descriptor, length, flags, protection, offset=offset)

    def wait(self, seconds: float) -> bool:
        """Return whether a buffer, or news of the device's end, came within a time."""
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN | select.POLLPRI)
        return bool(poll.poll(max(seconds, 0.0) * 1e3))

    def close(self) -> None:
        """Close the device; harmless if done twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)
