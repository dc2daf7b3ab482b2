"""The structures and request numbers of V4L2 are those of this machine's kernel headers."""

import ctypes
import subprocess

import pytest
from emulated.needs import need

from drivers.transport import v4l2_ioctl as v4l2

STRUCTURES = {
    "v4l2_capability": v4l2.Capability,
    "v4l2_fmtdesc": v4l2.FormatDescription,
    "v4l2_pix_format": v4l2.PixelFormat,
    "v4l2_format": v4l2.Format,
    "v4l2_streamparm": v4l2.StreamParameters,
    "v4l2_requestbuffers": v4l2.RequestBuffers,
    "v4l2_buffer": v4l2.Buffer,
    "v4l2_queryctrl": v4l2.QueryControl,
    "v4l2_control": v4l2.Control,
    "v4l2_selection": v4l2.Selection,
}
OFFSETS = {
    ("v4l2_buffer", "timestamp"): v4l2.Buffer.timestamp.offset,
    ("v4l2_buffer", "sequence"): v4l2.Buffer.sequence.offset,
    ("v4l2_buffer", "m"): v4l2.Buffer.m.offset,
    ("v4l2_buffer", "length"): v4l2.Buffer.length.offset,
    ("v4l2_format", "fmt"): v4l2.Format.fmt.offset,
    ("v4l2_queryctrl", "flags"): v4l2.QueryControl.flags.offset,
    ("v4l2_streamparm", "parm.capture.timeperframe"): v4l2.StreamParameters.numerator.offset,
    ("v4l2_selection", "r"): v4l2.Selection.rectangle.offset,
    ("v4l2_fmtdesc", "pixelformat"): v4l2.FormatDescription.pixelformat.offset,
    ("v4l2_capability", "device_caps"): v4l2.Capability.device_caps.offset,
}
NUMBERS = {
    "VIDIOC_QUERYCAP": v4l2.QUERYCAP,
    "VIDIOC_ENUM_FMT": v4l2.ENUM_FMT,
    "VIDIOC_G_FMT": v4l2.G_FMT,
    "VIDIOC_S_FMT": v4l2.S_FMT,
    "VIDIOC_REQBUFS": v4l2.REQBUFS,
    "VIDIOC_QUERYBUF": v4l2.QUERYBUF,
    "VIDIOC_QBUF": v4l2.QBUF,
    "VIDIOC_DQBUF": v4l2.DQBUF,
    "VIDIOC_STREAMON": v4l2.STREAMON,
    "VIDIOC_STREAMOFF": v4l2.STREAMOFF,
    "VIDIOC_G_PARM": v4l2.G_PARM,
    "VIDIOC_G_CTRL": v4l2.G_CTRL,
    "VIDIOC_S_CTRL": v4l2.S_CTRL,
    "VIDIOC_QUERYCTRL": v4l2.QUERYCTRL,
    "VIDIOC_G_SELECTION": v4l2.G_SELECTION,
    "VIDIOC_S_SELECTION": v4l2.S_SELECTION,
    "V4L2_BUF_FLAG_ERROR": v4l2.BUF_FLAG_ERROR,
    "V4L2_BUF_FLAG_TIMESTAMP_MASK": v4l2.TIMESTAMP_MASK,
    "V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC": v4l2.TIMESTAMP_MONOTONIC,
    "V4L2_BUF_FLAG_TSTAMP_SRC_MASK": v4l2.TSTAMP_SRC_MASK,
    "V4L2_BUF_FLAG_TSTAMP_SRC_SOE": v4l2.TSTAMP_SRC_SOE,
    "V4L2_CTRL_FLAG_NEXT_CTRL": v4l2.CTRL_NEXT,
    "V4L2_CTRL_FLAG_INACTIVE": v4l2.CTRL_FLAG_INACTIVE,
    "V4L2_CTRL_FLAG_READ_ONLY": v4l2.CTRL_FLAG_READ_ONLY,
    "V4L2_SEL_TGT_CROP_BOUNDS": v4l2.SEL_TGT_CROP_BOUNDS,
    "V4L2_CAP_STREAMING": v4l2.CAP_STREAMING,
    "V4L2_CAP_DEVICE_CAPS": v4l2.CAP_DEVICE_CAPS,
    "V4L2_PIX_FMT_GREY": v4l2.fourcc("GREY"),
    "V4L2_PIX_FMT_Y10": v4l2.fourcc("Y10"),
    "V4L2_PIX_FMT_Y12": v4l2.fourcc("Y12"),
    "V4L2_PIX_FMT_Y16": v4l2.fourcc("Y16"),
    "V4L2_PIX_FMT_YUYV": v4l2.fourcc("YUYV"),
    "V4L2_PIX_FMT_MJPEG": v4l2.fourcc("MJPG"),
}


@pytest.fixture(scope="module")
def header(tmp_path_factory):
    """What a C compiler makes of linux/videodev2.h: expression to value."""
    need("gcc", package="gcc libc6-dev linux-libc-dev")
    folder = tmp_path_factory.mktemp("layout")
    expressions = [f"sizeof(struct {name})" for name in STRUCTURES]
    expressions += [f"offsetof(struct {name}, {field})" for name, field in OFFSETS]
    expressions += list(NUMBERS)
    lines = "".join(f'printf("%llu\\n", (unsigned long long)({e}));\n' for e in expressions)
    source = folder / "layout.c"
    source.write_text(
        "#include <stddef.h>\n#include <stdio.h>\n#include <linux/videodev2.h>\n"
        f"int main(void) {{\n{lines}return 0;\n}}\n"
    )
    subprocess.run(["gcc", str(source), "-o", str(folder / "layout")], check=True)
    out = subprocess.run([str(folder / "layout")], check=True, capture_output=True, text=True)
    return dict(zip(expressions, map(int, out.stdout.split()), strict=True))


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_have_the_size_of_the_headers(header, name):
    assert ctypes.sizeof(STRUCTURES[name]) == header[f"sizeof(struct {name})"]


@pytest.mark.parametrize(("name", "field"), OFFSETS)
def test_fields_lie_where_the_headers_have_them(header, name, field):
    assert OFFSETS[name, field] == header[f"offsetof(struct {name}, {field})"]


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_those_of_the_headers(header, name):
    assert NUMBERS[name] == header[name]
