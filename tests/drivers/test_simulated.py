"""The simulated world: light when it is shown, noise as a sensor makes it."""

import numpy as np
import pytest

from drivers.camera.protocol import CameraSettings, Flushed
from drivers.camera.simulated import Sensor, SimulatedCamera
from drivers.errors import NoFrameError, NotOpenError, SettingRefusedError
from drivers.projector.protocol import ProjectorCapabilities
from drivers.projector.simulated import SimulatedProjector
from drivers.simulation.world import World
from drivers.waiting import CancelToken

SENSOR = Sensor(
    rows=120,
    cols=160,
    bits=12,
    black_level_dn=16.0,
    white_level_dn=4095.0,
    gain_dn_per_e=0.28,
    read_noise_e=10.9,
    readout_s=0.02,
)
CAN = ProjectorCapabilities(
    rows=4,
    cols=6,
    refresh_hz=60.0,
    latency_s=(0.03, 0.03 + 1 / 60),
    settle_s=0.02,
    lamp_control=True,
)
NEVER = CancelToken()
WHITE, BLACK = np.full((4, 6), 255, np.uint8), np.zeros((4, 6), np.uint8)


def light(image, black_level):
    """10 000 e/s under white, the projector's leak under black, nothing when it is off."""
    rate = 0.0 if image is None else 10_000.0 * max(image.mean() / 255.0, black_level)
    return np.full((SENSOR.rows, SENSOR.cols), rate)


@pytest.fixture
def rig():
    world = World(light=light, projector_black=0.01)
    camera = SimulatedCamera(SENSOR, world, seed=5)
    projector = SimulatedProjector(CAN, world, latency_s=0.03)
    camera.open()
    camera.arm("software")
    projector.open()
    yield world, camera, projector
    projector.close()
    camera.close()


def take(camera, exposure_s):
    camera.apply(CameraSettings(exposure_s=exposure_s))
    camera.trigger(deadline_s=1e9, cancel=NEVER)
    return camera.collect(deadline_s=1e9, cancel=NEVER)


def show(projector, image):
    """Load an image, show it, and return the receipt."""
    (handle,) = projector.load([image])
    return projector.show(handle, deadline_s=1e9, cancel=NEVER)


def test_photon_transfer_of_the_sensor_is_its_gain_and_read_noise(rig):
    world, camera, projector = rig
    world.clock.sleep(show(projector, WHITE).latest_s)
    pair = [take(camera, 0.5).pixels.astype(float) for _ in range(2)]
    variance = 0.5 * np.var(pair[0] - pair[1])
    gain = (variance - (0.28 * 10.9) ** 2 - 1 / 12) / (pair[0].mean() - 16.0)
    # measured 0.276; 19 200 pixels know a variance to 1 %
    assert gain == pytest.approx(0.28, rel=0.04)
    world.covered = True
    dark = take(camera, 0.5).pixels.astype(float)
    # measured 15.999 and 3.055 DN: read noise 3.052 and quantisation 0.289
    assert dark.mean() == pytest.approx(16.0, abs=0.1)
    assert dark.std() == pytest.approx(np.hypot(0.28 * 10.9, 1 / np.sqrt(12)), rel=0.03)


def test_a_frame_taken_too_early_mixes_both_patterns(rig):
    world, camera, projector = rig
    receipt = show(projector, WHITE)
    world.clock.sleep(1.0)
    now = world.clock.now_s()
    receipt = show(projector, BLACK)
    assert now + 0.03 == receipt.earliest_s
    early = take(camera, 0.1).pixels.mean() - 16.0
    settled = take(camera, 0.1).pixels.mean() - 16.0
    # white for the 30 to 47 ms before the light changes, then the leak of one percent
    assert 0.28 * 10_000 * 0.03 < early < 0.28 * 10_000 * 0.049
    assert settled == pytest.approx(0.28 * 100 * 0.1, abs=0.2)


def test_counts_are_clipped_at_the_white_level_and_frames_are_read_only(rig):
    world, camera, projector = rig
    world.clock.sleep(show(projector, WHITE).latest_s)
    frame = take(camera, 10.0)
    assert (frame.pixels == 4095).all()
    with pytest.raises(ValueError, match="read-only"):
        frame.pixels[0, 0] = 0


def test_the_same_seed_gives_the_same_noise():
    pictures = []
    for _ in range(2):
        world = World(light=light)
        camera = SimulatedCamera(SENSOR, world, seed=9)
        camera.open()
        camera.arm("software")
        world.project(WHITE, at_s=0.0)
        pictures.append(take(camera, 0.1).pixels)
    np.testing.assert_array_equal(*pictures)


def test_devices_refuse_what_they_cannot_do(rig):
    world, camera, projector = rig
    with pytest.raises(SettingRefusedError, match="outside"):
        camera.apply(CameraSettings(exposure_s=100.0))
    with pytest.raises(SettingRefusedError, match="never scaled"):
        projector.load([np.zeros((5, 5), np.uint8)])
    with pytest.raises(NoFrameError, match="triggered"):
        camera.collect(deadline_s=world.clock.now_s() + 1.0, cancel=NEVER)
    camera.apply(CameraSettings(exposure_s=0.1))
    camera.trigger(deadline_s=1e9, cancel=NEVER)
    world.clock.sleep(1.0)
    assert camera.flush() == Flushed(discarded=1, last_sequence=1)
    camera.close()
    camera.close()
    with pytest.raises(NotOpenError):
        camera.trigger(deadline_s=1e9, cancel=NEVER)


def test_closing_the_projector_leaves_it_dark(rig):
    world, _, projector = rig
    world.clock.sleep(show(projector, WHITE).latest_s)
    projector.close()
    assert world.expose(world.clock.now_s(), 1.0).max() == 0.0
