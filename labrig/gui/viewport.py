"""Which part of a picture a pane shows, and where a point of the one lies in the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

SMALLEST, LARGEST = 0.02, 32.0  # screen pixels per pixel of the picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Viewport:
    """A pane of ``width`` x ``height`` px onto a picture of ``cols`` x ``rows``.

    Attributes
    ----------
    zoom : screen pixels per pixel of the picture
    left, top : the picture's coordinates at the pane's corner; negative where there is a border
    fitted : whether the picture shall fill the pane, whatever its size
    """

    cols: int
    rows: int
    width: int = 1
    height: int = 1
    zoom: float = 1.0
    left: float = 0.0
    top: float = 0.0
    fitted: bool = True

    def fit(self) -> Viewport:
        """Return the view of the whole picture, centred."""
        zoom = min(self.width / self.cols, self.height / self.rows)
        zoom = min(max(zoom, SMALLEST), LARGEST)
        return replace(self.centred(zoom, 0.5 * self.cols, 0.5 * self.rows), fitted=True)

    def resized(self, width: int, height: int) -> Viewport:
        """Return the view in a pane of another size; its middle stays, or the fit."""
        x, y = self.to_picture(0.5 * self.width, 0.5 * self.height)
        sized = replace(self, width=max(width, 1), height=max(height, 1))
        return sized.fit() if self.fitted else sized.centred(self.zoom, x, y)

    def of(self, cols: int, rows: int) -> Viewport:
        """Return the view of a picture of another size."""
        if (cols, rows) == (self.cols, self.rows):
            return self
        return replace(self, cols=cols, rows=rows).fit()

    def zoomed(self, factor: float, x: float, y: float) -> Viewport:
        """Return the view enlarged by a factor; the point under x, y of the pane stays there."""
        zoom = min(max(self.zoom * factor, SMALLEST), LARGEST)
        at_x, at_y = self.to_picture(x, y)
        return replace(self, zoom=zoom, left=at_x - x / zoom, top=at_y - y / zoom, fitted=False)

    def at(self, zoom: float) -> Viewport:
        """Return the view of a zoom about the pane's middle."""
        return self.zoomed(zoom / self.zoom, 0.5 * self.width, 0.5 * self.height)

    def panned(self, dx: float, dy: float) -> Viewport:
        """Return the view after a drag by dx, dy px; a corner of the picture stays in sight."""
        left = min(max(self.left - dx / self.zoom, -0.9 * self.width / self.zoom), self.cols - 1.0)
        top = min(max(self.top - dy / self.zoom, -0.9 * self.height / self.zoom), self.rows - 1.0)
        return replace(self, left=left, top=top, fitted=False)

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Return picture coordinates of a place in the pane; pixel n spans n .. n + 1."""
        return self.left + x / self.zoom, self.top + y / self.zoom

    def to_pane(self, x: float, y: float) -> tuple[float, float]:
        """Return the pane's coordinates of a place in the picture."""
        return (x - self.left) * self.zoom, (y - self.top) * self.zoom

    def pixel(self, x: float, y: float) -> tuple[int, int] | None:
        """Return column and row of the pixel shown at a pane's pixel x, y; None off the picture."""
        col, row = self.to_picture(x + 0.5, y + 0.5)
        if not (0 <= col < self.cols and 0 <= row < self.rows):
            return None
        return math.floor(col), math.floor(row)

    def centred(self, zoom: float, x: float, y: float) -> Viewport:
        """Return the view of a zoom with a place of the picture in the pane's middle."""
        left, top = x - 0.5 * self.width / zoom, y - 0.5 * self.height / zoom
        return replace(self, zoom=zoom, left=left, top=top)
