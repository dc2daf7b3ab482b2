"""The trigger box: the protocol `labrig-trigger 1` over any channel of lines.

The protocol is written down in drivers/trigger/firmware/PROTOCOL.md, beside the reference firmware.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from drivers.errors import (
    DeadlineError,
    DeviceBusyError,
    DeviceNotFoundError,
    DriverError,
    NotOpenError,
    SettingRefusedError,
    TriggerNotFiredError,
)
from drivers.receipts import TriggerReceipt
from drivers.transport.lines import LineChannel
from drivers.trigger.protocol import TriggerCapabilities, TriggerCounters, TriggerSettings
from drivers.waiting import CancelToken

PROTOCOL = "labrig-trigger"
VERSION = 1
CAPABILITIES = TriggerCapabilities(
    pulse_range_s=(10e-6, 1.0),
    delay_range_s=(0.0, 10.0),
    sources=("host", "projector-sync"),
    latency_s=0.02,  # the latency timer of a USB serial adapter, 16 ms, and a line at 115200 baud
)
REPLY_S = 1.0  # a whole exchange takes 20 ms over the slowest adapter; hosts may be loaded
ASK_AGAIN_S = 0.25
LATE_S = 1e-3  # between the box's answer and the edge that its loop gives at the end of a delay
POLL_S = 0.005


class _RefusedError(Exception):
    """Raised when the box answers ``err``; holds its one-word reason."""


class BoxTrigger:
    """A trigger box; `drivers.trigger.serial` and `drivers.trigger.usb` say where it is plugged.

    Parameters
    ----------
    channel : carries the lines
    boot_s : a board that resets when its port is opened answers only after its boot loader
    watchdog_s : the box goes safe by itself when it hears nothing for this time
    """

    def __init__(self, channel: LineChannel, *, boot_s: float, watchdog_s: float) -> None:
        self._channel = channel
        self._boot_s = boot_s
        self._watchdog_s = watchdog_s
        self._identity = {"model": "labrig trigger box", "serial": "", "firmware": ""}
        self._open = False
        self._armed = False
        self._settings = TriggerSettings()
        self._base = (0, 0, 0)
        self._tag = 0

    @property
    def identity(self) -> dict[str, str]:
        """``model``, ``serial`` and ``firmware``."""
        return dict(self._identity)

    def open(self) -> TriggerCapabilities:
        """Connect, quiet; say what the trigger can do.

        Raises
        ------
        DeviceNotFoundError, DeviceBusyError, AccessDeniedError
            With the remedy; also if what answers is no trigger box of this protocol.
        """
        if self._open:
            msg = f"the trigger at {self._channel.name} is open already; close it first."
            raise DeviceBusyError(msg)
        known = self._channel.open()
        try:
            firmware = self._greet()
            self._ask("safe")
            self._ask("dog", round(self._watchdog_s * 1e3))
            counts = self._read("count")
        except _RefusedError as refusal:
            self._channel.close()
            msg = f"the box at {self._channel.name} refused a basic command ({refusal})."
            raise SettingRefusedError(msg) from refusal
        except BaseException:
            self._channel.close()
            raise
        self._base = (int(counts[0]), int(counts[1]), int(counts[2]))
        self._identity = {
            "model": "labrig trigger box",
            "serial": known.get("serial", ""),
            "firmware": firmware,
        }
        self._open, self._armed, self._settings = True, False, TriggerSettings()
        return CAPABILITIES

    def close(self) -> None:
        """Go quiet and disconnect; harmless if done twice, never raises."""
        if self._open:
            self.make_safe()
        self._open = False
        self._channel.close()

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back from the device."""
        self._require_open()
        armed, width_us, delay_us, source, watchdog_ms, tripped, bad = (
            int(word) for word in self._read("state")
        )
        return {
            "port": self._channel.name,
            "armed": bool(armed),
            "pulse_s": width_us * 1e-6,
            "delay_s": delay_us * 1e-6,
            "source": CAPABILITIES.sources[source],
            "watchdog_s": watchdog_ms * 1e-3,
            "watchdog_tripped": bool(tripped),
            "damaged_lines": bad,
        }

    def configure(self, settings: TriggerSettings) -> TriggerSettings:
        """Set pulse, delay and source, and make ready; return what the device really has.

        Raises
        ------
        SettingRefusedError
            If a value is out of range.
        """
        self._require_open()
        _refuse_out_of_range(settings)
        source = CAPABILITIES.sources.index(settings.source)
        try:
            self._ask("set", round(settings.pulse_s * 1e6), round(settings.delay_s * 1e6), source)
            self._ask("arm")
        except _RefusedError as refusal:
            msg = f"the box at {self._channel.name} refused {asdict(settings)} ({refusal})."
            raise SettingRefusedError(msg) from refusal
        found = self.snapshot()
        self._armed = True
        self._settings = TriggerSettings(
            pulse_s=found["pulse_s"], delay_s=found["delay_s"], source=found["source"]
        )
        return self._settings

    def fire(self, *, deadline_s: float, cancel: CancelToken) -> TriggerReceipt:
        """Give one pulse; return when it was given.

        Raises
        ------
        TriggerNotFiredError, DeviceLostError, DeadlineError, CancelledError
        """
        self._require_open()
        cancel.check()
        if not self._armed:
            msg = "the trigger is safe and gives no pulse; call configure() first."
            raise TriggerNotFiredError(msg)
        begin_s = time.monotonic()
        try:
            count = self._fire_armed(deadline_s, cancel)
        except _RefusedError as refusal:
            raise TriggerNotFiredError(self._why_not(str(refusal))) from refusal
        if self._settings.source == "projector-sync":
            self._await_sync(count, deadline_s, cancel)
        return TriggerReceipt(
            earliest_s=begin_s + self._settings.delay_s,
            latest_s=time.monotonic() + self._settings.delay_s + LATE_S,
            count=(count - self._base[0]) % 2**32,
        )

    def counters(self) -> TriggerCounters:
        """Return the counts since `open`."""
        self._require_open()
        now = [int(word) for word in self._read("count")]
        pulses, strobes, syncs = (
            (n - base) % 2**32 for n, base in zip(now, self._base, strict=True)
        )
        return TriggerCounters(pulses=pulses, strobes=strobes, syncs=syncs)

    def make_safe(self) -> None:
        """Give no more pulses whatever the state; bounded, never raises."""
        self._armed = False
        if not self._channel.quiet():
            with suppress(DriverError, _RefusedError):
                self._ask("safe")

    def _greet(self) -> str:
        """Return the firmware's version, waiting for the board to boot.

        Raises
        ------
        DeviceNotFoundError
            If nothing answers, or something else does.
        """
        end_s = time.monotonic() + self._boot_s + REPLY_S
        while True:
            try:
                words = self._ask("id", patience_s=ASK_AGAIN_S)
                break
            except (DeadlineError, _RefusedError) as error:
                if time.monotonic() < end_s:
                    continue
                msg = (
                    f"{self._channel.name} is there but no {PROTOCOL} answers; check that it is "
                    "the box's port and that drivers/trigger/firmware is on the box."
                )
                raise DeviceNotFoundError(msg) from error
        if words[:2] != [PROTOCOL, str(VERSION)] or len(words) != 3:
            msg = (
                f"{self._channel.name} speaks {' '.join(words)}, {PROTOCOL} {VERSION} was wanted; "
                "upload the firmware of this version of labrig."
            )
            raise DeviceNotFoundError(msg)
        return words[2]

    def _fire_armed(self, deadline_s: float, cancel: CancelToken) -> int:
        """Fire; a box that its watchdog disarmed while we were busy elsewhere is armed again."""
        try:
            return int(self._ask("fire", deadline_s=deadline_s, cancel=cancel)[0])
        except _RefusedError as refusal:
            if str(refusal) != "watchdog":
                raise
        self._ask("arm", deadline_s=deadline_s, cancel=cancel)
        return int(self._ask("fire", deadline_s=deadline_s, cancel=cancel)[0])

    def _await_sync(self, count: int, deadline_s: float, cancel: CancelToken) -> None:
        """Wait until the pulse asked for has left.

        Raises
        ------
        TriggerNotFiredError
            If no sync edge came; the box is then armed no more.
        """
        while True:
            if (int(self._read("count")[0]) - count) % 2**32 < 2**31:
                return
            if time.monotonic() >= deadline_s:
                self.make_safe()
                msg = (
                    "no sync edge of the projector came before the deadline; check the wire from "
                    "the projector's sync output to the box, and configure() again."
                )
                raise TriggerNotFiredError(msg)
            try:
                cancel.wait(POLL_S)
            except DriverError:
                self.make_safe()
                raise

    def _why_not(self, reason: str) -> str:
        known = {
            "busy": "a pulse is still under way; fire less often than pulse and delay take.",
            "disarmed": "the box was disarmed, by a reset perhaps; call configure() again.",
        }
        return f"the trigger gave no pulse: {known.get(reason, reason)}"

    def _read(self, command: str) -> list[str]:
        """Ask what changes nothing, once more if no whole answer came: a wire may damage one."""
        try:
            return self._ask(command, patience_s=0.5 * REPLY_S)
        except DeadlineError:
            return self._ask(command)

    def _ask(
        self,
        command: str,
        *numbers: int,
        deadline_s: float | None = None,
        patience_s: float = REPLY_S,
        cancel: CancelToken | None = None,
    ) -> list[str]:
        """Send a command and return the words of its answer.

        Raises
        ------
        _RefusedError
            If the box answers ``err``.
        """
        cancel = cancel or CancelToken()
        if deadline_s is None:
            deadline_s = time.monotonic() + patience_s
        self._tag = self._tag % 99999 + 1
        text = " ".join(str(word) for word in (self._tag, command, *numbers))
        self._channel.send(frame_line(text), deadline_s=deadline_s, cancel=cancel)
        while True:
            line = self._channel.receive(deadline_s=deadline_s, cancel=cancel)
            words = read_line(line)
            # A late answer to an earlier command, or a damaged line, is not this answer.
            if words is None or words[0] != str(self._tag):
                continue
            if words[1] == "ok":
                return words[2:]
            raise _RefusedError(" ".join(words[2:]))

    def _require_open(self) -> None:
        if not self._open:
            msg = f"the trigger at {self._channel.name} is not open; call open() first."
            raise NotOpenError(msg)


