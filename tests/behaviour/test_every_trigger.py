"""What every trigger must do."""

import time

import pytest
from deadlines import AT_ONCE_S, ends_within, far, in_s

from drivers.errors import (
    CancelledError,
    DeviceBusyError,
    DriverError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.trigger.protocol import TriggerSettings
from drivers.waiting import CancelToken

NEVER = CancelToken()


def fire(device, cancel=NEVER):
    receipt = device.fire(deadline_s=far(), cancel=cancel)
    time.sleep(0.02)  # the pulse is over before the next
    return receipt


def test_it_opens_once_and_closes_as_often_as_one_likes(trigger):
    device = trigger.device
    can = device.open()
    assert can.pulse_range_s[0] < can.pulse_range_s[1]
    with pytest.raises(DeviceBusyError):
        device.open()
    device.close()
    device.close()
    with pytest.raises(NotOpenError):
        device.fire(deadline_s=far(), cancel=NEVER)
    device.open()


def test_settings_are_applied_and_read_back_and_wrong_ones_change_nothing(trigger):
    device = trigger.device
    can = device.open()
    applied = device.configure(TriggerSettings(pulse_s=2e-3, delay_s=5e-3))
    assert applied.pulse_s == pytest.approx(2e-3, abs=1e-6)
    assert device.snapshot()["delay_s"] == pytest.approx(5e-3, abs=1e-6)
    before = device.snapshot()
    with pytest.raises(SettingRefusedError):
        device.configure(TriggerSettings(pulse_s=2 * can.pulse_range_s[1]))
    assert device.snapshot() == before


def test_pulses_are_counted_from_opening(trigger):
    device = trigger.device
    device.open()
    device.configure(TriggerSettings())
    assert [fire(device).count for _ in range(3)] == [1, 2, 3]
    assert device.counters().pulses == 3
    device.close()
    device.open()
    assert device.counters().pulses == 0


def test_a_receipt_bounds_its_edge(trigger):
    device = trigger.device
    device.open()
    device.configure(TriggerSettings(delay_s=0.01))
    begin_s = time.monotonic()
    receipt = fire(device)
    assert begin_s <= receipt.earliest_s <= receipt.latest_s
    assert receipt.latest_s >= begin_s + 0.01
    assert receipt.latest_s - receipt.earliest_s < 0.5


def test_a_set_cancel_token_gives_no_pulse(trigger):
    device = trigger.device
    device.open()
    device.configure(TriggerSettings())
    over = CancelToken()
    over.cancel("over")

    def refuse():
        with pytest.raises(CancelledError):
            device.fire(deadline_s=far(), cancel=over)

    assert ends_within(0.2, refuse)
    assert device.counters().pulses == 0


@pytest.mark.parametrize("step", ["never opened", "opened", "configured", "fired", "unplugged"])
def test_it_is_safe_after_any_step(trigger, step):
    device = trigger.device
    if step != "never opened":
        device.open()
        if step != "opened":
            device.configure(TriggerSettings())
        if step == "fired":
            fire(device)
        if step == "unplugged":
            trigger.unplug()
    promised = in_s(AT_ONCE_S)
    device.make_safe()
    assert time.monotonic() < promised
    device.close()


def test_a_box_that_was_unplugged_is_an_error(trigger, request):
    if "simulated" in request.node.name:
        pytest.skip("the simulated trigger has no plug")
    trigger.device.open()
    trigger.device.configure(TriggerSettings())
    trigger.unplug()
    with pytest.raises(DriverError, match="gone"):
        fire(trigger.device)
