"""Lines of bytes over the bulk endpoints of a USB device; failures become our errors."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import usb.core
import usb.util

from drivers.errors import (
    AccessDeniedError,
    DeadlineError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.transport.lines import take_line
from drivers.waiting import SLICE_S, CancelToken

OUT, IN = 0x01, 0x81
QUIET = 1  # vendor control request
CHUNK = 512
CONTROL_MS = 500
_VENDOR_OUT = 0x40


@dataclass(frozen=True, slots=True, kw_only=True)
class UsbName:
    """Which device: its numbers, and its serial number where there are several."""

    vendor_id: int
    product_id: int
    serial: str | None = None

    def __str__(self) -> str:
        which = f" serial {self.serial}" if self.serial else ""
        return f"USB device {self.vendor_id:04x}:{self.product_id:04x}{which}"


class UsbLines:
    """A USB device whose bulk endpoints carry lines, held by this program alone."""

    def __init__(self, name: UsbName) -> None:
        self._name = name
        self._device: Any = None
        self._received = bytearray()

    @property
    def name(self) -> str:
        """Where it leads, for messages."""
        return str(self._name)

    def open(self) -> dict[str, str]:
        """Claim the device for this program alone; return its ``model`` and ``serial``.

        Raises
        ------
        DeviceNotFoundError, AccessDeniedError, DeviceBusyError
            Each with the remedy.
        """
        if self._device is not None:
            msg = f"{self.name} is open already in this program; close it first."
            raise DeviceBusyError(msg)
        self._received.clear()
        device, known = self._find()
        with self._explained():
            driver = device.is_kernel_driver_active(0)
        if driver:
            msg = (
                f"{self.name} is held by a driver of the kernel; unbind that, or give the device "
                "an identity of its own."
            )
            raise DeviceBusyError(msg)
        with self._explained():
            # Setting a configuration that is set already would reset another program's transfers.
            if _configured(device) is None:
                device.set_configuration()
            usb.util.claim_interface(device, 0)
        self._device = device
        return known

    def close(self) -> None:
        """Let the device go; harmless if done twice."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(usb.core.USBError):
                usb.util.release_interface(device, 0)
            with suppress(usb.core.USBError):
                usb.util.dispose_resources(device)

    def send(self, line: bytes, *, deadline_s: float, cancel: CancelToken) -> None:
        """Send one line.

        Raises
        ------
        DeadlineError, DeviceLostError, SettingRefusedError, CancelledError
        """
        device = self._opened()
        while True:
            cancel.check()
            try:
                with self._explained(OUT):
                    device.write(OUT, line, _slice_ms(deadline_s))
            except usb.core.USBTimeoutError as error:
                if time.monotonic() >= deadline_s:
                    msg = f"{self.name} took no bytes before the deadline; replug it."
                    raise DeadlineError(msg) from error
            else:
                return

    def receive(self, *, deadline_s: float, cancel: CancelToken) -> bytes:
        """Return the next whole line.

        Raises
        ------
        DeadlineError, DeviceLostError, SettingRefusedError, CancelledError
        """
        device = self._opened()
        while (line := take_line(self._received)) is None:
            cancel.check()
            try:
                with self._explained(IN):
                    self._received += bytes(device.read(IN, CHUNK, _slice_ms(deadline_s)))
            except usb.core.USBTimeoutError as error:
                if time.monotonic() >= deadline_s:
                    msg = (
                        f"{self.name} sent {len(self._received)} bytes and no whole line before "
                        "the deadline; its firmware hangs, replug it."
                    )
                    raise DeadlineError(msg) from error
        return line

    def quiet(self) -> bool:
        """Ask for silence over the control endpoint, which answers when the bulk pipe is stuck."""
        if self._device is None:
            return False
        try:
            self._device.ctrl_transfer(_VENDOR_OUT, QUIET, 0, 0, None, CONTROL_MS)
        except usb.core.USBError:
            return False
        return True

    def _find(self) -> tuple[Any, dict[str, str]]:
        try:
            found = list(
                usb.core.find(
                    find_all=True,
                    idVendor=self._name.vendor_id,
                    idProduct=self._name.product_id,
                )
                or ()
            )
        except usb.core.NoBackendError as error:
            msg = "libusb is not installed; run: sudo apt-get install libusb-1.0-0"
            raise DeviceNotFoundError(msg) from error
        known = [(device, self._strings(device)) for device in found]
        fitting = [k for k in known if self._name.serial in (None, k[1]["serial"])]
        if len(fitting) == 1:
            return fitting[0]
        serials = ", ".join(sorted(k[1]["serial"] or "none" for k in known)) or "no such device"
        remedy = "give the serial of one" if fitting else "plug it in, or name another"
        msg = f"{self.name}: {len(fitting)} found (serials: {serials}); {remedy}."
        raise DeviceNotFoundError(msg)

    def _strings(self, device: Any) -> dict[str, str]:
        try:
            with self._explained():
                return {"model": device.product or "", "serial": device.serial_number or ""}
        except ValueError as error:  # pyusb has no better word for a device it may not ask
            msg = f"{self.name} may not be read by this user; run: labrig doctor --fix-udev"
            raise AccessDeniedError(msg) from error

    def _opened(self) -> Any:
        if self._device is None:
            msg = f"{self.name} is not open; call open() first."
            raise NotOpenError(msg)
        return self._device

    @contextmanager
    def _explained(self, endpoint: int | None = None) -> Iterator[None]:
        """Turn what libusb reports into our errors; a time-out is left to the caller."""
        try:
            yield
        except usb.core.USBTimeoutError:
            raise
        except usb.core.USBError as error:
            if error.errno in (errno.EACCES, errno.EPERM):
                msg = f"{self.name} may not be opened by this user; run: labrig doctor --fix-udev"
                raise AccessDeniedError(msg) from error
            if error.errno == errno.EBUSY:
                msg = f"{self.name} is held by another program; close that."
                raise DeviceBusyError(msg) from error
            if error.errno == errno.EPIPE and endpoint is not None:
                with suppress(usb.core.USBError):
                    self._device.clear_halt(endpoint)
                msg = f"{self.name} refused a transfer (stall); is its firmware of this version?"
                raise SettingRefusedError(msg) from error
            msg = f"{self.name} has gone ({error.strerror}); plug it in and open it again."
            raise DeviceLostError(msg) from error


def usb_devices() -> list[str]:
    """Return vendor, product and place of every USB device; nothing is opened."""
    try:
        found = list(usb.core.find(find_all=True) or ())
    except usb.core.NoBackendError:
        return []
    return [f"{d.idVendor:04x}:{d.idProduct:04x} at bus {d.bus} device {d.address}" for d in found]


def _configured(device: Any) -> Any:
    try:
        return device.get_active_configuration()
    except usb.core.USBError as error:
        if error.errno in (errno.ENODEV, errno.EACCES):
            raise
        return None


def _slice_ms(deadline_s: float) -> int:
    # Zero means for ever to libusb.
    return max(int(1e3 * min(deadline_s - time.monotonic(), SLICE_S)), 1)
