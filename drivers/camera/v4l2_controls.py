"""The controls of a V4L2 camera, by name, each read back after it was set."""

from __future__ import annotations

import errno
import re
from dataclasses import dataclass

from drivers.errors import DeviceLostError, SettingRefusedError
from drivers.transport import v4l2_ioctl as v4l2

EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
EXPOSURE_UNIT_S = 100e-6
MANUAL = 1
# What must be off before counts mean light, and its value when it is off. First the automatic
# exposure: while it is on, the exposure itself is refused.
AUTOMATICS = {
    EXPOSURE_AUTO: MANUAL,
    EXPOSURE_AUTO_PRIORITY: 0,
    0x980912: 0,  # gain
    0x98090C: 0,  # white balance
    0x980919: 0,  # hue
    0x98091C: 0,  # backlight compensation
    0x9A090C: 0,  # focus
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlInfo:
    """A control: its number, name and range."""

    number: int
    name: str
    minimum: int
    maximum: int
    step: int
    flags: int


class Controls:
    """All controls of one device."""

    def __init__(self, node: v4l2.VideoNode) -> None:
        self._node = node
        found = self._enumerate()
        self._by_name = {control.name: control for control in found}
        self._by_number = {control.number: control for control in found}

    def has(self, number: int) -> bool:
        """Return whether the device has a standard control."""
        return number in self._by_number

    def info(self, number: int) -> ControlInfo:
        """Return what is known of a standard control the device has."""
        return self._by_number[number]

    def automatics_off(self) -> None:
        """Switch off whatever changes the picture by itself.

        Raises
        ------
        SettingRefusedError
            If something stays on.
        """
        for number, off in AUTOMATICS.items():
            if number in self._by_number and not self._by_number[number].flags & _FIXED:
                self.set(self._by_number[number].name, off)

    def set(self, name: str, value: int) -> None:
        """Set a control and read it back.

        Raises
        ------
        SettingRefusedError
            If there is none of this name, the value is out of range, or the device has another.
        """
        control = self._by_name.get(name)
        if control is None:
            msg = f"the camera has no control {name!r}; it has: {', '.join(sorted(self._by_name))}."
            raise SettingRefusedError(msg)
        if not control.minimum <= value <= control.maximum:
            msg = f"control {name} = {value} is outside {control.minimum} .. {control.maximum}."
            raise SettingRefusedError(msg)
        try:
            self._node.call(v4l2.S_CTRL, v4l2.Control(id=control.number, value=value))
        except OSError as error:
            if error.errno == errno.ENODEV:
                msg = f"the camera has gone while setting {name}; plug it in and open it again."
                raise DeviceLostError(msg) from error
            msg = (
                f"the camera refused control {name} = {value} ({error.strerror}); an automatic "
                "function that is on may hold it."
            )
            raise SettingRefusedError(msg) from error
        found = self.get(name)
        if found != value:
            msg = f"control {name} was set to {value} and reads {found}; step {control.step}?"
            raise SettingRefusedError(msg)

    def get(self, name: str) -> int:
        """Return a control's value as the device has it; raise `DeviceLostError`."""
        control = v4l2.Control(id=self._by_name[name].number)
        try:
            self._node.call(v4l2.G_CTRL, control)
        except OSError as error:
            msg = f"control {name} cannot be read ({error.strerror}); is the camera still there?"
            raise DeviceLostError(msg) from error
        return int(control.value)

    def snapshot(self) -> dict[str, int]:
        """Return every readable control's value."""
        unread = v4l2.CTRL_FLAG_WRITE_ONLY | v4l2.CTRL_FLAG_DISABLED
        values = {}
        for name, control in sorted(self._by_name.items()):
            if not control.flags & unread:
                values[name] = self.get(name)
        return values

    def _enumerate(self) -> list[ControlInfo]:
        found: list[ControlInfo] = []
        query = v4l2.QueryControl(id=v4l2.CTRL_NEXT)
        while True:
            try:
                self._node.call(v4l2.QUERYCTRL, query)
            except OSError:  # the end of the list, or a device without controls
                return found
            if query.type in _NUMERIC:
                found.append(
                    ControlInfo(
                        number=query.id,
                        name=_plain(query.name.decode("ascii", "replace")),
                        minimum=query.minimum,
                        maximum=query.maximum,
                        step=query.step,
                        flags=query.flags,
                    )
                )
            query = v4l2.QueryControl(id=query.id | v4l2.CTRL_NEXT)


_FIXED = v4l2.CTRL_FLAG_READ_ONLY | v4l2.CTRL_FLAG_DISABLED | v4l2.CTRL_FLAG_GRABBED
_NUMERIC = {1, 2, 3, 8, 9}  # integer, boolean, menu, bit mask, integer menu


def _plain(name: str) -> str:
    """Return a control's name as v4l2-ctl writes it: exposure_time_absolute."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
