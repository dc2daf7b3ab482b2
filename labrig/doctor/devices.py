"""Which devices are plugged in, whether this user may open them, and whether a rig's are there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from drivers.camera.genicam_library import genicam_cameras
from drivers.errors import DriverError
from drivers.transport.serial_line import serial_ports
from drivers.transport.usb_transfer import usb_devices
from drivers.transport.v4l2_device import video_devices
from drivers.transport.x_display import outputs
from labrig.doctor import udev
from labrig.doctor.finding import Finding
from labrig.errors import LabrigError
from labrig.models.devices import (
    GenicamCameraConfig,
    ScreenProjectorConfig,
    SerialTriggerConfig,
    UsbTriggerConfig,
    V4l2CameraConfig,
)
from labrig.models.rig import Rig

DEV = Path("/dev")
PLUG = "plug it in and switch it on; then: labrig devices"


def plugged_in(dev: Path = DEV) -> list[Finding]:
    """Look for cameras, ports and boxes; none is opened but to ask a camera what it is."""
    return [_video(dev), _genicam(), _serial(), _usb(dev), _rules()]


def of_rig(rig: Rig, dev: Path = DEV) -> list[Finding]:
    """Hold the devices that a rig file names to what is plugged in."""
    checks: list[Callable[[], Finding]] = []
    camera, projector, trigger = rig.camera, rig.projector, rig.trigger
    if isinstance(camera, V4l2CameraConfig):
        checks.append(lambda: _node("rig's camera", camera.device, "video"))
    if isinstance(camera, GenicamCameraConfig):
        checks.append(lambda: _serial_number(camera.device))
    if isinstance(projector, ScreenProjectorConfig):
        checks.append(lambda: _output(projector))
    if isinstance(trigger, SerialTriggerConfig):
        checks.append(lambda: _node("rig's trigger", trigger.port, "dialout"))
    if isinstance(trigger, UsbTriggerConfig):
        wanted = f"{trigger.vendor_id:04x}:{trigger.product_id:04x}"
        checks.append(lambda: _usb_box(wanted, dev))
    drivers = f"camera {camera.driver}, projector {projector.driver}, trigger {trigger.driver}"
    named = Finding(name="rig", ok=True, text=f"rig {rig.name!r}: {drivers}")
    return [named, *(check() for check in checks)]


def _denied(nodes: list[str]) -> list[str]:
    return [node for node in nodes if not os.access(node, os.R_OK | os.W_OK)]


def _refused(name: str, nodes: list[str], group: str) -> Finding:
    remedy = f"labrig doctor --fix-udev, or: sudo usermod -aG {group} $USER, and log in again"
    text = f"no permission for {', '.join(nodes)}"
    return Finding(name=name, ok=False, text=text, remedy=remedy)


def _video(dev: Path) -> Finding:
    nodes = sorted(map(str, dev.glob("video*")))
    if denied := _denied(nodes):
        return _refused("cameras", denied, "video")
    found = [f"{path} ({info.card})" for path, info in video_devices(dev)]
    text = ", ".join(found) or (
        f"none of {', '.join(nodes)} captures pictures" if nodes else f"no {dev}/video*"
    )
    return Finding(name="cameras", ok=bool(found), text=text, remedy=PLUG)


def _genicam() -> Finding:
    name = "machine-vision cameras"
    try:
        found = [f"{model} (serial {serial})" for _, model, serial in genicam_cameras()]
    except DriverError as error:
        remedy = "sudo apt-get install gir1.2-aravis-0.8 python3-gi; make genicam"
        return Finding(name=name, ok=False, text=str(error), remedy=remedy)
    text = ", ".join(found) or "Aravis sees none"
    return Finding(name=name, ok=bool(found), text=text, remedy=PLUG)


def _serial() -> Finding:
    ports = serial_ports()
    if denied := _denied([port.path for port in ports]):
        return _refused("serial ports", denied, "dialout")
    text = ", ".join(f"{p.path} ({p.description})" for p in ports) or "no serial port"
    return Finding(name="serial ports", ok=bool(ports), text=text, remedy=PLUG)


def _usb(dev: Path) -> Finding:
    """Say whether USB devices could be opened; hubs and keyboards need not be."""
    seen = usb_devices()
    known = [told for told in seen if _is_ours(told)]
    nodes = [_usb_node(told, dev) for told in known]
    if denied := _denied(nodes):
        return _refused("USB", denied, "plugdev")
    text = f"{len(seen)} devices, of them known to labrig: {', '.join(known) or 'none'}"
    return Finding(name="USB", ok=True, text=text)


def _is_ours(told: str) -> bool:
    """Whether the rules name a device's vendor, or vendor and product."""
    vendor, _, product = told.split(maxsplit=1)[0].partition(":")
    rules = udev.rules()
    one = f'ATTR{{idVendor}}=="{vendor}"'
    return f'{one}, ATTR{{idProduct}}=="{product}"' in rules or f"{one}, TAG" in rules


