"""A projector in the simulated world: light changes at a refresh, after a latency."""

from __future__ import annotations

import math
from typing import Any

from drivers.errors import NotOpenError, SettingRefusedError
from drivers.projector.protocol import Image, ProjectorCapabilities, ShowReceipt
from drivers.simulation.world import World


class SimulatedProjector:
    """Shows images to the world, at the next refresh after its latency."""

    def __init__(self, capabilities: ProjectorCapabilities, world: World, *, latency_s: float):
        self._capabilities = capabilities
        self._world = world
        self._latency_s = latency_s
        self._open = False

    @property
    def identity(self) -> dict[str, str]:
        """Model, serial number and firmware."""
        return {"model": "labrig simulated projector", "serial": "sim", "firmware": "1"}

    def open(self) -> ProjectorCapabilities:
        """Connect; say what the projector can do."""
        self._open = True
        return self._capabilities

    def close(self) -> None:
        """Go dark and disconnect; harmless if done twice."""
        if self._open:
            self._world.project(None, at_s=self._world.clock.now_s())
        self._open = False

    def snapshot(self) -> dict[str, Any]:
        """Return every setting, read back."""
        c = self._capabilities
        return {
            "rows": c.rows,
            "cols": c.cols,
            "refresh_hz": c.refresh_hz,
            "settle_s": c.settle_s,
            "latency_s": self._latency_s,
        }

    def show(self, image: Image | None) -> ShowReceipt:
        """Show an image of native size, None for lamp off.

        Raises
        ------
        SettingRefusedError
            If the image has another size; it is never scaled.
        """
        if not self._open:
            msg = "the simulated projector is not open; call open() first."
            raise NotOpenError(msg)
        native = (self._capabilities.rows, self._capabilities.cols)
        if image is not None and image.shape != native:
            msg = f"image of {image.shape} px on a projector of {native} px: it is never scaled."
            raise SettingRefusedError(msg)
        now = self._world.clock.now_s()
        frame_s = 1.0 / self._capabilities.refresh_hz
        changes = math.ceil((now + self._latency_s) / frame_s) * frame_s
        self._world.project(image, at_s=changes)
        return ShowReceipt(
            requested_s=now,
            earliest_s=now + self._latency_s,
            latest_s=now + self._latency_s + frame_s,
        )
