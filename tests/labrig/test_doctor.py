"""The doctor names what is missing or misconfigured, and what mends it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import labrig
from drivers.errors import DeviceNotFoundError
from labrig.doctor import devices as doctor_devices
from labrig.doctor import udev
from labrig.doctor.devices import of_rig, plugged_in
from labrig.doctor.storage import disk, file_system
from labrig.models.devices import SerialTriggerConfig, UsbTriggerConfig, V4l2CameraConfig
from labrig.models.rig import Rig


@pytest.fixture
def bench() -> Rig:
    """The bench of the examples, its camera a video node."""
    rig = labrig.load_rig(labrig.config_folder() / "rigs" / "bench.yaml")
    kept = rig.camera.model_dump(exclude={"driver", "device", "trigger_line"})
    camera = V4l2CameraConfig(driver="v4l2", device="/dev/none", **kept)
    return rig.model_copy(update={"camera": camera})


def deny(monkeypatch: pytest.MonkeyPatch, *paths: Path) -> None:
    """Let the system deny some nodes; root, as whom tests may run, is denied nothing."""
    really = os.access
    denied = {str(path) for path in paths}
    monkeypatch.setattr(os, "access", lambda p, mode: str(p) not in denied and really(p, mode))


def test_nodes_without_permission_are_told_from_missing_ones(tmp_path, monkeypatch) -> None:
    found = {f.name: f for f in plugged_in(tmp_path)}
    assert found["cameras"].text == f"no {tmp_path}/video*"
    (tmp_path / "video0").touch()
    found = {f.name: f for f in plugged_in(tmp_path)}
    assert "none of" in found["cameras"].text
    deny(monkeypatch, tmp_path / "video0")
    cameras = {f.name: f for f in plugged_in(tmp_path)}["cameras"]
    assert (cameras.ok, cameras.text) == (False, f"no permission for {tmp_path}/video0")
    assert "usermod -aG video" in cameras.remedy


def test_usb_box_of_root_alone_is_told(tmp_path, monkeypatch) -> None:
    seen = ["1209:0001 at bus 1 device 7", "046d:c077 at bus 1 device 2"]
    monkeypatch.setattr(doctor_devices, "usb_devices", lambda: seen)
    deny(monkeypatch, tmp_path / "bus/usb/001/007", tmp_path / "bus/usb/001/002")
    usb = {f.name: f for f in plugged_in(tmp_path)}["USB"]
    # a mouse needs no rule
    assert usb.text == f"no permission for {tmp_path}/bus/usb/001/007"


def test_rules_of_another_version_are_told(tmp_path, monkeypatch) -> None:
    installed = tmp_path / "rules.d" / "70-labrig.rules"
    monkeypatch.setattr(udev, "INSTALLED", installed)
    installed.parent.mkdir()

    def rules():
        return {f.name: f for f in plugged_in(tmp_path)}["udev rules"]

    assert not rules().ok
    installed.write_text("# old\n")
    assert "not those of this version" in rules().text
    assert rules().remedy == "labrig doctor --fix-udev"
    installed.write_text(udev.rules())
    assert rules().ok


def test_devices_of_a_rig_are_looked_for_by_name(bench, tmp_path, monkeypatch) -> None:
    port = tmp_path / "ttyACM0"
    trigger = SerialTriggerConfig(driver="serial", port=str(port))
    rig = bench.model_copy(update={"trigger": trigger})
    monkeypatch.delenv("DISPLAY", raising=False)
    found = {f.name: f for f in of_rig(rig, tmp_path)}
    assert found["rig's camera"].text == "/dev/none is not there"
    assert found["rig's trigger"].text == f"{port} is not there"
    assert not found["rig's projector"].ok
    port.touch()
    assert {f.name: f for f in of_rig(rig, tmp_path)}["rig's trigger"].ok
    deny(monkeypatch, port)
    assert "dialout" in {f.name: f for f in of_rig(rig, tmp_path)}["rig's trigger"].remedy


def test_camera_by_its_serial_number_and_box_by_its_id(tmp_path, monkeypatch) -> None:
    rig = labrig.load_rig(labrig.config_folder() / "rigs" / "bench.yaml")
    rig = rig.model_copy(update={"trigger": UsbTriggerConfig(driver="usb")})

    def look():
        return {f.name: f for f in of_rig(rig, tmp_path)}

    monkeypatch.setattr(doctor_devices, "genicam_cameras", lambda: [("a", "b", "12345678")])
    monkeypatch.setattr(doctor_devices, "usb_devices", lambda: ["1209:0001 at bus 2 device 3"])
    found = look()
    assert found["rig's camera"].ok
    assert "plugdev" in found["rig's trigger"].remedy
    node = tmp_path / "bus" / "usb" / "002" / "003"
    node.parent.mkdir(parents=True)
    node.touch()
    assert look()["rig's trigger"].ok

    def none():
        msg = "Aravis is not installed"
        raise DeviceNotFoundError(msg)

    monkeypatch.setattr(doctor_devices, "genicam_cameras", none)
    monkeypatch.setattr(doctor_devices, "usb_devices", list)
    found = look()
    assert found["rig's camera"].text == "Aravis is not installed"
    assert found["rig's trigger"].text == "no USB device 1209:0001"


def test_disk_is_tried_out_and_its_kind_named(tmp_path, monkeypatch) -> None:
    found = disk(tmp_path / "not" / "yet")
    assert "fsync of 64 kB takes" in found.text
    assert file_system(tmp_path) in found.text
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("labrig.doctor.storage.file_system", lambda _: "tmpfs")
    assert "gone with the power" in disk(tmp_path).text
    monkeypatch.setattr("labrig.doctor.storage.file_system", lambda _: "nfs4")
    assert "over a network" in disk(tmp_path).text

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    found = disk(tmp_path)
    assert not found.ok
    assert "No space left on device" in found.text
    assert list(tmp_path.iterdir()) == []


def test_file_system_is_that_of_the_innermost_mount(tmp_path) -> None:
    mounts = tmp_path / "mountinfo"
    mounts.write_text(
        "22 1 254:0 / / rw - ext4 /dev/vda rw\n"
        "30 22 0:5 / /data rw shared:1 - xfs /dev/sdb rw\n"
        "31 30 0:6 / /data/with\\040space rw - nfs4 host:/x rw\n"
    )
    kinds = {"/": "ext4", "/database": "ext4", "/data/x": "xfs", "/data/with space/y": "nfs4"}
    for place, kind in kinds.items():
        assert file_system(Path(place), mounts) == kind