def _usb_node(told: str, dev: Path) -> str:
    _, _, _, bus, _, address = told.split()
    return str(dev / "bus" / "usb" / f"{int(bus):03d}" / f"{int(address):03d}")


def _rules() -> Finding:
    fix = "labrig doctor --fix-udev"
    folders = (udev.INSTALLED.parent, Path("/usr/lib/udev/rules.d"))
    found = [rule for folder in folders for rule in folder.glob("*labrig*")]
    if not found:
        text = "no udev rule of labrig: devices may be root's only"
        return Finding(name="udev rules", ok=False, text=text, remedy=fix)
    try:
        same = any(rule.read_text(encoding="utf-8") == udev.rules() for rule in found)
    except (OSError, UnicodeDecodeError):
        same = False
    text = ", ".join(map(str, found)) + ("" if same else ": not those of this version")
    return Finding(name="udev rules", ok=same, text=text, remedy=fix)


def _node(name: str, path: str, group: str) -> Finding:
    if not Path(path).exists():
        return Finding(name=name, ok=False, text=f"{path} is not there", remedy=PLUG)
    if _denied([path]):
        return _refused(name, [path], group)
    return Finding(name=name, ok=True, text=f"{path} is there and may be opened")


def _serial_number(wanted: str) -> Finding:
    name = "rig's camera"
    try:
        there = [serial for *_, serial in genicam_cameras()]
    except DriverError as error:
        return Finding(name=name, ok=False, text=str(error), remedy="make genicam")
    ok = wanted in there
    text = f"serial {wanted} answers" if ok else f"no camera of serial {wanted} answers"
    return Finding(name=name, ok=ok, text=text, remedy=PLUG)


def _output(projector: ScreenProjectorConfig) -> Finding:
    name = "rig's projector"
    try:
        there = outputs(projector.display or os.environ.get("DISPLAY", ""))
    except (DriverError, LabrigError) as error:
        remedy = "log in at the machine's own screen, or: export DISPLAY=:0"
        return Finding(name=name, ok=False, text=str(error), remedy=remedy)
    of_name = [o for o in there if o.name == projector.output]
    if not of_name:
        names = ", ".join(o.name for o in there) or "none"
        text = f"no output {projector.output}; there are: {names}"
        return Finding(name=name, ok=False, text=text, remedy="connect it; then: xrandr --query")
    size, wanted = (of_name[0].width, of_name[0].height), (projector.cols, projector.rows)
    text = f"output {projector.output} has {size[0]} x {size[1]} px"
    remedy = f"xrandr --output {projector.output} --mode {wanted[0]}x{wanted[1]}"
    return Finding(name=name, ok=size == wanted, text=text, remedy=remedy)


def _usb_box(wanted: str, dev: Path) -> Finding:
    name = "rig's trigger"
    found = [told for told in usb_devices() if told.startswith(wanted)]
    if not found:
        return Finding(name=name, ok=False, text=f"no USB device {wanted}", remedy=PLUG)
    if denied := _denied([_usb_node(told, dev) for told in found]):
        return _refused(name, denied, "plugdev")
    return Finding(name=name, ok=True, text=found[0])
