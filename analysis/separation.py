"""Single and multiple scattering told apart by shifted stripes (Eqs. 7, 8).

Every estimator takes the stripe pictures with the black picture subtracted:
``net_k = D p_k + G duty`` with p_k the pattern from 0 (dark) to 1 (lit), D the direct light
(single scattering) and G the global light (multiple scattering) of a wholly lit field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError

Array = NDArray[np.float64]
Method = Literal["extrema", "known-pattern", "harmonic"]

DETECTION_SNR = 2.0  # below it direct light is "not detected"


@dataclass(frozen=True, slots=True, kw_only=True)
class Separation:
    """Direct and global light of a wholly lit field.

    Attributes
    ----------
    single, multiple : (rows, cols), in units of the input; NaN where a shift was saturated
    single_variance, multiple_variance : (rows, cols); NaN if the input's variance is unknown
    detected : (rows, cols), direct light at least twice its standard deviation; where the
        variance is unknown, wherever there is a value
    """

    method: Method
    single: Array
    multiple: Array
    single_variance: Array
    multiple_variance: Array
    detected: NDArray[np.bool_]


def separate_extrema(net: Array, variance: Array, duty: float = 0.5) -> Separation:
    """Separate by the extremes over the shifts: Eqs. 7 and 8 of the paper.

    ``I_1 = I_max - I_min``, ``I_M = I_min / duty``, which is 2 I_min for equal stripes. Noise
    lifts I_1 by about 2.5 standard deviations where there is no direct light (six shifts).

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    duty : lit share of the period
    """
    _refuse_stack(net, variance)
    high = np.argmax(net, axis=0)[None]
    low = np.argmin(net, axis=0)[None]
    brightest = np.take_along_axis(net, high, axis=0)[0]
    darkest = np.take_along_axis(net, low, axis=0)[0]
    var_high = np.take_along_axis(variance, high, axis=0)[0]
    var_low = np.take_along_axis(variance, low, axis=0)[0]
    return _separation(
        "extrema",
        np.asarray(np.isfinite(net).all(axis=0)),
        (brightest - darkest, darkest / duty),
        (var_high + var_low, var_low / duty**2),
    )


def separate_known(net: Array, variance: Array, pattern: Array, duty: float = 0.5) -> Separation:
    """Separate by least squares with the known pattern of every picture.

    ``(D, G) = argmin sum_k w_k (net_k - D p_k - G duty)^2``, the weights at a pixel being those of
    its mean over the shifts, equal for all (weights from each noisy value would bias low). The
    variances are propagated shot by shot.

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    pattern : (n_shifts, rows, 1) or (n_shifts, rows, cols), light of the projector there, 0 .. 1

    Raises
    ------
    AnalysisError
        If the pattern is the same in every picture.
    """
    _refuse_stack(net, variance)
    n = net.shape[0]
    mean = pattern.mean(axis=0)
    spread = ((pattern - mean) ** 2).sum(axis=0)
    if not (spread > 1e-6).any():
        msg = "the known pattern does not change from picture to picture; is its phase right?"
        raise AnalysisError(msg)
    usable = np.broadcast_to(spread > 1e-3 * spread.max(), net.shape[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = (pattern - mean) / spread
    single = (weights * net).sum(axis=0)
    offset_weights = 1.0 / n - mean * weights
    multiple = (offset_weights * net).sum(axis=0) / duty
    return _separation(
        "known-pattern",
        np.asarray(np.isfinite(net).all(axis=0) & usable),
        (single, multiple),
        (
            (weights**2 * variance).sum(axis=0),
            (offset_weights**2 * variance).sum(axis=0) / duty**2,
        ),
    )


def separate_harmonic(net: Array, variance: Array, *, contrast: float, duty: float) -> Separation:
    """Separate by the first harmonic over the shifts, whatever the pattern's phase.

    ``z = (2/N) sum net_k exp(-2 pi i k/N)``, ``D = sqrt(max(|z|^2 - 4 s^2/N, 0)) / c1``,
    ``G = (mean - D duty) / duty``, with s^2 the mean variance (no debias where it is unknown).

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    contrast : c1, amplitude of the pattern's fundamental; see `square_contrast`

    Raises
    ------
    AnalysisError
        For fewer than four shifts: the second harmonic of a projector's gamma would alias onto
        the first.
    """
    _refuse_stack(net, variance)
    n = net.shape[0]
    if n < 4:
        msg = (
            f"{n} shifts of unknown phase: the harmonic estimator needs at least 4, equally "
            "spaced over one period; use extrema or take more shifts."
        )
        raise AnalysisError(msg)
    phase = np.exp(-2j * np.pi * np.arange(n) / n)
    z = (2.0 / n) * np.tensordot(phase, net, axes=1)
    noise = np.nan_to_num(variance.mean(axis=0), nan=0.0)
    amplitude = np.sqrt(np.maximum(np.abs(z) ** 2 - 4.0 * noise / n, 0.0))
    single = amplitude / contrast
    mean = net.mean(axis=0)
    single_variance = (2.0 / n) * variance.mean(axis=0) / contrast**2
    mean_variance = variance.sum(axis=0) / n**2
    return _separation(
        "harmonic",
        np.asarray(np.isfinite(net).all(axis=0)),
        (single, mean / duty - single),
        (single_variance, mean_variance / duty**2 + single_variance),
    )


def as_if_white(separation: Separation, *, low: float, high: float, duty: float) -> Separation:
    """Return what stripes between two levels say of fully lit stripes between dark and white.

    Stripes of light ``low`` and ``high``, shares of white, are ``net = (high - low) D p + ...``:
    ``D' = D / (high - low)``, ``G' = (G duty - low D') / (low + (high - low) duty)``.

    Raises
    ------
    AnalysisError
        Unless 0 <= low < high <= 1.
    """
    if not 0.0 <= low < high <= 1.0:
        msg = f"stripes between {low} and {high} of white; 0 <= low < high <= 1 is needed."
        raise AnalysisError(msg)
    span, mean = high - low, low + (high - low) * duty
    single = separation.single / span
    single_variance = separation.single_variance / span**2
    return replace(
        separation,
        single=single,
        single_variance=single_variance,
        multiple=(separation.multiple * duty - low * single) / mean,
        multiple_variance=(separation.multiple_variance * duty**2 + low**2 * single_variance)
        / mean**2,
    )


def square_contrast(duty: float) -> float:
    """Return c1 of a sharp square stripe: (2/pi) sin(pi duty)."""
    return 2.0 / math.pi * math.sin(math.pi * duty)


def closure(separation: Separation, white: Array) -> Array:
    """Return (single + multiple) / white - 1, with the black picture off ``white``, (rows, cols).

    Zero where the stripes together are the white light. NaN where white is not positive.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (separation.single + separation.multiple) / white - 1.0
    return np.where(white > 0.0, ratio, np.nan)


def _separation(
    method: Method,
    valid: NDArray[np.bool_],
    values: tuple[Array, Array],
    variances: tuple[Array, Array],
) -> Separation:
    single, multiple = (np.where(valid, v, np.nan) for v in values)
    single_variance, multiple_variance = (np.where(valid, v, np.nan) for v in variances)
    unknown = np.isnan(single_variance)
    detected = valid & (unknown | (single > DETECTION_SNR * np.sqrt(single_variance)))
    return Separation(
        method=method,
        single=single,
        multiple=multiple,
        single_variance=single_variance,
        multiple_variance=multiple_variance,
        detected=detected,
    )


def _refuse_stack(net: Array, variance: Array) -> None:
    if net.ndim != 3 or variance.shape != net.shape or net.shape[0] < 2:
        msg = (
            f"stripe pictures of shape {net.shape} with variance {variance.shape}: "
            f"a stack (n_shifts >= 2, rows, cols) of both is needed."
        )
        raise AnalysisError(msg)
