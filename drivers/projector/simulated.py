"""A projector in the simulated world: light changes at a refresh, after a latency that varies."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from drivers.errors import (
    DeviceBusyError,
    DeviceLostError,
    NotOpenError,
    SettingRefusedError,
)
from drivers.projector.protocol import Image, PatternHandle, ProjectorCapabilities, ShowReceipt
from drivers.simulation.world import World
from drivers.waiting import CancelToken


class SimulatedProjector:
    """Shows images to the world, at the next refresh after its latency.

    The true latency is ``latency_s`` and a part of ``jitter_s`` more, drawn anew at each change;
    what the receipts promise is ``capabilities.latency_s``, right or wrong.
    """

    def __init__(
        self,
        capabilities: ProjectorCapabilities,
        world: World,
        *,
        latency_s: float,
        jitter_s: float = 0.0,
        seed: int = 1,
    ) -> None:
        self._capabilities = capabilities
        self._world = world
        self._latency_s = latency_s
        self._jitter_s = jitter_s
        self._rng = np.random.default_rng([seed, 2])
        self._open = False
        self._images: tuple[Image, ...] = ()
        self._handles: tuple[PatternHandle, ...] = ()
        self._current: PatternHandle | None = None

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig simulated projector", "serial": "sim", "firmware": "2"}

    def open(self) -> ProjectorCapabilities:
        """Connect, black; say what the projector can do."""
        if self._open:
            msg = "the simulated projector is already open; close it first."
            raise DeviceBusyError(msg)
        self._open = True
        self._change(self._black())
        return self._capabilities

    def close(self) -> None:
        """Go dark and disconnect; harmless if done twice."""
        if self._open:
            self._world.project(None, at_s=self._world.clock.now_s())
        self._open = False
        self._images = self._handles = ()
        self._current = None

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""
        return {
            **asdict(self._capabilities),
            "true_latency_s": self._latency_s,
            "true_jitter_s": self._jitter_s,
        }

    def load(self, images: Sequence[Image]) -> tuple[PatternHandle, ...]:
        """Take images of native size, in place of those loaded before."""
        self._require_open()
        native = (self._capabilities.rows, self._capabilities.cols)
        for image in images:
            if image.shape != native or image.dtype != np.uint8:
                msg = (
                    f"image of {image.shape} px, {image.dtype}, on a projector of {native} px, "
                    "uint8: it is never scaled; draw it in native size."
                )
                raise SettingRefusedError(msg)
        self._images = tuple(images)
        self._handles = tuple(
            PatternHandle(index=k, digest=hashlib.sha256(image.tobytes()).hexdigest()[:16])
            for k, image in enumerate(images)
        )
        return self._handles

    def show(
        self,
        handle: PatternHandle,
        *,
        deadline_s: float,  # noqa: ARG002 - the simulated display never blocks
        cancel: CancelToken,
    ) -> ShowReceipt:
        """Show a loaded image and say when its light can have come."""
        cancel.check()
        self._require_open()
        if handle not in self._handles:
            msg = f"pattern {handle.digest} is not loaded; call load() first."
            raise SettingRefusedError(msg)
        if not self._world.faults.strikes("wrong-pattern"):
            self._change(self._images[handle.index])
        self._current = handle
        return self._receipt(handle)

    def black(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:  # noqa: ARG002
        """Show level 0 everywhere; its leak remains."""
        cancel.check()
        self._require_open()
        self._change(self._black())
        self._current = None
        return self._receipt(None)

    def lamp_off(self, *, deadline_s: float, cancel: CancelToken) -> ShowReceipt:  # noqa: ARG002
        """Give no light at all until the next `show` or `black`."""
        cancel.check()
        self._require_open()
        if not self._capabilities.lamp_control:
            msg = "this projector has no lamp control; cover its lens instead."
            raise SettingRefusedError(msg)
        self._change(None)
        self._current = None
        return self._receipt(None)

    def current(self) -> PatternHandle | None:
        """Return what is shown; None for black and for a lamp that is off."""
        return self._current

    def make_safe(self) -> None:
        """Go black whatever the state."""
        if self._open:
            self._change(self._black())
        self._current = None

    def _black(self) -> Image:
        return np.zeros((self._capabilities.rows, self._capabilities.cols), dtype=np.uint8)

    def _change(self, image: Image | None) -> None:
        now = self._world.clock.now_s()
        late = self._world.faults.strikes("projector-late")
        frame_s = 1.0 / self._capabilities.refresh_hz
        latency_s = self._latency_s + self._jitter_s * self._rng.uniform()
        latency_s += late.seconds if late else 0.0
        self._world.project(image, at_s=math.ceil((now + latency_s) / frame_s) * frame_s)

    def _receipt(self, handle: PatternHandle | None) -> ShowReceipt:
        now = self._world.clock.now_s()
        low, high = self._capabilities.latency_s
        return ShowReceipt(
            handle=handle,
            requested_s=now,
            earliest_s=now + low,
            latest_s=now + high,
            confirmed=self._capabilities.confirmed,
        )

    def _require_open(self) -> None:
        if not self._open:
            msg = "the simulated projector is not open; call open() first."
            raise NotOpenError(msg)
        if self._world.faults.strikes("projector-lost"):
            self._open = False
            msg = "the simulated projector was unplugged; plug it in again."
            raise DeviceLostError(msg)
