"""Serial adapters and USB devices under the real drivers: by-id names, unplug and replug."""

import subprocess
import threading
import time
from pathlib import Path

import pytest
from deadlines import far, in_s
from emulated.firmware import compile_firmware
from emulated.usb_trigger import UsbTriggerDevice
from emulated.usb_vhci import VirtualPort

from drivers.errors import (
    DeadlineError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    TriggerNotFiredError,
)
from drivers.transport.serial_line import BY_ID, SerialLine, serial_ports
from drivers.trigger.protocol import TriggerSettings
from drivers.trigger.serial import SerialTrigger
from drivers.trigger.usb import UsbTrigger
from drivers.waiting import CancelToken

NEVER = CancelToken()


def await_true(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.1)
    return condition()


def settle():
    subprocess.run(["udevadm", "settle", "-t", "20"], check=False)


def test_a_serial_adapter_is_named_by_its_id_and_its_unplug_is_typed(load):
    load("xhci_pci")
    load("ftdi_sio")
    assert await_true(lambda: list(BY_ID.glob("*")))
    (port,) = [found for found in serial_ports() if found.serial_number]
    assert port.path.startswith("/dev/serial/by-id/")
    assert port.serial_number == "LABRIG01"
    line = SerialLine(port.path, baud=115200)
    assert line.open()["serial"] == "LABRIG01"
    with pytest.raises(DeviceBusyError, match="another program"):
        SerialLine(port.path, baud=115200).open()
    line.send(b"1 id*00\n", deadline_s=far(), cancel=NEVER)
    with pytest.raises(DeadlineError, match="no whole line"):
        line.receive(deadline_s=in_s(1.0), cancel=NEVER)
    name = Path(port.path).resolve().name
    usb = Path(f"/sys/class/tty/{name}/device").resolve().parents[1]
    threading.Timer(0.3, (usb / "remove").write_text, ["1"]).start()
    with pytest.raises(DeviceLostError, match="has gone"):
        line.receive(deadline_s=far(), cancel=NEVER)
    line.close()
    settle()
    assert await_true(lambda: not list(BY_ID.glob("*")))
    with pytest.raises(DeviceNotFoundError, match="does not exist"):
        SerialTrigger(port.path, boot_s=0.1).open()
    # the whole host controller bound anew is a replug to the kernel
    driver = Path("/sys/bus/pci/drivers/xhci_hcd")
    (slot,) = [path.name for path in driver.glob("0000:*")]
    (driver / "unbind").write_text(slot)
    (driver / "bind").write_text(slot)
    settle()
    assert await_true(lambda: Path(port.path).exists())
    again = SerialLine(port.path, baud=115200)
    again.open()
    again.close()


def test_a_usb_trigger_is_found_lost_and_found_again(load, tmp_path):
    load("vhci-hcd")
    program = compile_firmware(tmp_path)
    device = UsbTriggerDevice(program)
    port = VirtualPort(device)
    trigger = UsbTrigger()

    def opens():
        try:
            trigger.open()
        except DeviceNotFoundError:
            return False
        return True

    end = time.monotonic() + 90.0
    while not opens():
        assert time.monotonic() < end, "libusb did not find the trigger"
        time.sleep(0.2)
    trigger.configure(TriggerSettings(pulse_s=1e-3))
    assert trigger.fire(deadline_s=far(), cancel=NEVER).count == 1
    threading.Timer(0.3, port.unplug).start()

    def go_on():
        limit = time.monotonic() + 90.0
        while time.monotonic() < limit:
            try:
                trigger.fire(deadline_s=far(), cancel=NEVER)
            except TriggerNotFiredError:
                time.sleep(0.01)

    with pytest.raises(DeviceLostError):
        go_on()
    trigger.make_safe()
    trigger.close()
    settle()
    again = UsbTriggerDevice(program, serial="T0002")
    port = VirtualPort(again)
    end = time.monotonic() + 90.0
    while not opens():
        assert time.monotonic() < end, "libusb did not find the replugged trigger"
        time.sleep(0.2)
    assert trigger.identity["serial"] == "T0002"
    trigger.close()
    port.unplug()
    device.stop()
    again.stop()
