"""A USB3 Vision camera: GenCP registers, a GenICam description of its own, and an image stream."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from emulated.usb_device import UsbDevice, configuration, interface

# Where things lie in the camera's memory; the first two are the standard's.
SBRM, SIRM, MANIFEST, DESCRIPTION, FEATURES = 0x10000, 0x20000, 0x30000, 0x40000, 0x100000
CONTROL_MAGIC, LEADER_MAGIC, TRAILER_MAGIC = 0x43563355, 0x4C563355, 0x54563355
READ, READ_ACK, WRITE, WRITE_ACK = 0x800, 0x801, 0x802, 0x803
CONTROL_IN, STREAM_IN = 1, 2
# name in the GenICam standard: number and bits of a pixel
FORMATS = {
    "Mono8": (0x01080001, 8),
    "Mono10": (0x01100003, 10),
    "Mono12": (0x01100005, 12),
    "Mono16": (0x01100007, 16),
}
BITS = dict(FORMATS.values())
SIDES = {"Width": (0, 64, 320), "Height": (4, 48, 240)}
REGISTERS = {
    "Width": 0x00,
    "Height": 0x04,
    "OffsetX": 0x08,
    "OffsetY": 0x0C,
    "PixelFormat": 0x10,
    "PayloadSize": 0x14,
    "AcquisitionMode": 0x18,
    "AcquisitionStart": 0x1C,
    "AcquisitionStop": 0x20,
    "TriggerSelector": 0x24,
    "TriggerMode": 0x28,
    "TriggerSource": 0x2C,
    "TriggerSoftware": 0x30,
    "ExposureMicroseconds": 0x34,
}
ENUMERATIONS = {
    "PixelFormat": {name: number for name, (number, _) in FORMATS.items()},
    "AcquisitionMode": {"Continuous": 0, "SingleFrame": 1},
    "TriggerSelector": {"FrameStart": 0},
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerSource": {"Software": 0, "Line1": 1},
}
MAX_WIDTH, MAX_HEIGHT = 320, 240

Light = Callable[[int, int], NDArray[np.float64]]


def description() -> bytes:
    """Return the GenICam description of the registers above."""
    names = [*ENUMERATIONS, *SIDES, "OffsetX", "OffsetY", "PayloadSize", "ExposureTime"]
    names += ["AcquisitionStart", "AcquisitionStop", "TriggerSoftware"]
    nodes = ["".join(f"<pFeature>{name}</pFeature>" for name in names)]
    nodes = [f'<Category Name="Root">{nodes[0]}</Category>']
    for name, address in REGISTERS.items():
        nodes.append(
            f'<IntReg Name="{name}Register"><Address>0x{FEATURES + address:x}</Address>'
            "<Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort>"
            "<Cachable>NoCache</Cachable><Sign>Unsigned</Sign>"
            "<Endianess>LittleEndian</Endianess></IntReg>"
        )
    for name, entries in ENUMERATIONS.items():
        inner = "".join(
            f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>'
            for entry, value in entries.items()
        )
        nodes.append(
            f'<Enumeration Name="{name}">{inner}<pValue>{name}Register</pValue></Enumeration>'
        )
    for name, low, high in (
        ("Width", 16, MAX_WIDTH),
        ("Height", 16, MAX_HEIGHT),
        ("OffsetX", 0, MAX_WIDTH),
        ("OffsetY", 0, MAX_HEIGHT),
        ("PayloadSize", 0, 2**31 - 1),
    ):
        nodes.append(
            f'<Integer Name="{name}"><pValue>{name}Register</pValue><Min>{low}</Min>'
            f"<Max>{high}</Max><Inc>1</Inc></Integer>"
        )
    for name in ("AcquisitionStart", "AcquisitionStop", "TriggerSoftware"):
        nodes.append(
            f'<Command Name="{name}"><pValue>{name}Register</pValue>'
            "<CommandValue>1</CommandValue></Command>"
        )
    nodes.append(
        '<Float Name="ExposureTime"><pValue>ExposureConverter</pValue><Min>10</Min>'
        "<Max>10000000</Max><Unit>us</Unit></Float>"
        '<Converter Name="ExposureConverter"><FormulaTo>FROM</FormulaTo>'
        "<FormulaFrom>TO</FormulaFrom><pValue>ExposureMicrosecondsRegister</pValue></Converter>"
    )
    nodes.append('<Port Name="Device"/>')
    head = (
        '<?xml version="1.0" encoding="utf-8"?><RegisterDescription ModelName="Emulated" '
        'VendorName="labrig" StandardNameSpace="None" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" '
        'SubMinorVersion="0" ProductGuid="0" VersionGuid="0" '
        'xmlns="http://www.genicam.org/GenApi/Version_1_1">'
    )
    return (head + "".join(nodes) + "</RegisterDescription>").encode()


class U3vCamera(UsbDevice):
    """Mono8 to Mono16, software trigger and free run; ``light`` is full scales a second."""

    vendor_id = 0x1E10
    product_id = 0x3300
    device_class = (0xEF, 2, 1)
    strings = ("labrig", "emulated U3V camera", "U3V0001", "1E1000000001")

    def __init__(self, light: Light) -> None:
        super().__init__()
        self._light = light
        self._answers: list[bytes] = []
        self._stream: list[bytes] = []
        self._running = False
        self._frames = 0
        self.truncate_next = False
        self.config = self._descriptors()
        text = description()
        self._memory = bytearray(FEATURES + 0x1000)
        for address, word in ((0x04, b"labrig"), (0x44, b"emulated U3V"), (0x144, b"U3V0001")):
            self._memory[address : address + len(word)] = word
        self._put(0, "<I", 0x10000)
        self._put(0x1CC, "<I", 200)  # longest time to answer, ms
        self._put(0x1D0, "<QQ", MANIFEST, SBRM)
        self._put(SBRM + 0x04, "<Q", 1)
        self._put(SBRM + 0x14, "<IIIQ", 1024, 1024, 1, SIRM)
        self._put(SBRM + 0x28, "<I", 0x30)
        self._put(SBRM + 0x40, "<I", 8)
        self._put(SIRM, "<I", 2 << 24)  # transfers are aligned to 4 bytes
        self._put(SIRM + 0x10, "<II", 52, 36)
        self._put(MANIFEST, "<Q", 1)
        self._put(MANIFEST + 8, "<BBBBIQQ", 0, 0, 0, 1, 0, DESCRIPTION, len(text))
        self._memory[DESCRIPTION : DESCRIPTION + len(text)] = text
        for name, value in (
            ("Width", MAX_WIDTH),
            ("Height", MAX_HEIGHT),
            ("PixelFormat", FORMATS["Mono8"][0]),
            ("ExposureMicroseconds", 10000),
        ):
            self._put(FEATURES + REGISTERS[name], "<I", value)

    def bulk_out(self, endpoint: int, sent: bytes) -> bool:
        """Obey one GenCP command."""
        _, _, command, _, number = struct.unpack_from("<IHHHH", sent)
        self._put(FEATURES + REGISTERS["PayloadSize"], "<I", self._payload())
        self._put(SIRM + 8, "<Q", self._payload())
        if command == READ:
            address, _, length = struct.unpack_from("<QHH", sent, 12)
            answer, kind = bytes(self._memory[address : address + length]), READ_ACK
        elif command == WRITE:
            address = struct.unpack_from("<Q", sent, 12)[0]
            value = sent[20:]
            self._memory[address : address + len(value)] = value
            self._written(address - FEATURES)
            answer, kind = struct.pack("<HH", 0, len(value)), WRITE_ACK
        else:
            return False
        head = struct.pack("<IHHHH", CONTROL_MAGIC, 0, kind, len(answer), number)
        self._answers.append(head + answer)
        self.ready()
        return True

    def bulk_in(self, endpoint: int, length: int) -> bytes | None:
        """Return an answer, or the next piece of the stream."""
        if endpoint == CONTROL_IN:
            return self._answers.pop(0) if self._answers else None
        if not self._stream:
            if self._running and not self._get("TriggerMode"):
                time.sleep(0.02)
                self._expose()
            else:
                return None
        piece, rest = self._stream[0][:length], self._stream[0][length:]
        if rest:
            self._stream[0] = rest
        else:
            self._stream.pop(0)
        return piece

    def _written(self, register: int) -> None:
        if register == REGISTERS["AcquisitionStart"]:
            self._running = True
            self.ready()
        elif register == REGISTERS["AcquisitionStop"]:
            self._running = False
            self._stream.clear()
        elif register == REGISTERS["TriggerSoftware"] and self._running:
            self._expose()
            self.ready()

    def _expose(self) -> None:
        width, height, layout = (self._get(n) for n in ("Width", "Height", "PixelFormat"))
        full, kind = 2 ** BITS[layout] - 1, "<u2" if BITS[layout] > 8 else "u1"
        light = self._light(height, width) * self._get("ExposureMicroseconds") * 1e-6
        picture = np.rint(np.clip(light, 0.0, 1.0) * full).astype(kind).tobytes()
        self._frames += 1
        now = time.monotonic_ns()
        status = 0
        if self.truncate_next:
            self.truncate_next, status = False, 0xA101  # the standard's "data overrun"
            picture = picture[: len(picture) // 2]
        self._stream += [
            struct.pack(
                *("<IHHQHHQIIIIIHH", LEADER_MAGIC, 0, 52, self._frames, 0, 1, now, layout),
                *(width, height, 0, 0, 0, 0),
            ),
            picture,
            struct.pack(
                "<IHHQHHQI", TRAILER_MAGIC, 0, 36, self._frames, status, 0, len(picture), height
            ),
        ]

    def _payload(self) -> int:
        n_bytes = 2 if BITS[self._get("PixelFormat")] > 8 else 1
        return self._get("Width") * self._get("Height") * n_bytes

    def _get(self, name: str) -> int:
        return int(struct.unpack_from("<I", self._memory, FEATURES + REGISTERS[name])[0])

    def _put(self, address: int, layout: str, *values: int) -> None:
        struct.pack_into(layout, self._memory, address, *values)

    def _descriptors(self) -> bytes:
        association = struct.pack("<8B", 8, 11, 0, 2, 0xEF, 5, 0, 0)
        versions = struct.pack("<II", 0x10000, 0x10000)
        strings = struct.pack("<8B", 4, 1, 2, 0, 0, 0, 3, 0)
        # Aravis takes only a device that carries this descriptor with the string of its GUID.
        info = struct.pack("<BBB", 20, 0x24, 1) + versions + strings + b"\x08"
        body = association + interface(0, [0x81, 0x01], (0xEF, 5, 0), info)
        return configuration(2, body + interface(1, [0x82], (0xEF, 5, 2)))
