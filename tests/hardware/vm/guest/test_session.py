"""A whole session through the real uvcvideo: X server, camera that sees it, folder on disk."""

import time

import numpy as np
import pytest
from emulated.usb_vhci import VirtualPort
from emulated.uvc_camera import UvcCamera
from emulated.x_server import FrameBuffer, XServer

import labrig

# at once: a minute for the emulated processor, and more while a camera streams
import labrig.api.results
import labrig.api.sessions
from drivers.transport.v4l2_device import video_devices
from labrig.session import Session

ROWS, COLS = 120, 160
DELAY = 2  # frames that still have the old exposure
FULL_PER_S = 1e4  # counts a second of the 8-bit scale, where the projector is white
RIG = """\
schema: labrig-rig/1
name: in the virtual machine
camera:
  driver: v4l2
  device: {device}
  rows: 120
  cols: 160
  pixel_format: Y16
  bits: 16
  black_level_dn: 0
  white_level_dn: 65535
  gain_dn_per_e: 2.0
  read_noise_e: 10.0
  exposure_latency_frames: 5
  uncertainty_s: 0.2
projector:
  driver: screen
  output: PROJ
  display: "{display}"
  rows: 120
  cols: 160
  refresh_hz: 60
  settle_s: 0.2
trigger: {{driver: free-run}}
geometry: {{mm_per_px: 0.2, lit_side: left}}
projection: {{mm_per_px: 0.2, origin_mm: 0.0}}
"""
SCENE = """\
schema: labrig-scene/1
name: none
medium: {sigma_t_per_mm: 0.3, sigma_s_per_mm: 0.15, g: 0.3}
tank: {depth_mm: 30, width_mm: 24}
beam: {from_mm: 7.2, to_mm: 16.8}
light: {peak_e_per_s: 2.0e5, ambient_e_per_s: 0}
"""
PLAN = """\
schema: labrig-plan/1
name: in the virtual machine
exposures: {bracket_s: [0.005, 0.02]}
sets:
  - {id: stripes, pattern: {kind: stripes, period_px: 8, shifts: 4, axis: x}}
  - {id: white, pattern: {kind: uniform, level: 255}}
  - {id: black, pattern: {kind: black}}
"""


@pytest.fixture
def bench(load, tmp_path, monkeypatch):
    """A second screen, a camera that looks at it, and the files that describe both."""
    # devices need more time where the processor is emulated, emulates a camera too and is starved
    monkeypatch.setattr("drivers.projector.window_process.START_S", 90.0)
    monkeypatch.setattr("drivers.projector.second_screen.LOAD_S", 30.0)
    monkeypatch.setattr("labrig.acquisition.sequence.MARGIN_S", 30.0)
    load("vhci-hcd")
    load("uvcvideo")
    server = XServer(tmp_path, right=(COLS, ROWS))
    screen = FrameBuffer(server.path)

    def light():
        shown = screen.grab(server.left[0], COLS, ROWS)[..., 0]
        return shown / 255.0 * FULL_PER_S

    port = VirtualPort(UvcCamera(light, width=COLS, height=ROWS, delay=DELAY))
    end = time.monotonic() + 90.0
    found = []
    while not found and time.monotonic() < end:
        time.sleep(0.2)
        found = [path for path, info in video_devices() if "UVC" in info.card and "by-id" in path]
    assert found, "uvcvideo did not take the camera"
    paths = {name: tmp_path / f"{name}.yaml" for name in ("rig", "scene", "plan")}
    paths["rig"].write_text(RIG.format(device=found[0], display=server.display))
    paths["scene"].write_text(SCENE)
    paths["plan"].write_text(PLAN)
    yield paths, server
    port.unplug()
    screen.close()
    server.stop()


def test_a_session_from_the_v4l2_camera_is_complete_verified_and_shows_every_pattern(
    bench, tmp_path
):
    paths, server = bench
    plan = labrig.load_plan(paths["plan"])
    with labrig.open_rig(paths["rig"], paths["scene"], plan) as rig:
        folder = labrig.capture(plan, rig, tmp_path / "sessions")
    assert labrig.verify(folder) == []
    session = Session.open(folder)
    assert session.sealed
    assert not session.missing
    assert len(session.shots) == 2 * (4 + 1 + 1)
    column = np.arange(COLS)
    for shot in session.shots:
        lit = {
            "white": np.ones(COLS),
            "black": np.zeros(COLS),
            "stripes": (column - 2 * (shot.get("shift") or 0)) % 8 < 4,
        }[shot["role"]]
        wanted = np.rint(np.minimum(FULL_PER_S * shot["exposure_s"] * lit, 255.0) * 257.0)
        # neither an old exposure nor an old pattern: equal to the count
        np.testing.assert_array_equal(session.read(shot["id"]), np.tile(wanted, (ROWS, 1)))
    assert server.await_black()
