"""How well a separation went: closure, second harmonic, and the stripes it left."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from analysis.errors import AnalysisError
from analysis.separation import Separation

Array = NDArray[np.float64]
Stack = NDArray[np.floating[Any]]

RESIDUE_PX = 25  # stripes are narrower; what is wider than this is no residue of them


def harmonic_ratio(net: Stack) -> Array:
    """Return |z_2| / |z_1|, second harmonic over first, of shifts over one period, (rows, cols).

    A gamma of the projector, or stripes that are no sinusoid, show in it.

    Raises
    ------
    AnalysisError
        For fewer than five shifts, in which the two cannot be told apart.
    """
    n = net.shape[0]
    if n < 5:
        msg = f"{n} shifts do not tell the second harmonic from the first; 5 are needed."
        raise AnalysisError(msg)
    turn = np.exp(-2j * np.pi * np.arange(n) / n)
    first, second = (np.abs(np.tensordot(turn**h, net, axes=1)) for h in (1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(second / first, dtype=np.float64)


def stripe_residue(share: Array, width_px: int = RESIDUE_PX) -> float:
    """Return the standard deviation of direct light over white at scales finer than a width.

    A separation that is right leaves none of its stripes in the direct light. NaN if nothing is
    left.

    Parameters
    ----------
    share : (rows, cols), direct light over white; NaN is left out
    """
    known = np.isfinite(share)
    filled = np.where(known, share, 0.0)
    weight = uniform_filter(known.astype(np.float64), width_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = filled - uniform_filter(filled, width_px) / weight
    chosen = rest[known & (weight > 0.5)]
    return float(chosen.std()) if chosen.size else math.nan


def closure(separation: Separation, white: Array, black: Array | float = 0.0) -> Array:
    """Return (D + G) / W - 1 with black's leak pixel by pixel, (rows, cols), duty one half.

    Pictures of stripes hold (1 + b)/2 of white, b the leak of black over white:
    ``(single + multiple + 2 black) / (white + 2 black) - 1``, with black off ``white`` as it is off
    the stripes. So for a pattern and its inverse this is (P + P_inv)/(W + B) - 1, and light that
    is lost to the fineness of stripes counts once. Zero where the stripes together are the white
    light. NaN where white is not positive.

    Parameters
    ----------
    white, black : (rows, cols), black taken off white
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        together = separation.single + separation.multiple + 2.0 * black
        ratio = together / (white + 2.0 * black) - 1.0
    return np.where(white > 0.0, ratio, np.nan)
