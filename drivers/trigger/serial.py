"""A trigger box on a serial port."""

from __future__ import annotations

from drivers.transport.serial_line import SerialLine
from drivers.trigger.box import BoxTrigger

BAUD = 115200
BOOT_S = 3.0  # an Arduino resets when its port is opened; its boot loader waits up to 2 s


class SerialTrigger(BoxTrigger):
    """A box with the firmware of drivers/trigger/firmware, named by its port.

    Parameters
    ----------
    port : best a link in /dev/serial/by-id, which survives a replug
    """

    def __init__(
        self, port: str, *, baud: int = BAUD, boot_s: float = BOOT_S, watchdog_s: float = 5.0
    ) -> None:
        super().__init__(SerialLine(port, baud=baud), boot_s=boot_s, watchdog_s=watchdog_s)
