"""What every projector must do."""

import time

import numpy as np
import pytest
from deadlines import AT_ONCE_S, ends_within, far, in_s

from drivers.errors import (
    CancelledError,
    DeviceBusyError,
    DeviceLostError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.waiting import CancelToken

NEVER = CancelToken()


def images(can, n=2):
    return list(np.random.default_rng(5).integers(0, 256, (n, can.rows, can.cols), np.uint8))


def show(device, handle, cancel=NEVER):
    return device.show(handle, deadline_s=far(), cancel=cancel)


def test_it_opens_once_and_closes_as_often_as_one_likes(projector):
    device = projector.device
    can = device.open()
    assert can.latency_s[0] <= can.latency_s[1]
    with pytest.raises(DeviceBusyError):
        device.open()
    assert device.snapshot()
    device.close()
    device.close()
    with pytest.raises(NotOpenError):
        device.black(deadline_s=far(), cancel=NEVER)
    device.open()


def test_what_is_shown_is_what_was_loaded_and_its_receipt_is_in_order(projector):
    device = projector.device
    handles = device.load(images(device.open()))
    assert handles[0].digest != handles[1].digest
    assert device.current() is None
    for handle in handles:
        begin_s = time.monotonic()
        receipt = show(device, handle)
        assert receipt.handle == handle == device.current()
        assert begin_s <= receipt.requested_s <= receipt.earliest_s <= receipt.latest_s
    assert device.black(deadline_s=far(), cancel=NEVER).handle is None
    assert device.current() is None


def test_what_does_not_fit_is_refused_and_changes_nothing(projector):
    device = projector.device
    can = device.open()
    (kept,) = device.load(images(can, 1))
    show(device, kept)
    with pytest.raises(SettingRefusedError, match="never scaled"):
        device.load([np.zeros((can.rows, can.cols + 1), np.uint8)])
    assert device.current() == kept


def test_a_set_cancel_token_shows_nothing(projector):
    device = projector.device
    (handle,) = device.load(images(device.open(), 1))
    over = CancelToken()
    over.cancel("over")

    def refuse():
        with pytest.raises(CancelledError, match="over"):
            show(device, handle, over)

    assert ends_within(0.2, refuse)
    assert device.current() is None


@pytest.mark.parametrize("step", ["never opened", "opened", "loaded", "shown", "refused"])
def test_it_is_safe_after_any_step(projector, step):
    device = projector.device
    if step != "never opened":
        can = device.open()
        if step != "opened":
            (handle,) = device.load(images(can, 1))
            if step != "loaded":
                show(device, handle)
            if step == "refused":
                with pytest.raises(SettingRefusedError):
                    device.load([np.zeros((1, 1), np.uint8)])
    promised = in_s(AT_ONCE_S)
    device.make_safe()
    assert time.monotonic() < promised
    assert device.current() is None


def test_unplugged_it_is_lost_then_safe_then_opened_again(projector):
    device = projector.device
    (handle,) = device.load(images(device.open(), 1))
    show(device, handle)
    projector.unplug()
    with pytest.raises(DeviceLostError):
        show(device, handle)
    device.make_safe()
    device.close()
    device.close()
