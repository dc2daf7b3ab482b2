"""What an analysis says of every bounce against what the simulated light was really made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from labrig.errors import AnalysisRefusedError
from labrig.results import Result
from labrig.scene.picture import Truth

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """One bounce, on the nodes inside the tank.

    Attributes
    ----------
    truth, found : (n_y, n_x), counts/s
    rms_relative : rms of their difference over rms of the truth
    """

    bounce: int
    truth: Array
    found: Array
    rms_relative: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """Every bounce that the truth has; x_mm (n_x,) and y_mm (n_y,) are the nodes."""

    x_mm: Array
    y_mm: Array
    orders: tuple[Verified, ...]


def verify_bounces(result: Result, truth: Truth, *, gain_dn_per_e: float) -> Verification:
    """Compare the recovered pictures of the bounces with the true ones.

    The truth's pixels and cells are averaged to the nodes, those on the walls left out.

    Raises
    ------
    AnalysisRefusedError
        If the result has no bounces in mm.
    """
    if "fluence" not in result.fields or result.run.get("length_unit") != "mm":
        msg = f"{result.path}: holds no bounces in mm; analyse the session to the end."
        raise AnalysisRefusedError(msg)
    x, y = (np.asarray(result.fields[name].values[1:-1], np.float64) for name in ("x", "y"))
    scale = float(result.attributes["scale_c"])
    fluence = result.fields["fluence"].values[:, 1:-1, 1:-1]
    depth, width = (float(result.fields[name].values[-1]) for name in ("x", "y"))
    rows, cols = truth.single.shape
    first = _at(
        truth.single,
        (np.arange(rows) + 0.5) * width / rows,
        (np.arange(cols) + 0.5) * depth / cols,
        (y, x),
    )
    true = [first, *(_at(picture, truth.y_mm, truth.x_mm, (y, x)) for picture in truth.bounces)]
    orders = []
    for k, (light, phi) in enumerate(zip(true, fluence, strict=False), start=1):
        wanted, found = gain_dn_per_e * light, scale * np.asarray(phi, np.float64)
        power = float(np.sqrt(np.mean(wanted**2)))
        rms = float(np.sqrt(np.mean((found - wanted) ** 2))) / power
        orders.append(Verified(bounce=k, truth=wanted, found=found, rms_relative=rms))
    return Verification(x_mm=x, y_mm=y, orders=tuple(orders))


def _at(picture: Array, y_mm: Array, x_mm: Array, nodes: tuple[Array, Array]) -> Array:
    """Return a picture of cells at nodes: the mean of the four around each, as they lie."""
    return np.asarray(RectBivariateSpline(y_mm, x_mm, picture, kx=1, ky=1)(*nodes))
