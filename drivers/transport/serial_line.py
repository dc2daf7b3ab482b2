"""Lines of bytes over a serial port; every way a port can fail becomes one of our errors."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import serial
from serial.tools import list_ports

from drivers.errors import (
    AccessDeniedError,
    DeadlineError,
    DeviceBusyError,
    DeviceLostError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.transport.lines import take_line
from drivers.waiting import SLICE_S, CancelToken

BY_ID = Path("/dev/serial/by-id")
_NOT_THERE = {errno.ENOENT, errno.ENXIO, errno.ENODEV}
_DENIED = {errno.EACCES, errno.EPERM}
_BUSY = {errno.EBUSY, errno.EAGAIN}
_UNFIT = {errno.EINVAL, errno.ENOTTY}


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPort:
    """A port found on this machine; ``path`` is the name that survives a replug if there is one."""

    path: str
    description: str
    serial_number: str


def serial_ports(by_id: Path = BY_ID) -> list[SerialPort]:
    """Return the ports of this machine, none of them opened."""
    stable = {str(link.resolve()): str(link) for link in sorted(by_id.glob("*"))}
    return [
        SerialPort(
            path=stable.get(port.device, port.device),
            description=port.description or "",
            serial_number=port.serial_number or "",
        )
        for port in sorted(list_ports.comports())
    ]


class SerialLine:
    """A serial port held by this program alone."""

    def __init__(self, path: str, *, baud: int) -> None:
        self._path = path
        self._baud = baud
        self._port: serial.Serial | None = None
        self._received = bytearray()

    @property
    def name(self) -> str:
        """Where it leads, for messages."""
        return f"serial port {self._path}"

    def open(self) -> dict[str, str]:
        """Open the port for this program alone; return ``model`` and ``serial`` of its adapter.

        Raises
        ------
        DeviceNotFoundError, AccessDeniedError, DeviceBusyError, SettingRefusedError
            Each with the remedy.
        """
        if self._port is not None:
            msg = f"{self.name} is open already in this program; close it first."
            raise DeviceBusyError(msg)
        self._received.clear()
        with self._explained(opening=True):
            # Timeouts of zero: waiting is done here, against one deadline, and not once per byte.
            self._port = serial.Serial(
                self._path, self._baud, timeout=0, write_timeout=0, exclusive=True
            )
            with suppress(OSError):  # a lock binds only those who ask; this refuses all but root
                fcntl.ioctl(self._port.fileno(), termios.TIOCEXCL)
        device = os.path.realpath(self._path)
        for port in list_ports.comports():
            if port.device == device:
                return {"model": port.description or "", "serial": port.serial_number or ""}
        return {"model": "", "serial": ""}

    def close(self) -> None:
        """Close the port; harmless if done twice."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError, serial.SerialException, termios.error):
                port.close()

    def send(self, line: bytes, *, deadline_s: float, cancel: CancelToken) -> None:
        """Send one line.

        Raises
        ------
        DeadlineError, DeviceLostError, CancelledError
        """
        port = self._opened()
        while line:
            cancel.check()
            with self._explained():
                ready = select.select([], [port.fileno()], [], _slice(deadline_s))[1]
                if ready:
                    line = line[port.write(line) or 0 :]
            if line and time.monotonic() >= deadline_s:
                msg = (
                    f"{self.name} took no bytes before the deadline; the device is stuck or its "
                    "flow control holds: power it off and on."
                )
                raise DeadlineError(msg)

    def receive(self, *, deadline_s: float, cancel: CancelToken) -> bytes:
        """Return the next whole line.

        Raises
        ------
        DeadlineError, DeviceLostError, CancelledError
        """
        port = self._opened()
        while (line := take_line(self._received)) is None:
            cancel.check()
            with self._explained():
                ready = select.select([port.fileno()], [], [], _slice(deadline_s))[0]
                if ready:
                    self._received += port.read(4096)
            if not ready and time.monotonic() >= deadline_s:
                msg = (
                    f"{self.name} sent {len(self._received)} bytes and no whole line before the "
                    f"deadline; check that the box has power, that the port is the box's, and that "
                    f"it speaks {self._baud} baud."
                )
                raise DeadlineError(msg)
        return line

    def quiet(self) -> bool:
        """There is no way beside the lines."""
        return False

    def _opened(self) -> serial.Serial:
        if self._port is None:
            msg = f"{self.name} is not open; call open() first."
            raise NotOpenError(msg)
        return self._port

    @contextmanager
    def _explained(self, *, opening: bool = False) -> Iterator[None]:
        """Turn what pyserial and the system raise into our errors."""
        try:
            yield
        except (serial.SerialException, termios.error, OSError, ValueError) as error:
            if opening:
                self.close()
                raise self._cannot_open(error) from error
            msg = f"{self.name} has gone ({_reason(error)}); plug the device in and open it again."
            raise DeviceLostError(msg) from error

    def _cannot_open(self, error: Exception) -> DriverError:
        number = _number(error)
        if number in _NOT_THERE:
            there = ", ".join(port.path for port in serial_ports()) or "none"
            msg = (
                f"{self.name} does not exist; plug the box in, or name one that is there: {there}."
            )
            return DeviceNotFoundError(msg)
        if number in _DENIED:
            msg = f"{self.name} may not be opened by this user; run: labrig doctor --fix-udev"
            return AccessDeniedError(msg)
        if number in _BUSY:
            msg = f"{self.name} is held by another program; close that (fuser {self._path})."
            return DeviceBusyError(msg)
        if number in _UNFIT or isinstance(error, ValueError):
            msg = f"{self.name} does not take {self._baud} baud, 8 bits, no parity; is it a port?"
            return SettingRefusedError(msg)
        return DeviceLostError(f"{self.name} failed while opening ({_reason(error)}); replug it.")


def _slice(deadline_s: float) -> float:
    return min(max(deadline_s - time.monotonic(), 0.0), SLICE_S)


def _number(error: Exception) -> int | None:
    if isinstance(error, serial.SerialException) and error.errno is None:
        cause = error.__context__  # pyserial wraps what termios raises into a bare text
        return _number(cause) if isinstance(cause, termios.error) else None
    if isinstance(error, OSError):
        return error.errno
    found = error.args[0] if error.args else None
    return found if isinstance(found, int) else None


def _reason(error: Exception) -> str:
    number = _number(error)
    return str(error) if number is None else os.strerror(number)
