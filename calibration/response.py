"""Counts into linear counts: sRGB and tables by name, and a response fitted from an exposure ramp.

A machine-vision camera is linear; its response is checked, never fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, nnls

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

LINEAR_WITHIN = 0.02  # deviation from a line below which a camera counts as linear
SMOOTH = 1e-3  # weight of second differences of the fitted response, per pixel and exposure
HALF_LIT = 0.5  # pattern less inverse over white less black, below which a pixel is half lit
MAX_FITTED_BITS = 8  # a table of more levels is not determined by a ramp


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """What turns counts into linear counts.

    Attributes
    ----------
    name : ``linear``, ``srgb``, or where a table comes from
    table : (2^bits,), linear counts of each count, rising; empty if linear
    """

    name: str
    table: Array

    def linear(self, bits: int) -> Array:
        """Return the linear counts of 0 .. 2^bits - 1.

        Raises
        ------
        CalibrationError
            If the table is of another bit depth.
        """
        if not self.table.size:
            return np.arange(2**bits, dtype=np.float64)
        if self.table.size != 2**bits:
            msg = (
                f"response {self.name!r} is a table of {self.table.size} counts, the camera has "
                f"{bits} bits; fit the response of this camera."
            )
            raise CalibrationError(msg)
        return self.table


LINEAR = Response(name="linear", table=np.empty(0))


def srgb_response(bits: int) -> Response:
    """Return the response of sRGB pictures (IEC 61966-2-1), linear counts to the same white."""
    top = 2**bits - 1
    share = np.arange(top + 1) / top
    low = share / 12.92
    return Response(
        name="srgb", table=top * np.where(share <= 0.04045, low, ((share + 0.055) / 1.055) ** 2.4)
    )


def table_response(name: str, table: Sequence[float] | Array) -> Response:
    """Return a response given as a table of linear counts.

    Raises
    ------
    CalibrationError
        If it is not finite, rises nowhere, or falls somewhere.
    """
    values = np.asarray(table, dtype=np.float64)
    if values.ndim != 1 or values.size < 2 or not np.isfinite(values).all():
        msg = f"response {name!r} is no table of finite numbers, one a count; mend it."
        raise CalibrationError(msg)
    falls = np.flatnonzero(np.diff(values) < 0.0)
    if falls.size or values[-1] <= values[0]:
        where = int(falls[0]) if falls.size else 0
        msg = f"response {name!r} does not rise at count {where}: more light must give more counts."
        raise CalibrationError(msg)
    return Response(name=name, table=values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp:
    """Counts of the same pixels at several exposures of unchanged light.

    Attributes
    ----------
    counts : (n_exposures, n_pixels) uint8 or uint16
    exposures_s : (n_exposures,)
    """

    counts: NDArray[np.uint16]
    exposures_s: Array
    bits: int
    black_level_dn: float
    white_level_dn: float

    def __post_init__(self) -> None:
        n = len(set(self.exposures_s.tolist()))
        if n < 3:
            msg = (
                f"a ramp of {n} exposures that differ: a response needs 3 or more of unchanged "
                "light, each two or three times the last."
            )
            raise CalibrationError(msg)
        if int(self.counts.max()) >= 2**self.bits:
            msg = f"the ramp holds {int(self.counts.max())} DN, more than {self.bits} bits can."
            raise CalibrationError(msg)


def sample_ramp(
    frames: Sequence[NDArray[np.uint16]], n_pixels: int = 3000, seed: int = 1
) -> NDArray[np.uint16]:
    """Return the counts (n_exposures, n_pixels) of pixels of all brightnesses alike.

    Pixels are drawn evenly over the range of the middle frame, so that rare levels are heard.
    """
    middle = frames[len(frames) // 2].ravel()
    order = np.argsort(middle, kind="stable")
    levels = np.linspace(float(middle[order[0]]), float(middle[order[-1]]), n_pixels)
    at = np.searchsorted(middle[order], levels)
    rng = np.random.default_rng(seed)
    chosen = np.unique(np.r_[order[np.minimum(at, middle.size - 1)], rng.choice(order, n_pixels)])
    return np.stack([frame.ravel()[chosen] for frame in frames])


def deviations_of(ramp: Ramp) -> Array:
    """Return how far each exposure departs from proportional light, (n_exposures,), share of it.

    Each pixel's counts above black are divided by exposure and compared with their weighted mean;
    the median over pixels is free of noise, and a bent response moves every pixel alike. Clipped
    counts and those below a twentieth of the range are left out; NaN where nothing is left.

    Raises
    ------
    CalibrationError
        If no pixel is seen well at two exposures.
    """
    signal = ramp.counts - ramp.black_level_dn
    span = ramp.white_level_dn - ramp.black_level_dn
    seen = (ramp.counts < 0.95 * ramp.white_level_dn) & (signal > 0.05 * span)
    twice = seen.sum(axis=0) >= 2
    if twice.sum() < 10:
        msg = "no pixel of the ramp is seen unclipped at two exposures; choose them closer."
        raise CalibrationError(msg)
    t = ramp.exposures_s[:, None]
    light = np.where(seen, signal, 0.0).sum(axis=0) / np.maximum((seen * t).sum(axis=0), 1e-300)
    off = np.where(seen, signal / np.where(light > 0, light * t, np.nan) - 1.0, np.nan)[:, twice]
    found = np.full(ramp.exposures_s.size, np.nan)
    heard = np.isfinite(off).any(axis=1)
    found[heard] = np.nanmedian(off[heard], axis=1)
    return found


def linearity_of(ramp: Ramp) -> float:
    """Return the rms over exposures of how far a ramp departs from proportional light."""
    return float(np.sqrt(np.nanmean(deviations_of(ramp) ** 2)))


def fit_response(ramp: Ramp, *, smooth: float = SMOOTH) -> Response:
    """Fit the unknown response of a processed camera from a ramp, monotone by construction.

    Debevec and Malik 1997: ``min sum w (ln f(Z_ij) - ln E_i - ln t_j)^2`` plus smoothness, the
    E_i eliminated, and ln f written as a sum of steps that are not negative, which makes it a
    non-negative least squares of 2^bits unknowns.

    Raises
    ------
    CalibrationError
        If the camera is linear (nothing is fitted where linearity holds), has more than 8 bits, or
        the ramp does not link its levels.
    """
    if ramp.bits > MAX_FITTED_BITS:
        msg = (
            f"a camera of {ramp.bits} bits is not given a fitted response; check its linearity, or "
            "give its table."
        )
        raise CalibrationError(msg)
    found = linearity_of(ramp)
    if found <= LINEAR_WITHIN:
        msg = (
            f"the camera is linear within {100 * found:.1f} % (limit {100 * LINEAR_WITHIN:.0f} %): "
            "no response is fitted where linearity holds; leave response: linear."
        )
        raise CalibrationError(msg)
    curvature, slope = _normal_equations(ramp)
    n = slope.size
    bend = np.diff(np.eye(n), n=2, axis=0)
    # ln f is a sum of rises up to each count
    rises = np.tril(np.ones((n, n)))[:, 1:]
    quadratic = rises.T @ (curvature + smooth * (bend.T @ bend) + 1e-9 * np.eye(n)) @ rises
    factor = np.linalg.cholesky(quadratic)
    wanted = np.linalg.solve(factor, rises.T @ slope)
    solution, _ = nnls(factor.T, wanted, maxiter=30 * n)
    log_f = rises @ solution
    return table_response("fitted", (2**ramp.bits - 1) * np.exp(log_f - log_f[-1]))


@dataclass(frozen=True, slots=True)
class PowerResponse:
    """A camera whose counts above black are a power of light: ``counts = light^power``."""

    power: float

    @property
    def at_half(self) -> float:
        """How far the counts of half the light depart from half the counts, share of these."""
        return float(2.0 ** (1.0 - self.power) - 1.0)

    def light(self, counts: Array) -> Array:
        """Return what counts above black stand for; noise below black stays below."""
        return np.asarray(np.sign(counts) * np.abs(counts) ** (1.0 / self.power))

    def closures(self, pairs: Sequence[tuple[Array, Array]], white: Array, black: Array) -> Array:
        """Return the mean over pixels of ``(P + P_inv)/(W + B) - 1`` in light, (n_pairs,)."""
        return np.asarray(self._gaps(pairs, white, black).mean(axis=1))

    def by_mixture(self, pairs: Sequence[tuple[Array, Array]], white: Array, black: Array) -> Array:
        """Return the mean of the same over all pairs, of pixels half lit and of others, (2,).

        A bent response shows most where a pixel is half lit, and not at all where it is fully lit
        by one of the two; light that is lost shows alike in both.
        """
        gaps = self._gaps(pairs, white, black)
        lit = np.array([a - b for a, b in pairs]) / (white - black)
        half = np.abs(lit) < HALF_LIT
        return np.array([np.mean(gaps[half]) if half.any() else 0.0, np.mean(gaps[~half])])

    def _gaps(self, pairs: Sequence[tuple[Array, Array]], white: Array, black: Array) -> Array:
        whole = self.light(white) + self.light(black)
        return np.array([(self.light(a) + self.light(b)) / whole - 1.0 for a, b in pairs])

    def response(self, bits: int, black_level_dn: float) -> Response:
        """Return it as a table over all counts, linear counts to the same white."""
        top = 2**bits - 1
        share = (np.arange(top + 1) - black_level_dn) / (top - black_level_dn)
        table = black_level_dn + (top - black_level_dn) * self.light(share)
        return table_response(f"power {self.power:.3f}", table)


def power_of_pairs(
    pairs: Sequence[tuple[Array, Array]], white: Array, black: Array, bits: int
) -> PowerResponse:
    """Fit the power response under which a pattern and its inverse add to white and black.

    Light adds, counts need not: ``counts = light^p`` is sought with the least mean square of
    ``(P + P_inv)/(W + B) - 1``. For cameras of 8 bits whose ramp was not taken; what the projector
    itself loses in fine stripes is not told from it, so test it on other pixels.

    Parameters
    ----------
    pairs : counts (n_pixels,) above the camera's black level of patterns and of their inverses,
        none saturated
    white, black : (n_pixels,), likewise

    Raises
    ------
    CalibrationError
        If the camera has more than eight bits, there is no pair, or no power between 0.5 and 2
        fits.
    """
    if bits > MAX_FITTED_BITS or not pairs:
        msg = f"{len(pairs)} pairs of a camera of {bits} bits: pairs of 8 bits or fewer are needed."
        raise CalibrationError(msg)

    def off(power: float) -> float:
        return float(np.mean(PowerResponse(power).closures(pairs, white, black) ** 2))

    power = float(minimize_scalar(off, bounds=(0.5, 2.0), method="bounded").x)
    if not 0.51 < power < 1.99:
        msg = "a pattern and its inverse add to white under no power of the counts; linear frames?"
        raise CalibrationError(msg)
    return PowerResponse(power)


def _normal_equations(ramp: Ramp) -> tuple[Array, Array]:
    """Return matrix (n, n) and right side (n,) of the fit of ln f, the pixels' light eliminated."""
    n = 2**ramp.bits
    count = np.arange(n)
    span = ramp.white_level_dn - ramp.black_level_dn
    # Debevec's hat: both ends of the range are least sure
    hat = np.minimum(count - ramp.black_level_dn, ramp.white_level_dn - count) / span
    hat[(count >= 0.95 * ramp.white_level_dn) | (hat < 0.0)] = 0.0
    weight = hat[ramp.counts]
    together = weight.sum(axis=0)
    use = (weight > 0.0).sum(axis=0) >= 2
    if use.sum() < 10:
        msg = "the ramp links no levels: no pixel is seen at two exposures; choose them closer."
        raise CalibrationError(msg)
    counts, weight, together = ramp.counts[:, use], weight[:, use], together[use]
    log_t = np.log(ramp.exposures_s)[:, None]
    wanted = weight * (log_t - (weight * log_t).sum(axis=0) / together)
    visits = np.zeros((counts.shape[1], n))
    pixel = np.broadcast_to(np.arange(counts.shape[1]), counts.shape)
    np.add.at(visits, (pixel, counts), weight)
    matrix = np.diag(np.bincount(counts.ravel(), weight.ravel(), n))
    matrix = matrix - visits.T @ (visits / together[:, None])
    right = np.bincount(counts.ravel(), wanted.ravel(), n)
    scale = n / weight.sum()
    return matrix * scale, right * scale
