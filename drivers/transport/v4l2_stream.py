"""A stream of buffers from a V4L2 device, mapped into memory."""

from __future__ import annotations

import errno
import mmap
from contextlib import suppress
from dataclasses import dataclass

from drivers.transport import v4l2_ioctl as v4l2


@dataclass(frozen=True, slots=True, kw_only=True)
class Filled:
    """A buffer the device filled: a copy of its bytes, and what the kernel says of it.

    ``monotonic`` if the time stamp is on the host's monotonic clock; ``at_start`` if it was
    taken at the start of the exposure, else at the end of the frame, as the device declares.
    """

    content: bytes
    sequence: int
    stamp_s: float
    monotonic: bool
    at_start: bool
    faulty: bool


class Stream:
    """A running stream; every method may raise OSError as the kernel gives it."""

    def __init__(self, node: v4l2.VideoNode, *, depth: int) -> None:
        self._node = node
        self._maps: list[mmap.mmap] = []
        self._last = -1
        self._turns = 0
        try:
            self._start(depth)
        except BaseException:
            self.stop()
            raise

    @property
    def depth(self) -> int:
        """How many buffers the device gave."""
        return len(self._maps)

    def wait(self, seconds: float) -> bool:
        """Return whether there may be a buffer within a time."""
        return self._node.wait(seconds)

    def take(self, *, copy: bool = True) -> Filled | None:
        """Return the oldest filled buffer and give it back to the device; None if none waits."""
        buffer = self._buffer()
        try:
            self._node.call(v4l2.DQBUF, buffer)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            raise
        flags = buffer.flags
        filled = Filled(
            content=self._maps[buffer.index][: buffer.bytesused] if copy else b"",
            sequence=self._unwrapped(buffer.sequence),
            stamp_s=buffer.timestamp.tv_sec + buffer.timestamp.tv_usec * 1e-6,
            monotonic=flags & v4l2.TIMESTAMP_MASK == v4l2.TIMESTAMP_MONOTONIC,
            at_start=flags & v4l2.TSTAMP_SRC_MASK == v4l2.TSTAMP_SRC_SOE,
            faulty=bool(flags & v4l2.BUF_FLAG_ERROR),
        )
        self._node.call(v4l2.QBUF, buffer)
        return filled

    def stop(self) -> None:
        """End the stream and give the buffers up; never raises."""
        with suppress(OSError):
            self._node.switch(on=False)
        for mapped in self._maps:
            mapped.close()
        self._maps.clear()
        with suppress(OSError):
            self._node.call(v4l2.REQBUFS, self._request(0))

    def _start(self, depth: int) -> None:
        request = self._request(depth)
        self._node.call(v4l2.REQBUFS, request)
        for index in range(request.count):
            buffer = self._buffer(index)
            self._node.call(v4l2.QUERYBUF, buffer)
            self._maps.append(self._node.map(buffer.length, buffer.m.offset))
            self._node.call(v4l2.QBUF, buffer)
        self._node.switch(on=True)

    def _unwrapped(self, sequence: int) -> int:
        """Return a number that goes on rising when the kernel's 32 bits begin anew."""
        if sequence + self._turns * 2**32 < self._last - 2**31:
            self._turns += 1
        self._last = sequence + self._turns * 2**32
        return self._last

    @staticmethod
    def _buffer(index: int = 0) -> v4l2.Buffer:
        return v4l2.Buffer(index=index, type=v4l2.CAPTURE, memory=v4l2.MMAP)

    @staticmethod
    def _request(count: int) -> v4l2.RequestBuffers:
        return v4l2.RequestBuffers(count=count, type=v4l2.CAPTURE, memory=v4l2.MMAP)