def crc8(text: bytes) -> int:
    """Return the CRC-8 of a line, polynomial x^8 + x^2 + x + 1."""
    crc = 0
    for byte in text:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07) & 0xFF if crc & 0x80 else crc << 1
    return crc


def frame_line(text: str) -> bytes:
    """Return a line with its checksum and end."""
    content = text.encode("ascii")
    return b"%s*%02X\n" % (content, crc8(content))


def read_line(line: bytes) -> list[str] | None:
    """Return the words of an answer, at least two; None if it is damaged."""
    content, star, check = line.rpartition(b"*")
    if not star or check != b"%02X" % crc8(content) or not content.isascii():
        return None
    words = content.decode("ascii").split()
    return words if len(words) >= 2 else None


def _refuse_out_of_range(settings: TriggerSettings) -> None:
    for name, value, (low, high) in (
        ("pulse_s", settings.pulse_s, CAPABILITIES.pulse_range_s),
        ("delay_s", settings.delay_s, CAPABILITIES.delay_range_s),
    ):
        if not low <= value <= high:
            msg = (
                f"trigger {name} is {value} s, the box has {low} .. {high} s; change the rig file."
            )
            raise SettingRefusedError(msg)
    if settings.source not in CAPABILITIES.sources:
        msg = (
            f"trigger source {settings.source!r} is unknown; choose one of {CAPABILITIES.sources}."
        )
        raise SettingRefusedError(msg)
