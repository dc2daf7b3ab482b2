"""What was measured of a slab against depth, and what orders of scattering make of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.phase_function import Array

SUB_BINS = 4  # Gauss points in a bin of depth
FEWEST = 6  # bins of depth
LEAST_STD = 1e-6  # of a contrast that is taken to be known


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
    contrast_std : (n_q,), relative, of the contrasts; infinite where one is not known. Zero if
        left out
    shared : (n_q, n_x), covariances of the harmonics with the white light; none if left out
    model_error : of the light at a depth, relative: what the model leaves unexplained there
    face_error : the same, of the brightest light
    """

    depth_mm: Array
    bin_mm: float
    wavenumbers_per_mm: Array
    harmonics: Array | NDArray[np.complex128]
    variance: Array
    white: Array | None
    white_variance: Array | None
    contrast_std: Array | None = None
    shared: Array | None = None
    model_error: float = 0.0
    face_error: float = 0.0

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
    noise : (n, n_x), std of the camera's noise; ``std`` holds the model's own error too
    at_mm, weight : (n_x, s) points of each bin and their weights
    to_points : (n_x s, n_nodes), spline from the table's depths
    correlation : (n_q, n_x), of the camera's noise in each harmonic and in the white light
    ratio, ratio_std : (n_q,), what a harmonic's scale is expected to be over that of white light,
        and how well that is known, relative
    """

    values: Array
    noise: Array
    std: Array
    use: NDArray[np.bool_]
    at_mm: Array
    weight: Array
    to_points: Array
    correlation: Array
    ratio: Array
    ratio_std: Array

    @classmethod
    def of(cls, profiles: SlabProfiles, x_mm: Array) -> Problem:
        """Return the problem for orders known at the depths ``x_mm``."""
        _, values, variance = profiles.stacked()
        node, weight = np.polynomial.legendre.leggauss(SUB_BINS if profiles.bin_mm > 0.0 else 1)
        at_mm = profiles.depth_mm[:, None] + 0.5 * profiles.bin_mm * node
        n_q = len(profiles.harmonics)
        told = np.zeros(n_q) if profiles.contrast_std is None else profiles.contrast_std
        brightest = np.nanmax(np.abs(values), axis=1, keepdims=True)
        error = profiles.model_error * np.abs(values) + profiles.face_error * brightest
        noise = np.sqrt(variance)
        correlation = np.zeros((n_q, values.shape[1]))
        if profiles.shared is not None and len(values) > n_q:
            correlation = np.nan_to_num(profiles.shared / (noise[:n_q] * noise[-1]))
        return cls(
            values=values,
            noise=noise,
            correlation=correlation,
            std=np.sqrt(variance + error**2),
            use=np.isfinite(values),
            at_mm=at_mm,
            weight=0.5 * weight,
            to_points=CubicSpline(x_mm, np.eye(x_mm.size))(at_mm.ravel()),
            ratio=np.ones(n_q),
            ratio_std=np.maximum(np.asarray(told, dtype=np.float64), LEAST_STD),
        )

    @property
    def degrees_of_freedom(self) -> int:
        """Data less parameters."""
        n_scales = 1 + int(np.isinf(self.ratio_std).sum())
        return max(int(self.use.sum()) - 3 - n_scales, 1)

    def pulls(self, model: Array, scales: Array) -> Array:
        """Return data less model in units of their std, those measured; the contrasts' come last.

        (n_data + n_q,)
        """
        left = ((self.values - model) / self.std)[self.use]
        off = scales[:-1] / (scales[-1] * self.ratio) - 1.0
        return np.concatenate([left, off / self.ratio_std])

    def profiles(self, orders: list[Array], sigma_t: float, albedo: float) -> Array:
        """Return A(x; q) of every profile, (n, n_x)."""
        decay = np.exp(-sigma_t * self.at_mm)
        found = [
            ((self.to_points @ summed(of_q, albedo)).reshape(decay.shape) * decay) @ self.weight
            for of_q in orders
        ]
        return np.array(found)

    def scaled(self, shapes: Array) -> tuple[Array, Array]:
        """Return the best scales, that of white light last (n_q + 1,), and the shapes times these.

        Without white light its scale is what the contrasts say of it.
        """
        weighted = np.where(self.use, shapes / self.std**2, 0.0)
        up = np.where(self.use, weighted * self.values, 0.0).sum(axis=1)
        down = (weighted * shapes).sum(axis=1)
        n_q = self.ratio.size
        own = np.append(up[:n_q] / down[:n_q], up[n_q] / down[n_q] if up.size > n_q else np.nan)
        if up.size == n_q:
            own[-1] = float(np.mean(own[:-1] / self.ratio))
        # The prior is on a ratio of scales; it is linear about these.
        prior = 1.0 / (self.ratio_std * self.ratio * own[-1]) ** 2
        matrix = np.diag(np.append(down[:n_q] + prior, prior @ self.ratio**2))
        matrix[:-1, -1] = matrix[-1, :-1] = -prior * self.ratio
        right = np.append(up[:n_q], 0.0)
        if up.size > n_q:
            matrix[-1, -1] += down[n_q]
            right[-1] += up[n_q]
        scales = np.linalg.lstsq(matrix, right, rcond=None)[0]
        if up.size == n_q and not prior.any():
            scales[-1] = own[-1]  # nothing tells it, and nothing depends on it
        return scales, scales[: up.size, None] * shapes

    def with_ratio(self, ratio: Array, ratio_std: Array) -> Problem:
        """Return the problem with contrasts that were found to be others."""
        return replace(self, ratio=ratio, ratio_std=np.maximum(ratio_std, LEAST_STD))


def summed(orders: Array, albedo: float) -> Array:
    """Return the sum of all orders at an albedo, (n_x,), from those at one, (K, n_x).

    Orders beyond the last go on with the ratio of the last two.
    """
    total = albedo ** np.arange(orders.shape[0]) @ orders
    if orders.shape[0] < 3:
        return np.asarray(total)
    before, last = orders[-2], orders[-1]
    ratio = np.divide(last, before, out=np.zeros_like(last), where=before > 0.0)
    ratio = albedo * np.clip(ratio, 0.0, 0.99)
    return np.asarray(total + albedo ** (orders.shape[0] - 1) * last * ratio / (1.0 - ratio))
