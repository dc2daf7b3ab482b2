"""The GenICam camera as USB3 Vision: real Aravis and libusb, registers and stream emulated."""

import gc
import threading
import time

import numpy as np
import pytest
from deadlines import far, in_s
from emulated.u3v_camera import U3vCamera
from emulated.usb_umockdev import UsbBus

from drivers.camera.genicam import GenicamCamera, GenicamSettings
from drivers.camera.genicam_library import aravis
from drivers.camera.protocol import CameraSettings
from drivers.errors import DeviceLostError, FrameCorruptError, NoFrameError, SettingRefusedError
from drivers.waiting import CancelToken

NEVER = CancelToken()


def light(rows, cols):
    """Stripes of four pixels; full scale in 20 ms where lit."""
    return np.broadcast_to(np.arange(cols) // 4 % 2 * 50.0, (rows, cols))


@pytest.fixture(scope="module")
def plugged():
    bus = UsbBus()
    device = U3vCamera(light)
    port = bus.plug(device)
    yield device, port
    bus.close()


@pytest.fixture
def camera(plugged):
    opened = GenicamCamera(GenicamSettings(device="U3V0001"))
    opened.open()
    yield opened
    # A camera that is still open when the process ends takes it down with it.
    opened.close()
    gc.collect()


def collect(camera, seconds=3.0):
    return camera.collect(deadline_s=in_s(seconds), cancel=NEVER)


def test_triggered_pictures_are_exact_in_every_format(camera):
    for name, full in (("Mono8", 255), ("Mono10", 1023), ("Mono12", 4095), ("Mono16", 65535)):
        for exposure_s in (0.005, 0.01):
            camera.apply(CameraSettings(exposure_s=exposure_s, pixel_format=name))
            camera.arm("software")
            camera.trigger(deadline_s=far(), cancel=NEVER)
            frame = collect(camera)
            wanted = np.rint(np.clip(light(240, 320) * exposure_s, 0.0, 1.0) * full)
            np.testing.assert_array_equal(frame.pixels, wanted)
            camera.disarm()


def test_levels_and_bits_are_those_of_the_format(plugged):
    for name, bits in (("Mono10", 10), ("Mono12", 12)):
        camera = GenicamCamera(GenicamSettings(device="U3V0001", pixel_format=name))
        can = camera.open()
        assert (can.bits, can.white_level_dn) == (bits, 2**bits - 1)
        assert can.formats == ("Mono16", "Mono12", "Mono10", "Mono8")
        camera.close()
        del camera
        gc.collect()


def test_free_run_numbers_rise_and_a_region_is_read(camera):
    camera.apply(CameraSettings(exposure_s=0.01, roi=(0, 0, 160, 120)))
    camera.arm("free-run")
    frames = [collect(camera) for _ in range(4)]
    assert frames[0].pixels.shape == (120, 160)
    assert (np.diff([frame.sequence for frame in frames]) >= 1).all()


def test_a_frame_cut_short_is_never_a_picture(camera, plugged):
    camera.apply(CameraSettings(exposure_s=0.01, roi=(0, 0, 160, 120)))
    camera.arm("software")
    plugged[0].truncate_next = True
    camera.trigger(deadline_s=far(), cancel=NEVER)
    with pytest.raises((FrameCorruptError, NoFrameError)):
        collect(camera)
    camera.disarm()
    camera.arm("software")
    camera.trigger(deadline_s=far(), cancel=NEVER)
    assert collect(camera).pixels.max() > 0


def test_out_of_range_is_refused(camera):
    with pytest.raises(SettingRefusedError, match="outside"):
        camera.apply(CameraSettings(exposure_s=100.0))


def test_unplugging_is_a_lost_device(camera, plugged):
    camera.apply(CameraSettings(exposure_s=0.01))
    camera.arm("free-run")
    collect(camera)
    threading.Timer(0.2, plugged[1].unplug).start()

    def go_on():
        end = time.monotonic() + 15.0
        while time.monotonic() < end:
            try:
                collect(camera, 0.5)
            except (NoFrameError, FrameCorruptError):
                continue

    with pytest.raises(DeviceLostError):
        go_on()
    camera.make_safe()
    camera.close()


def teardown_module():
    gc.collect()
    aravis().shutdown()
