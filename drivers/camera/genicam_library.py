"""Aravis, loaded when a camera needs it: it comes with the system, not with Python."""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

from drivers.errors import DeviceNotFoundError

WATCH_S, WATCH_STOP_S = 1.0, 6.0  # a call to a camera that is gone takes up to five seconds
REMEDY = "sudo apt-get install gir1.2-aravis-0.8 python3-gi && make genicam"


class _Library:
    """The Aravis namespace, with GLib's error class as ``error``."""

    def __init__(self, namespace: Any, error: type[Exception]) -> None:
        self._namespace = namespace
        self.error = error

    def __getattr__(self, name: str) -> Any:
        return getattr(self._namespace, name)


@cache
def aravis() -> Any:
    """Return the Aravis library.

    Raises
    ------
    DeviceNotFoundError
        If it is not installed; the message is the command that does.
    """
    try:
        import gi  # noqa: PLC0415 - an optional extra

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis, GLib  # noqa: PLC0415
    except (ImportError, ValueError) as error:
        msg = f"Aravis is not installed, and with it no GenICam camera works; run: {REMEDY}"
        raise DeviceNotFoundError(msg) from error
    return _Library(Aravis, GLib.Error)


def same_device(lib: Any, error: Any) -> bool:
    """Return whether a device that gave an error is still there: it refused, but it answered."""
    gone = {
        lib.DeviceError.TIMEOUT,
        lib.DeviceError.TRANSFER_ERROR,
        lib.DeviceError.NOT_CONNECTED,
        lib.DeviceError.NOT_FOUND,
    }
    if error.domain != "arv-device-error-quark":
        return True
    return error.code not in {int(code) for code in gone}


def genicam_cameras() -> list[tuple[str, str, str]]:
    """Return name, model and serial number of every camera Aravis sees."""
    lib = aravis()
    lib.update_device_list()
    return [
        (lib.get_device_id(k), lib.get_device_model(k), lib.get_device_serial_nbr(k))
        for k in range(lib.get_n_devices())
    ]


def find_camera(wanted: str) -> str:
    """Return the name of the one camera of a name or serial number; raise `DeviceNotFoundError`."""
    found = genicam_cameras()
    fitting = [name for name, _, serial in found if wanted in (name, serial)]
    if len(fitting) == 1:
        return fitting[0]
    there = ", ".join(f"{name} (serial {serial})" for name, _, serial in found) or "none"
    msg = (
        f"{len(fitting)} cameras are called {wanted!r}; Aravis sees: {there}; check power and net."
    )
    raise DeviceNotFoundError(msg)


class Watch:
    """Asks an open camera every second whether it is still there.

    Aravis' own signal of a lost camera did not come in our tests with a GigE camera, and a camera
    that only sends when triggered is silent also when it is well.
    """

    def __init__(self, camera: Any) -> None:
        self.lost = False
        self._device = camera.get_device()
        self._device.connect("control-lost", self._on_lost)
        # A register that every camera has: control privilege of GigE, version of USB3 Vision.
        self._register = 0x0A00 if camera.is_gv_device() else 0x0000
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ask no more; bounded."""
        self._stop.set()
        self._thread.join(timeout=WATCH_STOP_S)
        self._device = None

    def _ask(self) -> None:
        error = aravis().error
        while not self._stop.wait(WATCH_S):
            try:
                self._device.read_register(self._register)
            except error:
                self.lost = True
                return

    def _on_lost(self, _device: Any) -> None:
        self.lost = True
