"""The V4L2 camera against the kernel's own test device, in every grey format, with every error."""

import subprocess
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from deadlines import ends_within, far, in_s

from drivers.camera.protocol import CameraSettings
from drivers.camera.v4l2 import V4l2Camera, V4l2Settings
from drivers.errors import (
    CancelledError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    FrameCorruptError,
    NoFrameError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.transport.v4l2_device import video_devices
from drivers.waiting import CancelToken

NEVER = CancelToken()
DEVICE, GRABBER = "/dev/video0", "/dev/video1"
WIDTH, HEIGHT = 640, 360
ALTERNATING_LINES = {"test_pattern": 16, "osd_text_mode": 2}


@pytest.fixture(scope="module", autouse=True)
def vivid(load):
    # a webcam, and an HDMI grabber, which alone can cut a region out
    words = ("n_devs=2", "num_inputs=1,1", "input_types=0x0,0x3", "node_types=0x1,0x1")
    load("vivid", *words)


def control(**values):
    for name, value in values.items():
        subprocess.run(["v4l2-ctl", "-d", DEVICE, "-c", f"{name}={value}"], check=True)


def camera_of(**keys):
    keys = {"size": (WIDTH, HEIGHT), "controls": ALTERNATING_LINES, **keys}
    camera = V4l2Camera(V4l2Settings(device=DEVICE, **keys))
    can = camera.open()
    return camera, can


@pytest.fixture
def camera():
    opened, _ = camera_of(pixel_format="GREY")
    yield opened
    opened.close()
    control(percentage_of_dropped_buffers=0, wrap_sequence_number=0)


def collect(camera, seconds=5.0):
    return camera.collect(deadline_s=in_s(seconds), cancel=NEVER)


@pytest.mark.parametrize(
    ("name", "bits", "most"),
    [("GREY", 8, 255), ("Y10", 10, 1023), ("Y12", 12, 4095), ("Y16", 16, 65535)],
)
def test_every_grey_format_gives_exact_stripes_in_its_range(name, bits, most):
    camera, can = camera_of(pixel_format=name)
    try:
        assert (can.bits, can.white_level_dn) == (bits, most)
        assert can.formats[0] == "Y16"
        assert name in can.formats
        camera.arm("free-run")
        pixels = collect(camera).pixels
        assert pixels.shape == (HEIGHT, WIDTH)
        assert pixels.dtype == np.uint16
        assert (pixels == pixels[0]).all()
        lines = pixels[0].astype(int)
        assert len({int(v) for v in lines[0::2]}) == len({int(v) for v in lines[1::2]}) == 1
        # limited range: black near 16/256 and white near 235/256 of the scale
        low, high = sorted((int(lines[0]), int(lines[1])))
        assert low <= 0.07 * most
        assert 0.9 * most <= high <= most
    finally:
        camera.close()


def test_luma_of_colours_is_marked_and_the_rest_refused(camera):
    camera.close()
    marked, _ = camera_of(pixel_format="YUYV-luma")
    assert "colours" in marked.snapshot()["pixel_format_note"]
    marked.close()
    with pytest.raises(SettingRefusedError, match="compressed"):
        camera_of(pixel_format="MJPG")
    with pytest.raises(SettingRefusedError, match="choose one of: Y16"):
        camera_of(pixel_format="RGB3")
    with pytest.raises(SettingRefusedError, match="has no control 'exposure'"):
        camera_of(controls={"exposure": 1})


def test_frames_are_numbered_stamped_and_bounded(camera):
    camera.arm("free-run")
    frames = [collect(camera) for _ in range(6)]
    assert (np.diff([f.sequence for f in frames]) >= 1).all()
    for frame in frames:
        assert frame.t_start_s < frame.t_end_s <= frame.t_arrival_s
        assert frame.t_arrival_s - frame.t_end_s < 2.0
        assert not frame.pixels.flags.writeable


def test_a_camera_without_exposure_control_says_what_it_has(camera):
    settings = camera.snapshot()
    assert not settings["exposure_control"]
    interval_s = settings["format"]["interval_s"]
    assert camera.apply(CameraSettings(exposure_s=interval_s)).exposure_s == interval_s
    with pytest.raises(SettingRefusedError, match="no exposure control"):
        camera.apply(CameraSettings(exposure_s=2 * interval_s))
    assert settings["controls"]["test_pattern"] == 16
    assert settings["controls"]["gain_automatic"] == 0


def test_a_region_is_refused_where_the_camera_offers_none(camera):
    interval_s = camera.snapshot()["format"]["interval_s"]
    with pytest.raises(SettingRefusedError, match="offers none"):
        camera.apply(CameraSettings(exposure_s=interval_s, roi=(64, 32, 320, 180)))
    camera.arm("free-run")
    assert collect(camera).pixels.shape == (HEIGHT, WIDTH)


def test_a_region_is_cut_out_where_the_camera_offers_it_and_given_back():
    camera = V4l2Camera(V4l2Settings(device=GRABBER, pixel_format="GREY"))
    can = camera.open()
    try:
        interval_s = camera.snapshot()["format"]["interval_s"]
        applied = camera.apply(CameraSettings(exposure_s=interval_s, roi=(64, 32, 320, 180)))
        assert applied.roi == (64, 32, 320, 180)
        camera.arm("free-run")
        assert collect(camera).pixels.shape == (180, 320)
        with pytest.raises(SettingRefusedError, match="while it streams"):
            camera.apply(CameraSettings(exposure_s=interval_s))
        camera.disarm()
        with pytest.raises(SettingRefusedError, match="region"):
            camera.apply(CameraSettings(exposure_s=interval_s, roi=(0, 0, 99999, 180)))
    finally:
        camera.close()
    again = V4l2Camera(V4l2Settings(device=GRABBER, size=(can.cols, can.rows)))
    assert again.open().rows == can.rows
    again.close()


def test_flush_empties_and_later_frames_are_newer(camera):
    camera.arm("free-run")
    collect(camera)
    time.sleep(0.5)
    flushed = camera.flush()
    assert flushed.discarded >= 1
    assert collect(camera).sequence > flushed.last_sequence


def test_dropped_frames_are_seen_as_gaps(camera):
    control(percentage_of_dropped_buffers=50)
    camera.arm("free-run")
    frames = [collect(camera) for _ in range(12)]
    gaps = np.diff([f.sequence for f in frames]) - 1
    assert gaps.sum() > 0
    lost = [f.extras["lost_before"] for f in frames[1:]]
    assert lost == gaps.tolist()


def test_a_sequence_number_that_wraps_goes_on_rising(camera):
    control(wrap_sequence_number=1)
    camera.arm("free-run")
    numbers = [collect(camera).sequence for _ in range(5)]
    assert (np.diff(numbers) >= 1).all()


def test_a_buffer_marked_faulty_is_never_a_frame(camera):
    camera.arm("free-run")
    collect(camera)
    control(inject_v4l2_buf_flag_error=1)

    def collect_some():
        for _ in range(8):
            collect(camera)

    with pytest.raises(FrameCorruptError, match="marked faulty"):
        collect_some()
    collect(camera)


@pytest.mark.parametrize("name", ["inject_vidioc_qbuf_error", "inject_fatal_streaming_error"])
def test_a_stream_that_breaks_is_a_lost_device_and_mended_by_opening_again(camera, name):
    camera.arm("free-run")
    collect(camera)
    control(**{name: 1})

    def collect_some():
        for _ in range(12):
            collect(camera)

    with pytest.raises(DeviceLostError, match="broke"):
        collect_some()
    camera.close()
    camera.open()
    camera.arm("free-run")
    collect(camera)


@pytest.mark.parametrize("name", ["inject_vidioc_reqbufs_error", "inject_vidioc_streamon_error"])
def test_a_stream_that_does_not_start_is_refused(camera, name):
    control(**{name: 1})
    with pytest.raises(SettingRefusedError, match="could not start"):
        camera.arm("free-run")
    camera.arm("free-run")
    collect(camera)


def test_deadline_and_cancel_are_kept(camera):
    camera.arm("free-run")
    collect(camera)
    control(percentage_of_dropped_buffers=100)
    camera.flush()
    for _ in range(6):  # the frames that were under way
        with suppress(NoFrameError):
            collect(camera, seconds=1.0)

    def keep_the_deadline():
        with pytest.raises(NoFrameError, match="before the deadline"):
            collect(camera, seconds=1.0)

    def hear_the_cancel():
        cancel = CancelToken()
        threading.Timer(0.2, cancel.cancel, ["enough"]).start()
        with pytest.raises(CancelledError):
            camera.collect(deadline_s=far(), cancel=cancel)

    assert ends_within(1.2, keep_the_deadline, least_s=1.0)
    # emulated processors: 0.2 s of the protocol and as much for the scheduler
    assert ends_within(0.2 + 0.4, hear_the_cancel)


def test_the_device_has_one_stream_and_one_owner(camera):
    camera.arm("free-run")
    with pytest.raises(DeviceBusyError, match="open already"):
        camera.open()
    other = V4l2Camera(V4l2Settings(device=DEVICE, pixel_format="Y16", size=(WIDTH, HEIGHT)))
    with pytest.raises(DeviceBusyError, match="streams for another program"):
        other.open()
    camera.close()
    camera.close()
    with pytest.raises(NotOpenError):
        collect(camera)


def test_what_is_there_is_listed_and_what_is_not_is_said(tmp_path):
    assert [path for path, _ in video_devices()] == [DEVICE, GRABBER]
    for path in ("/dev/video9", "/dev/null"):
        with pytest.raises(DeviceNotFoundError):
            V4l2Camera(V4l2Settings(device=path)).open()


def test_disconnecting_is_an_error_of_its_own(camera):
    camera.arm("free-run")
    collect(camera)
    control(disconnect=1)

    def collect_some():
        for _ in range(12):
            collect(camera)

    with pytest.raises(DeviceLostError, match=r"gone|broke"):
        collect_some()
    camera.make_safe()
