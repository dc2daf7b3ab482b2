"""What was measured of a slab against depth, and what orders of scattering make of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.phase_function import Array

Scales = Literal["one", "each"]

SUB_BINS = 4  # Gauss points in a bin of depth
FEWEST = 6  # bins of depth


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabProfiles:
    """What was measured against depth; NaN where nothing was.

    Attributes
    ----------
    depth_mm : (n_x,), middles of bins of depth
    bin_mm : their width; zero for points
    wavenumbers_per_mm : (n_q,), 2 pi over the stripes' periods; may be empty
    harmonics : (n_q, n_x), amplitudes over the stripes' own contrast, so that harmonic and white
        light share one scale; complex ones with the stripes' phase taken out, whose real part is
        fitted: at normal incidence A(x; q) is real
    variance : (n_q, n_x)
    white, white_variance : (n_x,), or None
    """

    depth_mm: Array
    bin_mm: float
    wavenumbers_per_mm: Array
    harmonics: Array | NDArray[np.complex128]
    variance: Array
    white: Array | None
    white_variance: Array | None

    def stacked(self) -> tuple[Array, Array, Array]:
        """Return wave numbers (n,), values and variances (n, n_x), white light last.

        Raises
        ------
        AnalysisError
            If shapes differ, nothing was measured, or a number is impossible.
        """
        q = np.atleast_1d(np.asarray(self.wavenumbers_per_mm, dtype=np.float64))
        values, variance = list(np.real(self.harmonics)), list(self.variance)
        if self.white is not None and self.white_variance is not None:
            q = np.append(q, 0.0)
            values.append(self.white)
            variance.append(self.white_variance)
        if any(np.shape(v) != np.shape(self.depth_mm) for v in (*values, *variance)) or not (
            len(values) == len(variance) == q.size
        ):
            msg = (
                "depths, harmonics, white light and variances differ in shape; give one per depth."
            )
            raise AnalysisError(msg)
        if q.size == 0 or not (np.isfinite(q).all() and q.min() >= 0.0):
            msg = f"wave numbers {q.tolist()} / mm: give 2 pi / period, or white light."
            raise AnalysisError(msg)
        found, noise = np.array(values, dtype=np.float64), np.array(variance, dtype=np.float64)
        found = np.where(np.isfinite(noise) & (noise > 0.0), found, np.nan)
        if np.isfinite(found).sum(axis=1).min() < FEWEST:
            msg = (
                f"a profile has fewer than {FEWEST} depths with a value and a variance; "
                "measure deeper, or leave it out."
            )
            raise AnalysisError(msg)
        return q, found, noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """The profiles (n, n_x), and how orders on a table's depths become them.

    Attributes
    ----------
    at_mm, weight : (n_x, s) points of each bin and their weights
    to_points : (n_x s, n_nodes), spline from the table's depths
    """

    values: Array
    std: Array
    use: NDArray[np.bool_]
    at_mm: Array
    weight: Array
    to_points: Array
    scales: Scales

    @classmethod
    def of(cls, profiles: SlabProfiles, x_mm: Array, scales: Scales) -> Problem:
        """Return the problem for orders known at the depths ``x_mm``."""
        _, values, variance = profiles.stacked()
        node, weight = np.polynomial.legendre.leggauss(SUB_BINS if profiles.bin_mm > 0.0 else 1)
        at_mm = profiles.depth_mm[:, None] + 0.5 * profiles.bin_mm * node
        return cls(
            values=values,
            std=np.sqrt(variance),
            use=np.isfinite(values),
            at_mm=at_mm,
            weight=0.5 * weight,
            to_points=CubicSpline(x_mm, np.eye(x_mm.size))(at_mm.ravel()),
            scales=scales,
        )

    @property
    def degrees_of_freedom(self) -> int:
        """Data less parameters."""
        n_scales = 1 if self.scales == "one" else self.values.shape[0]
        return max(int(self.use.sum()) - 3 - n_scales, 1)

    def pulls(self, model: Array) -> Array:
        """Return data less model in units of the noise, those measured, (n_data,)."""
        return np.asarray(((self.values - model) / self.std)[self.use])

    def profiles(self, orders: list[Array], sigma_t: float, albedo: float) -> Array:
        """Return A(x; q) of every profile, (n, n_x)."""
        decay = np.exp(-sigma_t * self.at_mm)
        found = [
            ((self.to_points @ summed(of_q, albedo)).reshape(decay.shape) * decay) @ self.weight
            for of_q in orders
        ]
        return np.array(found)

    def scaled(self, shapes: Array) -> tuple[Array, Array]:
        """Return the best scales (n,), and the shapes times these."""
        weighted = np.where(self.use, shapes / self.std**2, 0.0)
        up = np.where(self.use, weighted * self.values, 0.0).sum(axis=1)
        down = (weighted * shapes).sum(axis=1)
        if self.scales == "one":
            up, down = np.full_like(up, up.sum()), np.full_like(down, down.sum())
        scales = up / down
        return scales, scales[:, None] * shapes


def summed(orders: Array, albedo: float) -> Array:
    """Return the sum of all orders at an albedo, (n_x,), from those at one, (K, n_x).

    Orders beyond the last go on with the ratio of the last two.
    """
    total = np.polynomial.polynomial.polyval(albedo, orders)
    if orders.shape[0] < 3:
        return np.asarray(total)
    before, last = orders[-2], orders[-1]
    ratio = np.divide(last, before, out=np.zeros_like(last), where=before > 0.0)
    ratio = albedo * np.clip(ratio, 0.0, 0.99)
    return np.asarray(total + albedo ** (orders.shape[0] - 1) * last * ratio / (1.0 - ratio))
