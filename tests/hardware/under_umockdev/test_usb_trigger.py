"""The USB trigger through real libusb, its firmware behind emulated endpoints."""

import threading
import time
from contextlib import suppress

import pytest
from deadlines import ends_within, far, in_s
from emulated.firmware import compile_firmware
from emulated.usb_device import UsbDevice, configuration, interface
from emulated.usb_trigger import UsbTriggerDevice
from emulated.usb_umockdev import UsbBus

from drivers.errors import (
    CancelledError,
    DeadlineError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    NotOpenError,
    SettingRefusedError,
    TriggerNotFiredError,
)
from drivers.transport.usb_transfer import UsbLines, UsbName, usb_devices
from drivers.trigger.protocol import TriggerSettings
from drivers.trigger.usb import UsbTrigger
from drivers.waiting import SLICE_S, CancelToken

NEVER = CancelToken()
PULSE_S = 1.0  # the longest there is


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    return compile_firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def bed():
    usb = UsbBus()
    yield usb
    usb.close()


@pytest.fixture
def device(program):
    emulated = UsbTriggerDevice(program)
    yield emulated
    emulated.stop()


@pytest.fixture
def port(bed, device):
    return bed.plug(device)


@pytest.fixture
def trigger(port):
    box = UsbTrigger()
    box.open()
    yield box
    box.close()


def test_pulses_are_given_and_counted(trigger, device):
    assert trigger.identity == {
        "model": "labrig trigger box",
        "serial": "T0001",
        "firmware": "1.0",
    }
    applied = trigger.configure(TriggerSettings(pulse_s=2e-3, delay_s=1e-3))
    assert applied.pulse_s == pytest.approx(2e-3)
    receipts = []
    for _ in range(3):
        receipts.append(trigger.fire(deadline_s=far(), cancel=NEVER))
        time.sleep(0.02)
    assert trigger.counters().pulses == 3
    rises = [edge for edge in device.box.unplug() if edge.high]
    for receipt, rise in zip(receipts, rises, strict=True):
        assert receipt.earliest_s <= rise.at_s
    # a loaded host may run the firmware's loop 20 ms late, and at times later
    late_s = [rise.at_s - receipt.latest_s for receipt, rise in zip(receipts, rises, strict=True)]
    assert min(late_s) <= 0.02


def test_make_safe_goes_beside_a_stuck_pipe(trigger, device):
    trigger.configure(TriggerSettings(pulse_s=PULSE_S))
    trigger.fire(deadline_s=far(), cancel=NEVER)
    device.mute = True
    trigger.make_safe()
    time.sleep(0.05)
    edges = device.box.unplug()
    assert [edge.high for edge in edges] == [True, False]
    assert edges[1].at_s - edges[0].at_s < PULSE_S, "the pulse ended by itself"


def test_a_mute_device_keeps_deadline_and_cancel(trigger, device):
    trigger.configure(TriggerSettings())
    device.mute = True

    def keep_the_deadline():
        with pytest.raises(DeadlineError, match="no whole line"):
            trigger.fire(deadline_s=in_s(0.5), cancel=NEVER)

    def hear_the_cancel():
        cancel = CancelToken()
        threading.Timer(0.1, cancel.cancel, ["enough"]).start()
        with pytest.raises(CancelledError):
            trigger.fire(deadline_s=far(), cancel=cancel)

    assert ends_within(0.6, keep_the_deadline, least_s=0.5)
    assert ends_within(0.1 + 0.2, hear_the_cancel)
    device.mute = False
    assert trigger.counters().pulses == 0


def test_a_stall_is_refused_once_and_cleared(trigger, device):
    device.stalled = True
    with pytest.raises(SettingRefusedError, match="stall"):
        trigger.counters()
    assert trigger.counters().pulses == 0


class LateEcho(UsbDevice):
    """Gives every line back, each a little later than the one before."""

    config = configuration(1, interface(0, [0x81, 0x01], (0xFF, 0, 0)))

    def __init__(self, delays_s):
        super().__init__()
        self._delays_s = iter(delays_s)
        self._due_s, self._line = 0.0, None

    def bulk_out(self, endpoint, sent):
        self._due_s, self._line = time.monotonic() + next(self._delays_s), sent
        return True

    def bulk_in(self, endpoint, length):
        if self._line is None or time.monotonic() < self._due_s:
            return None
        line, self._line = self._line, None
        return line


def test_an_answer_at_the_end_of_a_slice_of_waiting_is_not_lost(bed):
    delays_s = [SLICE_S + 2e-4 * k for k in range(-15, 16)]
    bed.plug(LateEcho(delays_s))
    lines = UsbLines(UsbName(vendor_id=0x1209, product_id=0x0001))
    lines.open()
    for n in range(len(delays_s)):
        lines.send(b"%d\n" % n, deadline_s=far(), cancel=NEVER)
        assert lines.receive(deadline_s=far(), cancel=NEVER) == b"%d" % n
    lines.close()


def test_unplugging_is_an_error_of_its_own_and_replugging_mends_it(bed, program, device):
    port = bed.plug(device)
    trigger = UsbTrigger()
    trigger.open()
    trigger.configure(TriggerSettings())
    threading.Timer(0.1, port.unplug).start()

    def fire_on():
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            with suppress(TriggerNotFiredError):  # the pulse before is still under way
                trigger.fire(deadline_s=far(), cancel=NEVER)

    with pytest.raises(DeviceLostError, match="gone"):
        fire_on()
    with pytest.raises(DeviceLostError, match="gone"):
        trigger.counters()
    trigger.make_safe()
    trigger.close()
    trigger.close()
    bed.forget(port)
    with pytest.raises(DeviceNotFoundError, match="no such device"):
        trigger.open()
    bed.plug(UsbTriggerDevice(program))
    trigger.open()
    assert trigger.counters().pulses == 0
    trigger.close()


def test_two_of_a_kind_are_told_apart_by_serial_number(bed, program):
    devices = [UsbTriggerDevice(program, serial=serial) for serial in ("A1", "B2")]
    for device in devices:
        bed.plug(device)
    with pytest.raises(DeviceNotFoundError, match=r"2 found \(serials: A1, B2\)"):
        UsbTrigger().open()
    trigger = UsbTrigger(serial="B2")
    trigger.open()
    trigger.configure(TriggerSettings())
    trigger.fire(deadline_s=far(), cancel=NEVER)
    time.sleep(trigger.snapshot()["pulse_s"])
    for _ in range(2):  # the firmware's loop has gone round since, and has ended the pulse
        trigger.counters()
    trigger.close()
    assert len(usb_devices()) == 2
    edges = [device.box.unplug() for device in devices]
    assert edges[0] == []
    assert len(edges[1]) == 2


def test_a_device_has_one_owner(port, device, trigger):
    with pytest.raises(DeviceBusyError, match="already"):
        trigger.open()
    trigger.close()
    port.kernel_driver = "cdc_acm"
    with pytest.raises(DeviceBusyError, match="driver of the kernel"):
        trigger.open()
    port.kernel_driver = ""
    port.claimed_elsewhere = True
    with pytest.raises(DeviceBusyError, match="another program"):
        trigger.open()
    with pytest.raises(NotOpenError):
        trigger.counters()
