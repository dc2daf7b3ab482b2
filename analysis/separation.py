"""Single and multiple scattering told apart by shifted stripes (Eqs. 7, 8).

Every estimator takes the stripe pictures with the black picture subtracted:
``net_k = D p_k + G duty`` with p_k the pattern from 0 (dark) to 1 (lit), D the direct light
(single scattering) and G the global light (multiple scattering) of a wholly lit field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from analysis import separation_kernels as kernels
from analysis.errors import AnalysisError

Array = NDArray[np.floating[Any]]
Method = Literal["extrema", "known-pattern", "harmonic"]

MIN_PHASES = 4  # of an unknown phase; fewer alias the second harmonic onto the first
MIN_SPREAD = 2.5e-4  # mean square of a known pattern about its mean, below which it tells nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Separation:
    """Direct and global light of a wholly lit field, in the precision of the input.

    Attributes
    ----------
    single, multiple : (rows, cols), in units of the input, signed; NaN where a shift was saturated
    single_variance, multiple_variance : (rows, cols); NaN if the input's variance is unknown
    detected : (rows, cols), direct light at least twice its standard deviation; where the
        variance is unknown, wherever there is a value
    chi2 : (rows, cols), what the model leaves of the shifts in units of their noise, per degree of
        freedom; NaN for extrema, without degrees of freedom, or if the variance is unknown
    """

    method: Method
    single: Array
    multiple: Array
    single_variance: Array
    multiple_variance: Array
    detected: NDArray[np.bool_]
    chi2: Array


def separate_extrema(
    net: Array, variance: Array, duty: float = 0.5, leak: float | Array = 0.0
) -> Separation:
    """Separate by the extremes over the shifts: Eqs. 7 and 8 of the paper.

    ``I_1 = I_max - I_min``, ``I_M = I_min / duty``, which is 2 I_min for equal stripes. Noise
    lifts I_1 by about 2.5 standard deviations where there is no direct light (six shifts). Where
    the black picture was not subtracted, its leak b makes them (Nayar 2006)
    ``D = (I_max - I_min)/(1 - b)``, ``G = (I_max - D)/(b + (1 - b) duty)``.

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    duty : lit share of the period
    leak : b, black over white, a number or (rows, cols); zero where black was subtracted

    Raises
    ------
    AnalysisError
        If a leak is not below one, or the stack is none.
    """
    _refuse_stack(net, variance)
    if not np.nanmax(leak) < 1.0:
        msg = f"a leak of {float(np.nanmax(leak)):g} of white: black must be darker than white."
        raise AnalysisError(msg)
    found = _empty("extrema", net)
    kernels.extrema(net, variance, duty, *_parts(found))
    if np.any(leak):
        floor = np.asarray(leak) + (1.0 - np.asarray(leak)) * duty
        brightest = found.single + found.multiple * duty
        single = found.single / (1.0 - np.asarray(leak))
        multiple = (brightest - single) / floor
        variance_of = found.single_variance / (1.0 - np.asarray(leak)) ** 2
        found = replace(
            found,
            single=single,
            multiple=multiple,
            single_variance=variance_of,
            multiple_variance=found.multiple_variance * (duty / floor) ** 2
            + variance_of * (np.asarray(leak) / floor) ** 2,
        )
    return found


def separate_known(net: Array, variance: Array, pattern: Array, duty: float = 0.5) -> Separation:
    """Separate by least squares with the known pattern of every picture.

    ``(D, G) = argmin sum_k w_k (net_k - D p_k - G duty)^2``, the weights at a pixel being those of
    its mean over the shifts, equal for all (weights from each noisy value would bias low). The
    variances are propagated shot by shot.

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    pattern : (n_shifts, rows, 1) or (n_shifts, rows, cols), light of the projector there, 0 .. 1;
        NaN where it is unknown

    Raises
    ------
    AnalysisError
        If the pattern is the same in every picture.
    """
    _refuse_stack(net, variance)
    if pattern.shape[0] != net.shape[0] or pattern.shape[1] != net.shape[1]:
        msg = f"a pattern of shape {pattern.shape} for pictures of {net.shape}: one each is needed."
        raise AnalysisError(msg)
    found = _empty("known-pattern", net)
    told = kernels.known(net, variance, pattern, duty, MIN_SPREAD * net.shape[0], *_parts(found))
    if not told:
        msg = "the known pattern does not change from picture to picture; is its phase right?"
        raise AnalysisError(msg)
    return found


def separate_harmonic(
    net: Array, variance: Array, *, contrast: float | Array, duty: float
) -> Separation:
    """Separate by the first harmonic over the shifts, whatever the pattern's phase.

    ``z = (2/N) sum net_k exp(-2 pi i k/N)``, ``D = sqrt(max(|z|^2 - 4 s^2/N, 0)) / c1``,
    ``G = mean / duty - D``, with s^2 the mean variance (no debias where it is unknown). A sharp
    square stripe's 5th and 7th harmonics alias onto the first at N = 6, a ripple of up to 6 %.

    Parameters
    ----------
    net, variance : (n_shifts, rows, cols), black subtracted
    contrast : c1, amplitude of the pattern's fundamental; a number, or one a column (cols,); see
        `square_contrast`

    Raises
    ------
    AnalysisError
        For fewer than four shifts: the second harmonic of a projector's gamma would alias onto
        the first. If c1 is not positive.
    """
    _refuse_stack(net, variance)
    n, _, cols = net.shape
    refuse_few_phases(n)
    c1 = np.broadcast_to(np.asarray(contrast, dtype=net.dtype), (cols,))
    if not (c1 > 0.0).all():
        msg = f"contrast {float(c1.min()):g} of the stripes is not positive; measure c1."
        raise AnalysisError(msg)
    found = _empty("harmonic", net)
    turn = 2.0 * np.pi * np.arange(n) / n
    wave = np.stack([np.cos(turn), -np.sin(turn)]) * (2.0 / n)
    kernels.harmonic(net, variance, wave.astype(net.dtype), 1.0 / c1, duty, *_parts(found))
    return found


def refuse_few_phases(n_shifts: int) -> None:
    """Refuse to separate an unknown phase by fewer than four shifts.

    Raises
    ------
    AnalysisError
        With the reason.
    """
    if n_shifts < MIN_PHASES:
        msg = (
            f"{n_shifts} shifts of unknown phase: the harmonic estimator needs at least "
            f"{MIN_PHASES}, equally spaced over one period, or the second harmonic of the "
            "projector's gamma passes for the first (11 % stripes with three); take more shifts, "
            "or ask for separation: extrema."
        )
        raise AnalysisError(msg)


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


def _empty(method: Method, net: Array) -> Separation:
    shape = net.shape[1:]
    # One block, which comes in huge pages where five of a few MB come in thousands of small ones
    single, multiple, of_single, of_multiple, chi2 = np.empty((5, *shape), net.dtype)
    return Separation(
        method=method,
        single=single,
        multiple=multiple,
        single_variance=of_single,
        multiple_variance=of_multiple,
        detected=np.empty(shape, dtype=np.bool_),
        chi2=chi2,
    )


def _parts(found: Separation) -> tuple[Array, ...]:
    """Return the arrays that a kernel fills, (rows, cols) each."""
    return (
        found.single,
        found.multiple,
        found.single_variance,
        found.multiple_variance,
        found.detected.view(np.uint8),
        found.chi2,
    )


def _refuse_stack(net: Array, variance: Array) -> None:
    if net.ndim != 3 or variance.shape != net.shape or net.shape[0] < 2:
        msg = (
            f"stripe pictures of shape {net.shape} with variance {variance.shape}: "
            f"a stack (n_shifts >= 2, rows, cols) of both is needed."
        )
        raise AnalysisError(msg)
