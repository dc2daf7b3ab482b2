"""Rig files that name real devices and those of third parties; what is plugged in is listed."""

import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from emulated.x_server import XServer

import labrig
from drivers.camera.genicam import GenicamCamera
from drivers.camera.v4l2 import V4l2Camera
from drivers.errors import DeviceNotFoundError
from drivers.projector.second_screen import ScreenProjector
from drivers.trigger.protocol import TriggerSettings
from drivers.trigger.serial import SerialTrigger
from drivers.trigger.usb import UsbTrigger
from drivers.waiting import CancelToken
from labrig import real_devices
from labrig.doctor import udev
from labrig.doctor.devices import of_rig
from labrig.errors import ConfigError, RunError
from labrig.models.devices import PluginTriggerConfig, UsbTriggerConfig, V4l2CameraConfig

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_shipped_bench_names_devices_that_are_made_of_it():
    rig = labrig.load_rig(labrig.config_folder() / "rigs" / "bench.yaml")
    assert isinstance(real_devices.make_camera(rig.camera), GenicamCamera)
    assert isinstance(real_devices.make_projector(rig.projector, None), ScreenProjector)
    assert isinstance(real_devices.make_trigger(rig.trigger), SerialTrigger)
    assert isinstance(real_devices.make_trigger(UsbTriggerConfig(driver="usb")), UsbTrigger)
    v4l2 = V4l2CameraConfig(
        driver="v4l2",
        device="/dev/video99",
        rows=480,
        cols=640,
        bits=8,
        black_level_dn=0,
        white_level_dn=255,
    )
    camera = real_devices.make_camera(v4l2)
    assert isinstance(camera, V4l2Camera)
    with pytest.raises(DeviceNotFoundError, match="/dev/video99"):
        camera.open()


@pytest.fixture
def gpio(tmp_path, monkeypatch):
    """The driver of docs/writing-a-driver.md, installed as a third party would."""
    text = (DOCS / "writing-a-driver.md").read_text(encoding="utf-8")
    (tmp_path / "gpio_driver.py").write_text(re.search(r"```python\n(.*?)```", text, re.S)[1])
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("gpio", "gpio_driver:GpioTrigger", "labrig.triggers")
    monkeypatch.setattr(
        real_devices,
        "entry_points",
        lambda group: [point] if group == "labrig.triggers" else [],
    )
    line = tmp_path / "gpio17"
    line.mkdir()
    (line / "value").write_text("1")
    return line


def test_the_driver_of_the_documentation_works(gpio):
    assert real_devices.plugins() == ["gpio (triggers)"]
    entry = PluginTriggerConfig(driver="plugin", name="gpio", settings={"line": str(gpio)})
    trigger = real_devices.make_trigger(entry)
    trigger.open()
    assert (gpio / "value").read_text() == "0"
    trigger.configure(TriggerSettings(pulse_s=2e-3))
    receipt = trigger.fire(deadline_s=1e9, cancel=CancelToken())
    assert receipt.count == trigger.counters().pulses == 1
    assert receipt.earliest_s <= receipt.latest_s
    trigger.close()
    assert (gpio / "value").read_text() == "0"
    missing = PluginTriggerConfig(driver="plugin", name="relay")
    with pytest.raises(ConfigError, match="installed: gpio"):
        real_devices.make_trigger(missing)


def test_real_and_simulated_devices_do_not_mix(small_rig, small_scene, small_plan, tmp_path):
    text = small_rig.read_text().replace(
        "projector:\n  driver: simulated\n", "projector:\n  driver: screen\n  output: PROJ\n"
    )
    mixed = tmp_path / "mixed.yaml"
    mixed.write_text(text)
    with pytest.raises(RunError, match="mixes simulated and real"):
        labrig.open_rig(mixed, small_scene, labrig.load_plan(small_plan))


def test_devices_are_listed_by_the_names_that_rig_files_take(command, tmp_path, monkeypatch):
    server = XServer(tmp_path, right=(64, 48))
    monkeypatch.setenv("DISPLAY", server.display)
    said = command("devices", "--json")
    assert said.code == 0
    assert json.loads(said.out)["projector screen"] == [
        "LEFT (320x240 at +0+0)",
        "PROJ (64x48 at +320+0)",
    ]
    assert command("devices", "--uncover", "PROJ").out == "PROJ: was not covered\n"
    server.stop()
    assert "no X server" in command("devices").out


def test_rules_are_shown_and_installed_only_after_a_yes(tmp_path, monkeypatch):
    target = tmp_path / "70-labrig.rules"
    monkeypatch.setattr(udev.subprocess, "run", lambda *_args, **_keys: None)
    udev.install(target)
    assert target.read_text() == udev.rules()
    for needed in ("ef0500", "1209", "tty", "video4linux"):
        assert needed in udev.rules()
    with pytest.raises(RunError, match="sudo labrig doctor --fix-udev"):
        udev.install(tmp_path / "none" / "70-labrig.rules")


def test_doctor_holds_the_rigs_output_to_the_one_that_is_there(tmp_path, monkeypatch):
    server = XServer(tmp_path, right=(64, 48))
    bench = labrig.load_rig(labrig.config_folder() / "rigs" / "bench.yaml")

    def told(**changes):
        entry = {"display": server.display, "output": "PROJ", "rows": 48, "cols": 64, **changes}
        rig = bench.model_copy(update={"projector": bench.projector.model_copy(update=entry)})
        return next(f for f in of_rig(rig, tmp_path) if f.name == "rig's projector")

    assert told().ok
    assert told(rows=720).remedy == "xrandr --output PROJ --mode 64x720"
    assert "there are: LEFT, PROJ" in told(output="HDMI-1").text
    server.stop()
    assert "no X server" in told().text
