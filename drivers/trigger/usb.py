"""A trigger box on USB, without a serial adapter: the same lines over bulk transfers."""

from __future__ import annotations

from drivers.transport.usb_transfer import UsbLines, UsbName
from drivers.trigger.box import BoxTrigger

VENDOR_ID, PRODUCT_ID = 0x1209, 0x0001  # pid.codes' number for tests and private use


class UsbTrigger(BoxTrigger):
    """A box that speaks the protocol of drivers/trigger/firmware over a vendor interface.

    Parameters
    ----------
    serial : its serial number, needed where several are plugged in
    """

    def __init__(
        self,
        *,
        vendor_id: int = VENDOR_ID,
        product_id: int = PRODUCT_ID,
        serial: str | None = None,
        watchdog_s: float = 5.0,
    ) -> None:
        name = UsbName(vendor_id=vendor_id, product_id=product_id, serial=serial)
        super().__init__(UsbLines(name), boot_s=0.0, watchdog_s=watchdog_s)
