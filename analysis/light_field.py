"""The light field of every bounce on one grid, and the grid itself (Eqs. 3 to 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Beam, Medium, Tank

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Nodes on the tank, walls included, and directions between the axes.

    Parameters
    ----------
    n_x, n_y : nodes along depth and width, at least four each
    n_theta : directions, a multiple of four, at theta = 2 pi (n + 1/2) / n_theta
    """

    tank: Tank
    n_x: int
    n_y: int
    n_theta: int

    def __post_init__(self) -> None:
        if min(self.n_x, self.n_y) < 4 or self.n_theta < 8 or self.n_theta % 4:
            msg = (
                f"grid of {self.n_y} x {self.n_x} nodes and {self.n_theta} angles: "
                "at least 4 x 4 nodes and a multiple of four angles from 8 on are needed."
            )
            raise AnalysisError(msg)

    @classmethod
    def covering(cls, tank: Tank, *, cell_mm: float, n_theta: int) -> Grid:
        """Return the grid whose cells are square-ish and at most ``cell_mm`` wide."""
        if not (math.isfinite(cell_mm) and cell_mm > 0.0):
            msg = f"cell_mm = {cell_mm}: the cell must be a positive length."
            raise AnalysisError(msg)
        return cls(
            tank=tank,
            n_x=max(3, math.ceil(tank.depth_mm / cell_mm - 1e-9)) + 1,
            n_y=max(3, math.ceil(tank.width_mm / cell_mm - 1e-9)) + 1,
            n_theta=n_theta,
        )

    @property
    def x_mm(self) -> Array:
        """Depth of the nodes, (n_x,)."""
        return np.linspace(0.0, self.tank.depth_mm, self.n_x, dtype=np.float64)

    @property
    def y_mm(self) -> Array:
        """Height of the nodes along the lit face, (n_y,)."""
        return np.linspace(0.0, self.tank.width_mm, self.n_y, dtype=np.float64)

    @property
    def cell_x_mm(self) -> float:
        """Distance of nodes along the depth."""
        return self.tank.depth_mm / (self.n_x - 1)

    @property
    def cell_y_mm(self) -> float:
        """Distance of nodes along the lit face."""
        return self.tank.width_mm / (self.n_y - 1)

    @property
    def theta_rad(self) -> Array:
        """Directions of travel, (n_theta,)."""
        return equal_angles(self.n_theta)

    def average(self, picture: NDArray[np.floating[Any]], pixel_mm: float) -> tuple[Array, Array]:
        """Return mean and number of a picture's finite pixels around each node, (n_y, n_x) both.

        The picture (rows, cols) begins at the corner of the tank. NaN where no pixel is finite.
        """
        rows, cols = picture.shape
        row = _nearest(np.asarray((np.arange(rows) + 0.5) * pixel_mm), self.y_mm)
        col = _nearest(np.asarray((np.arange(cols) + 0.5) * pixel_mm), self.x_mm)
        cell = (row[:, None] * self.n_x + col[None, :]).ravel()
        finite = np.isfinite(picture).ravel()
        count = np.bincount(cell, finite.astype(np.float64), minlength=self.n_y * self.n_x)
        total = np.bincount(
            cell, np.where(finite, picture.ravel(), 0.0), minlength=self.n_y * self.n_x
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.asarray(total / count, dtype=np.float64)
        shape = (self.n_y, self.n_x)
        return mean.reshape(shape), np.asarray(count, dtype=np.float64).reshape(shape)


def equal_angles(n: int) -> Array:
    """Return n directions at equal steps, none along an axis if n is a multiple of four."""
    return np.asarray(2.0 * np.pi * (np.arange(n) + 0.5) / n)


def _nearest(position: Array, nodes: Array) -> NDArray[np.int64]:
    pitch = nodes[1] - nodes[0]
    nearest = np.floor(position / pitch + 0.5).astype(np.int64)
    return np.asarray(np.clip(nearest, 0, nodes.size - 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Cells that fill the tank, and angle bins: where values are means, not point values."""

    tank: Tank
    n_x: int
    n_y: int
    n_theta: int

    @property
    def x_mm(self) -> Array:
        """Depth of the cells' centres, (n_x,)."""
        return np.asarray((np.arange(self.n_x) + 0.5) * (self.tank.depth_mm / self.n_x))

    @property
    def y_mm(self) -> Array:
        """Height of the cells' centres along the lit face, (n_y,)."""
        return np.asarray((np.arange(self.n_y) + 0.5) * (self.tank.width_mm / self.n_y))

    @property
    def theta_rad(self) -> Array:
        """Centres of the angle bins, (n_theta,)."""
        return equal_angles(self.n_theta)


@dataclass(frozen=True, slots=True, kw_only=True)
class BounceField:
    """Light of every bounce: what the camera sees of it, and where it travels.

    Attributes
    ----------
    fluence : (K, n_y, n_x), phi_k for k = 1 .. K, each with sigma_s^(k-1) applied; point values
        on a `Grid`, means on `Cells`, the ballistic fluence being one where the beam enters
    light_field : (K - 1, n_y, n_x, n_theta), L_k for k = 2 .. K, radiance per radian, likewise;
        the ballistic beam is a delta and stays out. None where it was not asked for, or where
        light keeps its direction and all of it is a delta
    engine : what computed it
    error_estimate : (K,), relative rms error of each fluence; None where it was not measured
    """

    medium: Medium
    beam: Beam
    grid: Grid | Cells
    fluence: Array
    light_field: NDArray[np.floating[Any]] | None
    engine: str
    error_estimate: Array | None = None

    @property
    def n_bounces(self) -> int:
        """Number of bounces K held here."""
        return int(self.fluence.shape[0])
