"""The V4L2 camera under the real uvcvideo: exposure that takes effect late, unplug and replug."""

import dataclasses
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from deadlines import far
from emulated.usb_vhci import VirtualPort
from emulated.uvc_camera import UvcCamera

from drivers.camera.latency import probe
from drivers.camera.protocol import CameraSettings
from drivers.camera.v4l2 import V4l2Camera, V4l2Settings
from drivers.errors import DeviceLostError, DeviceNotFoundError, SettingRefusedError
from drivers.transport.v4l2_device import video_devices
from drivers.waiting import CancelToken

NEVER = CancelToken()
SHAPE = (240, 320)
DELAY = 2


def light():
    """Stripes of four pixels, 10 000 counts a second where lit."""
    lit = np.arange(SHAPE[1]) // 4 % 2 * 1e4
    return np.broadcast_to(lit, SHAPE)


def found():
    return [path for path, info in video_devices() if "UVC" in info.card]


def plug():
    """Return the camera and its port, once the kernel has made a video node of it."""
    device = UvcCamera(light, width=SHAPE[1], height=SHAPE[0], delay=DELAY)
    port = VirtualPort(device)
    end = time.monotonic() + 90.0
    while not any("by-id" in path for path in found()) and time.monotonic() < end:
        time.sleep(0.2)
    assert found(), "uvcvideo did not take the camera"
    return device, port


@pytest.fixture(scope="module")
def plugged(load):
    load("vhci-hcd")
    load("uvcvideo")
    return plug()[1]


@pytest.fixture
def camera(plugged):
    opened = V4l2Camera(V4l2Settings(device=found()[0], exposure_latency_frames=DELAY))
    opened.open()
    yield opened
    opened.close()


def brightest(camera):
    return int(camera.collect(deadline_s=far(), cancel=NEVER).pixels.max())


def test_the_camera_is_found_by_its_id_and_made_manual(camera):
    assert Path(found()[0]).parent == Path("/dev/v4l/by-id")
    settings = camera.snapshot()
    assert settings["controls"]["auto_exposure"] == 1
    assert settings["pixel_format"] == "Y16"
    applied = camera.apply(CameraSettings(exposure_s=0.01))
    assert applied.exposure_s == pytest.approx(0.01, abs=1e-9)
    with pytest.raises(SettingRefusedError, match=r"outside 0.0001 .. 1 s"):
        camera.apply(CameraSettings(exposure_s=2.0))


def test_the_picture_is_exact_in_both_formats(camera):
    for name, scale in (("GREY", 1), ("Y16", 257)):
        camera.apply(CameraSettings(exposure_s=0.01, pixel_format=name))
        camera.arm("free-run")
        for _ in range(DELAY + 4):
            frame = camera.collect(deadline_s=far(), cancel=NEVER)
        np.testing.assert_array_equal(frame.pixels, np.rint(light() * 0.01 * scale))
        camera.disarm()


def test_compressed_pictures_are_refused_unless_allowed_and_are_then_marked(camera):
    with pytest.raises(SettingRefusedError, match="compressed"):
        camera.apply(CameraSettings(exposure_s=0.01, pixel_format="MJPG"))
    camera.close()
    settings = V4l2Settings(device=found()[0], pixel_format="MJPEG-luma")
    with pytest.raises(SettingRefusedError, match="choose one of: Y16, GREY"):
        V4l2Camera(settings).open()
    allowed = V4l2Camera(dataclasses.replace(settings, allow_uncalibrated=True))
    assert "MJPEG-luma" in allowed.open().formats
    assert "not proportional" in allowed.snapshot()["pixel_format_note"]
    allowed.apply(CameraSettings(exposure_s=0.01))
    allowed.arm("free-run")
    for _ in range(DELAY + 4):
        frame = allowed.collect(deadline_s=far(), cancel=NEVER)
    allowed.close()
    # stripes of four pixels through JPEG at quality 95
    assert np.abs(frame.pixels - light() * 0.01).max() < 12
    assert "compressed" in frame.extras["note"]


def test_the_probe_measures_how_late_an_exposure_acts(camera):
    measured = probe(camera, short_s=0.004, cancel=NEVER)
    # beside the camera's own delay: the frame under way, and the one of caution
    assert measured.least_frames >= DELAY
    assert DELAY + 1 <= measured.frames <= DELAY + 3


def test_after_the_latency_no_frame_has_the_old_exposure(camera):
    camera.apply(CameraSettings(exposure_s=0.004))
    latency = probe(camera, short_s=0.004, cancel=NEVER).frames
    camera.arm("free-run")
    for exposure_s in (0.02, 0.005, 0.015, 0.01):
        camera.apply(CameraSettings(exposure_s=exposure_s))
        camera.flush()
        early = [brightest(camera) for _ in range(latency)]
        after = [brightest(camera) for _ in range(3)]
        wanted = round(1e4 * exposure_s * 257)
        assert early[0] != wanted, "the emulated camera is too good: its exposure acts at once"
        assert after == [wanted] * 3


def test_unplugging_is_typed_and_replugging_mends_it(plugged):
    camera = V4l2Camera(V4l2Settings(device=found()[0]))
    camera.open()
    camera.arm("free-run")
    brightest(camera)
    threading.Timer(0.3, plugged.unplug).start()

    def go_on():
        limit = time.monotonic() + 90.0
        while time.monotonic() < limit:
            brightest(camera)

    with pytest.raises(DeviceLostError):
        go_on()
    camera.make_safe()
    camera.close()
    end = time.monotonic() + 90.0
    while found() and time.monotonic() < end:
        time.sleep(0.2)
    with pytest.raises(DeviceNotFoundError):
        camera.open()
    _, port = plug()
    camera.open()
    camera.arm("free-run")
    brightest(camera)
    camera.close()
    port.unplug()
