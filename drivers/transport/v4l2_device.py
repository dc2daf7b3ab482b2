"""Questions to a V4L2 device and their answers as plain records; every call may raise OSError."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import AccessDeniedError, DeviceBusyError, DeviceNotFoundError
from drivers.transport import v4l2_ioctl as v4l2

Roi = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfo:
    """Kernel driver, model and place on the bus."""

    driver: str
    card: str
    bus: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFormat:
    """The frames a device gives: size, four letters, bytes a row, seconds from one to the next."""

    width: int
    height: int
    letters: str
    stride: int
    interval_s: float
    roi: Roi | None = None


class UnfitError(OSError):
    """Raised when a device took another size, format or region than the one asked for."""

    def __init__(self, message: str) -> None:
        super().__init__(errno.EINVAL, message)


class VideoDevice:
    """An open video node."""

    def __init__(self, node: v4l2.VideoNode) -> None:
        self.node = node

    def can_stream(self) -> bool:
        """Return whether it gives pictures by streaming."""
        found = v4l2.Capability()
        self.node.call(v4l2.QUERYCAP, found)
        split = found.capabilities & v4l2.CAP_DEVICE_CAPS
        can = found.device_caps if split else found.capabilities
        wanted = v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING
        return bool(can & wanted == wanted)

    def info(self) -> DeviceInfo:
        """Return what the device is."""
        found = v4l2.Capability()
        self.node.call(v4l2.QUERYCAP, found)
        return DeviceInfo(
            driver=found.driver.decode(), card=found.card.decode(), bus=found.bus_info.decode()
        )

    def formats(self) -> set[str]:
        """Return the four letters of every format."""
        letters: set[str] = set()
        while True:
            found = v4l2.FormatDescription(index=len(letters), type=v4l2.CAPTURE)
            try:
                self.node.call(v4l2.ENUM_FMT, found)
            except OSError as error:
                if error.errno == errno.EINVAL:  # the end of the list
                    return letters
                raise
            letters.add(v4l2.fourcc_name(found.pixelformat))

    def frame_format(self) -> FrameFormat:
        """Return what is set now."""
        found = v4l2.Format(type=v4l2.CAPTURE)
        self.node.call(v4l2.G_FMT, found)
        pix = found.fmt.pix
        return FrameFormat(
            width=pix.width,
            height=pix.height,
            letters=v4l2.fourcc_name(pix.pixelformat),
            stride=pix.bytesperline,
            interval_s=self._interval_s(),
        )

    def set_format(
        self, letters: str, size: tuple[int, int] | None, roi: Roi | None
    ) -> FrameFormat:
        """Set format, size and region; return what the device took.

        Raises
        ------
        UnfitError
            If that is something else.
        """
        present = self.frame_format()
        width, height = size or (present.width, present.height)
        if roi is not None:
            self._crop(roi)
            width, height = roi[2:]
        else:
            self._uncrop()
        request = v4l2.Format(type=v4l2.CAPTURE)
        request.fmt.pix.width, request.fmt.pix.height = width, height
        request.fmt.pix.pixelformat = v4l2.fourcc(letters)
        request.fmt.pix.field = v4l2.FIELD_NONE
        self.node.call(v4l2.S_FMT, request)
        taken = self.frame_format()
        if (taken.width, taken.height, taken.letters) != (width, height, letters):
            msg = f"{width}x{height} {letters} asked, {taken.width}x{taken.height} {taken.letters}"
            raise UnfitError(msg + " taken")
        if roi is not None:
            self._refuse_other_region(roi)  # a new size may have moved it
        return FrameFormat(
            width=taken.width,
            height=taken.height,
            letters=letters,
            stride=taken.stride,
            interval_s=taken.interval_s,
            roi=roi,
        )

    def _uncrop(self) -> None:
        """Undo a region that somebody left; many cameras have one that cannot be set."""
        whole = self._selection(v4l2.SEL_TGT_CROP_DEFAULT)
        if whole is not None and self._selection(v4l2.SEL_TGT_CROP) not in (None, whole):
            self._crop(whole)

    def _crop(self, roi: Roi) -> None:
        request = v4l2.Selection(type=v4l2.CAPTURE, target=v4l2.SEL_TGT_CROP)
        request.rectangle[:] = roi
        try:
            self.node.call(v4l2.S_SELECTION, request)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise
            msg = f"region {roi} asked, this camera offers none"
            raise UnfitError(msg) from error
        self._refuse_other_region(roi)

    def _refuse_other_region(self, roi: Roi) -> None:
        taken = self._selection(v4l2.SEL_TGT_CROP)
        if taken != roi:
            msg = f"region {roi} asked, {taken} taken"
            raise UnfitError(msg)

    def _selection(self, target: int) -> Roi | None:
        found = v4l2.Selection(type=v4l2.CAPTURE, target=target)
        try:
            self.node.call(v4l2.G_SELECTION, found)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise
            return None
        x, y, width, height = found.rectangle
        return x, y, width, height

    def _interval_s(self) -> float:
        found = v4l2.StreamParameters(type=v4l2.CAPTURE)
        try:
            self.node.call(v4l2.G_PARM, found)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise
            return 1.0
        return found.numerator / found.denominator if found.denominator else 1.0


def video_devices(folder: Path = Path("/dev")) -> list[tuple[str, DeviceInfo]]:
    """Return the cameras of this machine with the name that survives a replug if there is one."""
    by_id = folder / "v4l" / "by-id"
    stable = {str(link.resolve()): str(link) for link in sorted(by_id.glob("*"))}
    found = []
    for path in sorted(folder.glob("video*")):
        try:
            device = VideoDevice(v4l2.VideoNode(str(path)))
        except OSError:
            continue
        try:
            if device.can_stream():
                found.append((stable.get(str(path), str(path)), device.info()))
        except OSError:
            continue
        finally:
            device.node.close()
    return found


def open_device(path: str) -> VideoDevice:
    """Open a camera by its path.

    Raises
    ------
    AccessDeniedError, DeviceBusyError, DeviceNotFoundError
        With the remedy.
    """
    try:
        node = v4l2.VideoNode(path)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM):
            msg = f"camera {path} may not be opened by this user; run: labrig doctor --fix-udev"
            raise AccessDeniedError(msg) from error
        if error.errno == errno.EBUSY:
            raise DeviceBusyError(f"camera {path} is held by another program.") from error  # noqa: EM102
        msg = f"camera {path} cannot be opened ({error.strerror}); labrig devices lists cameras."
        raise DeviceNotFoundError(msg) from error
    device = VideoDevice(node)
    try:
        streams = device.can_stream()
    except OSError:
        streams = False
    if not streams:
        node.close()
        msg = f"{path} is no camera that streams; labrig devices lists those that are."
        raise DeviceNotFoundError(msg)
    return device
