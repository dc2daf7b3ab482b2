"""From a pattern on a real X server through a real GigE stream to the parameters of the tank.

The emulated camera computes its picture from the pixels it grabs from the X server at the end of
its exposure, so a pattern that came late, or on another output, would be measured as what it is.
"""

import os

import pytest
from emulated.gige_camera import GigeCamera
from emulated.needs import need_typelib
from emulated.tank import describe
from emulated.x_server import XServer

import labrig
from labrig.acquisition.capturing import prepare
from labrig.acquisition.run_state import Command, State
from labrig.session import Session

ROWS, COLS = 24, 640
RIG = """\
schema: labrig-rig/1
name: closed-loop
camera:
  driver: genicam
  device: {serial}
  rows: 160
  cols: 192
  pixel_format: Mono16
  bits: 16
  black_level_dn: 200
  white_level_dn: 65535
  gain_dn_per_e: 2.0
  read_noise_e: 10.0
  readout_s: 1.0
  exposure_latency_frames: 0
projector:
  driver: screen
  output: PROJ
  display: "{display}"
  rows: 24
  cols: 640
  refresh_hz: 60
  jitter_s: 0.0
  settle_s: 0.0
  black_level: 0.01
trigger: {{driver: software}}
geometry: {{mm_per_px: 0.2, region_px: [21, 20, 150, 120], lit_side: left}}
projection: {{mm_per_px: 0.15, origin_mm: -36.0, blur_px: 0.5}}
"""
SCENE = """\
schema: labrig-scene/1
name: closed-loop
medium: {sigma_t_per_mm: 0.3, sigma_s_per_mm: 0.15, g: 0.3}
tank: {depth_mm: 30, width_mm: 24}
beam: {from_mm: 7.2, to_mm: 16.8}
light: {peak_e_per_s: 2.0e5, ambient_e_per_s: 0}
transport: {method: montecarlo, n_paths: 240000, cell_mm: 0.5, seed: 1}
"""
PLAN = """\
schema: labrig-plan/1
name: closed-loop
exposures: {bracket_s: [0.03, 0.12]}
sets:
  - {id: stripes, pattern: {kind: stripes, period_px: 12, shifts: 6, axis: x}}
  - {id: white, pattern: {kind: uniform, level: 255}}
  - {id: black, pattern: {kind: black}}
  - {id: dark, pattern: {kind: black}, shutter: covered}
"""


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Plan, rig and scene files of a bench whose camera sees what the second output shows."""
    need_typelib("Aravis", "0.8", package="gir1.2-aravis-0.8 python3-gi")
    server = XServer(tmp_path, right=(COLS, ROWS))
    serial, cap = f"CL{os.getpid()}", tmp_path / "cap"
    files = {
        "rig": RIG.format(serial=serial, display=server.display),
        "scene": SCENE,
        "plan": PLAN,
    }
    paths = {}
    for name, text in files.items():
        paths[name] = tmp_path / f"{name}.yaml"
        paths[name].write_text(text)

    def ask(covered):
        if covered:
            cap.touch()
        else:
            cap.unlink()

    monkeypatch.setattr("labrig.rig.ask_operator", ask)
    argument = describe(
        paths["rig"],
        paths["scene"],
        paths["plan"],
        server.path,
        (server.left[0], COLS, ROWS),
        cap,
    )
    camera = GigeCamera(serial, "emulated.tank:tank_scene", argument)
    yield paths, server
    camera.stop()
    server.stop()


def test_a_session_captured_in_closed_loop_is_analysed_to_the_true_parameters(bench, tmp_path):
    paths, server = bench
    plan = labrig.load_plan(paths["plan"])
    with labrig.open_rig(paths["rig"], paths["scene"], plan) as rig:
        session = labrig.capture(plan, rig, tmp_path / "sessions")
    assert labrig.verify(session) == []
    result = labrig.analyse(session)
    found = {name: result.run[name]["value"] for name in ("sigma_t_per_mm", "sigma_s_per_mm", "g")}
    # measured -0.18 %, +0.02 % and -0.006 (std 0.03 %, 0.06 % and 0.0013): the light's own Monte
    # Carlo, with 60 000 paths -0.28 %, +0.06 % and -0.007
    assert found["sigma_t_per_mm"] == pytest.approx(0.3, rel=0.004)
    assert found["sigma_s_per_mm"] == pytest.approx(0.15, rel=0.005)
    assert found["g"] == pytest.approx(0.3, abs=0.012)
    assert not result.run.get("truth")
    assert server.await_black()


def test_a_session_of_real_devices_is_resumed_by_the_rig_it_keeps(bench, tmp_path, command):
    paths, server = bench
    plan = labrig.load_plan(paths["plan"])
    with labrig.open_rig(paths["rig"], None, plan) as rig:  # a real rig looks at no scene
        runner = prepare(plan, rig, tmp_path / "sessions")
        runner.subscribe(
            lambda e: e.status.shot == "white-e0-r0" and runner.post(Command.ABORT_AFTER_GROUP)
        )
        runner.post(Command.START)
        assert runner.run().status.state is State.ABORTED
    path = runner.path
    before = set(Session.open(path).frames)
    assert before == {*(f"stripes-e0-r0-p{k:02d}" for k in range(6)), "white-e0-r0"}
    assert server.await_black()
    # a rig file may say where the devices are now, but they must be the same ones
    other = tmp_path / "other.yaml"
    other.write_text(paths["rig"].read_text().replace("black_level_dn: 200", "black_level_dn: 0"))
    said = command("resume", path, "--rig", other)
    assert said.code == 4
    assert "camera.black_level_dn was 200.0, is 0.0" in said.err
    assert set(Session.open(path).frames) == before
    said = command("resume", path)
    assert (said.code, said.out.strip()) == (0, str(path)), said.err
    assert labrig.verify(path) == []
    session = Session.open(path)
    assert not session.missing
    segments = {shot: frame.details["segment"] for shot, frame in session.frames.items()}
    assert {segments[shot] for shot in before} == {1}
    assert {segments[shot] for shot in segments.keys() - before} == {2}
    assert server.await_black()
    # tank and beam are measured in the picture
    assert session.header["scene"] is None
    found = labrig.analyse(path).run
    # measured -0.22 %, +0.16 % and -0.010
    assert found["sigma_t_per_mm"]["value"] == pytest.approx(0.3, rel=0.004)
    assert found["sigma_s_per_mm"]["value"] == pytest.approx(0.15, rel=0.005)
    assert found["g"]["value"] == pytest.approx(0.3, abs=0.015)
