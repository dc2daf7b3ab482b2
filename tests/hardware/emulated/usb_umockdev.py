"""Plugs an emulated device into libusb of this process, by umockdev: no kernel, no root.

The process must have been started by ``umockdev-wrapper``. The ioctls of usbdevfs that libusb makes
are answered here.
"""

from __future__ import annotations

import errno
import gc
import struct
import threading
import time

import gi

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402
from usb.backend import libusb1  # noqa: E402

from emulated.usb_device import Setup, UsbDevice  # noqa: E402


def _request(direction: int, number: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("U") << 8 | number


URB_BYTES = 56
SUBMIT_URB = _request(2, 10, URB_BYTES)
DISCARD_URB = _request(0, 11, 0)
REAP_URB, REAP_URB_NO_DELAY = _request(1, 12, 8), _request(1, 13, 8)
GET_CAPABILITIES = _request(2, 26, 4)
GET_DRIVER, GET_SPEED = _request(1, 8, 260), _request(0, 31, 0)
CLAIM, RELEASE = _request(2, 15, 4), _request(2, 16, 4)
SET_CONFIGURATION, SET_INTERFACE = _request(2, 5, 4), _request(2, 4, 8)
CLEAR_HALT, RESET, DISCONNECT_CLAIM = _request(2, 21, 4), _request(0, 20, 0), _request(2, 27, 264)
HARMLESS = {RELEASE, SET_CONFIGURATION, SET_INTERFACE, RESET}
HIGH_SPEED = 3
BULK_CONTINUATION_AND_ZERO_PACKET = 0x05
CONTROL_URB = 2


class _Pending:
    """A bulk IN that waits for bytes."""

    def __init__(self, urb: UMockdev.IoctlData, buffer: UMockdev.IoctlData, raw: bytes) -> None:
        self.urb, self.buffer = urb, buffer
        self.endpoint = raw[1] & 0x0F
        self.length = struct.unpack_from("<i", raw, 24)[0]


class Port(UMockdev.IoctlBase):
    """Where a device is plugged in, and the hands that pull it out."""

    def __init__(self, device: UsbDevice) -> None:
        super().__init__()
        self._unplugged = False
        self.kernel_driver = ""
        self.claimed_elsewhere = False
        self._device = device
        self._done: list[UMockdev.IoctlData] = []
        self._pending: list[_Pending] = []
        self._lock = threading.RLock()

    def unplug(self) -> None:
        """Pull the device out: what is under way ends with an error, as the kernel does it."""
        with self._lock:
            self._unplugged = True

    def do_handle_ioctl(self, client: UMockdev.IoctlClient) -> bool:
        """Answer one ioctl of libusb."""
        request = client.props.request & 0xFFFFFFFF
        try:
            result, error = self._answer(request, client.props.arg)
        except OSError:  # the box behind the device has gone; libusb would wait for ever
            result, error = -1, errno.EIO
        client.complete(result, error)
        return True

    def _answer(self, request: int, arg: UMockdev.IoctlData) -> tuple[int, int]:
        reaping = request in (REAP_URB, REAP_URB_NO_DELAY)
        with self._lock:
            # Here and nowhere else is the memory of libusb written: umockdev sends what is written
            # over the same stream as its answers, and two threads would mix them.
            self._pump()
            if self._unplugged and not (reaping and self._done):
                return -1, errno.ENODEV
            if request == SUBMIT_URB:
                self._submit(arg.resolve(0, URB_BYTES))
            elif request == DISCARD_URB:
                return self._discard(arg.resolve(0, URB_BYTES).client_addr)
            elif reaping:
                if not self._done:
                    time.sleep(1e-3)  # libusb asks at once again, and would starve who is to answer
                    return -1, errno.EAGAIN
                arg.resolve(0, 8).set_ptr(0, self._done.pop(0))
            else:
                return self._administer(request, arg)
        return 0, 0

    def _administer(self, request: int, arg: UMockdev.IoctlData) -> tuple[int, int]:
        if request == GET_CAPABILITIES:
            arg.resolve(0, 4).update(0, struct.pack("<I", BULK_CONTINUATION_AND_ZERO_PACKET))
        elif request == GET_SPEED:
            return HIGH_SPEED, 0
        elif request == GET_DRIVER:
            if not self.kernel_driver:
                return -1, errno.ENODATA
            arg.resolve(0, 260).update(4, self.kernel_driver.encode() + b"\0")
        elif request in (CLAIM, DISCONNECT_CLAIM):
            return (-1, errno.EBUSY) if self.claimed_elsewhere else (0, 0)
        elif request == CLEAR_HALT:
            endpoint = struct.unpack("<I", bytes(arg.resolve(0, 4).retrieve()))[0]
            self._device.clear_halt(endpoint)
        elif request not in HARMLESS:
            return -1, errno.ENOTTY
        return 0, 0

    def _submit(self, urb: UMockdev.IoctlData) -> None:
        raw = bytes(urb.retrieve())
        length = struct.unpack_from("<i", raw, 24)[0]
        buffer = urb.resolve(16, length)
        if raw[0] == CONTROL_URB:
            self._control(urb, buffer)
        elif raw[1] & 0x80:
            self._pending.append(_Pending(urb, buffer, raw))
        else:
            taken = self._device.bulk_out(raw[1], bytes(buffer.retrieve()))
            self._finish(urb, 0 if taken else -errno.EPIPE, length if taken else 0)

    def _control(self, urb: UMockdev.IoctlData, buffer: UMockdev.IoctlData) -> None:
        content = bytes(buffer.retrieve())
        setup = Setup.parse(content[:8])
        answer = self._device.setup(setup, b"" if setup.to_host else content[8:])
        if answer is None:
            self._finish(urb, -errno.EPIPE, 0)
        elif setup.to_host:
            buffer.update(8, answer[: setup.length])
            self._finish(urb, 0, len(answer[: setup.length]))
        else:
            self._finish(urb, 0, setup.length)

    def _discard(self, address: int) -> tuple[int, int]:
        for pending in self._pending:
            if pending.urb.client_addr == address:
                self._pending.remove(pending)
                self._finish(pending.urb, -errno.ENOENT, 0)
                return 0, 0
        return -1, errno.EINVAL

    def _pump(self) -> None:
        """Answer what waits; libusb asks again and again while anything does."""
        for pending in list(self._pending):
            if self._unplugged:
                self._pending.remove(pending)
                self._finish(pending.urb, -errno.ESHUTDOWN, 0)
                continue
            answer = self._device.bulk_in(pending.endpoint, pending.length)
            if answer is not None:
                self._pending.remove(pending)
                pending.buffer.update(0, answer)
                self._finish(pending.urb, 0, len(answer))

    def _finish(self, urb: UMockdev.IoctlData, status: int, length: int) -> None:
        urb.update(4, struct.pack("<i", status))
        urb.update(28, struct.pack("<i", length))
        self._done.append(urb)


def _list_devices_anew() -> None:
    """Drop libusb's context: it learns of devices from udevd, which does not know this bus."""
    gc.collect()
    libusb1._lib_object = None


class UsbBus:
    """The USB bus of this process; closed before the process ends."""

    def __init__(self) -> None:
        self._bed = UMockdev.Testbed.new()
        self._loop = GLib.MainLoop()
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()
        self._number = 0

    def plug(self, device: UsbDevice) -> Port:
        """Plug a device in; it has an address of its own."""
        self._number += 1
        n = self._number
        descriptors = (device.device_descriptor() + device.config).hex().upper()
        node = f"/dev/bus/usb/001/{n:03d}"
        facts = {
            "busnum": "1",
            "devnum": str(n),
            "speed": "480",
            "bConfigurationValue": "1",
            "idVendor": f"{device.vendor_id:04x}",
            "idProduct": f"{device.product_id:04x}",
        }
        self._bed.add_from_string(
            f"P: /devices/usb1/1-{n}\nN: {node.removeprefix('/dev/')}={descriptors}\n"
            f"E: DEVTYPE=usb_device\nE: SUBSYSTEM=usb\nE: BUSNUM=001\nE: DEVNUM={n:03d}\n"
            f"E: DEVNAME={node}\nH: descriptors={descriptors}\n"
            + "".join(f"A: {key}={value}\\n\n" for key, value in facts.items())
        )
        port = Port(device)
        self._bed.attach_ioctl(node, port)
        port.path = f"/sys/devices/usb1/1-{n}"
        port.node = node
        _list_devices_anew()
        return port

    def forget(self, port: Port) -> None:
        """Take a device off the bus: it is found no more, and what is open fails."""
        port.unplug()
        self._bed.uevent(port.path, "remove")
        self._bed.remove_device(port.path)
        _list_devices_anew()

    def close(self) -> None:
        """Stop answering."""
        self._loop.quit()
        self._thread.join(timeout=5)
        # Finalised later it would take the environment of the next bus away.
        self._bed = None
        gc.collect()
