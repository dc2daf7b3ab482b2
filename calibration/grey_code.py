"""Grey codes decoded: which projector pixel lights which camera pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from calibration.errors import CalibrationError

Array = NDArray[np.float32]
Counts = NDArray[np.uint16] | NDArray[np.float64]

LIT_SHARE = 0.1  # of the brightest percent of white less black; darker pixels are not decoded
SURE_SHARE = 0.1  # of white less black, by which plain and inverse must differ
SMOOTHED_PX = 9  # window over which whole projector pixels become fractions
STRAY_PX = 1.5  # from the smooth map; a code farther off is an error
FULL_SHARE = 0.5  # of the window that must be decoded


@dataclass(frozen=True, slots=True, kw_only=True)
class ProjectorMap:
    """Where one axis of the projector falls in the camera's picture.

    Attributes
    ----------
    position_px : (rows, cols), projector px from the edge of the first pixel, between pixels too;
        NaN where it is unknown
    valid : (rows, cols), pixels whose own code is sure and agrees with its neighbours
    residual_px : standard deviation of the whole codes about ``position_px``; rounding alone
        makes 0.29
    """

    axis: str
    n_px: int
    position_px: Array
    valid: NDArray[np.bool_]
    residual_px: float


def decode_grey(
    plain: Sequence[Counts],
    inverse: Sequence[Counts],
    white: Counts,
    black: Counts,
    *,
    axis: str,
    n_px: int,
) -> ProjectorMap:
    """Decode pictures (rows, cols) of the bits of a Grey code, most significant first.

    A bit is one where the plain picture is brighter than the inverse. A pixel counts if it is lit
    and at most one of its bits is unsure: neighbours in a Grey code differ in one bit, so that
    one can only be off by a projector pixel. Positions between pixels come from the mean of the
    codes nearby, taken about a smooth surface.

    Raises
    ------
    CalibrationError
        If bits are missing, shapes differ, or hardly anything is lit.
    """
    n_bits = max(n_px - 1, 1).bit_length()
    if not len(plain) == len(inverse) == n_bits:
        msg = (
            f"{len(plain)} plain and {len(inverse)} inverse pictures along {axis}: {n_px} px need "
            f"{n_bits} of each; capture all bits."
        )
        raise CalibrationError(msg)
    contrast = white.astype(np.float64) - black
    lit = contrast > LIT_SHARE * float(np.percentile(contrast, 99.0))
    if contrast.max() <= 0 or lit.mean() < 1e-3:
        msg = "white is nowhere brighter than black: the projector does not light this picture."
        raise CalibrationError(msg)
    code = np.zeros(white.shape, dtype=np.int32)
    bit = np.zeros(white.shape, dtype=bool)
    unsure = np.zeros(white.shape, dtype=np.uint8)
    for one, other in zip(plain, inverse, strict=True):
        difference = one.astype(np.float64) - other
        bit = bit ^ (difference > 0)
        code = 2 * code + bit
        unsure += np.abs(difference) < SURE_SHARE * contrast
    sure = lit & (unsure <= 1) & (code < n_px)
    if sure.mean() < 1e-3:
        msg = (
            f"no pixel of the Grey code along {axis} is sure; focus the projector, or use brighter "
            "light."
        )
        raise CalibrationError(msg)
    return _smoothed(code, sure, axis, n_px)


def _smoothed(
    code: NDArray[np.int32], sure: NDArray[np.bool_], axis: str, n_px: int
) -> ProjectorMap:
    """Return positions between pixels: a surface, plus the mean of what the codes leave of it."""
    surface = _surface(code + 0.5, sure)
    rest = np.where(sure, code + 0.5 - surface, 0.0).astype(np.float32)
    near = sure
    for _ in range(2):
        share = uniform_filter(near.astype(np.float32), SMOOTHED_PX)
        mean = uniform_filter(np.where(near, rest, np.float32(0.0)), SMOOTHED_PX)
        with np.errstate(divide="ignore", invalid="ignore"):
            local = mean / share
        # the second time without the codes that the first showed to be errors
        near = sure & (np.abs(rest - local) < STRAY_PX)
    position = np.where(share > FULL_SHARE, surface + local, np.nan).astype(np.float32)
    valid = near & np.isfinite(position)
    left = (code + 0.5 - position)[valid]
    return ProjectorMap(
        axis=axis,
        n_px=n_px,
        position_px=position,
        valid=valid,
        residual_px=float(left.std()) if left.size else float("nan"),
    )


def _surface(position: NDArray[np.floating[Any]], sure: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the cubic surface through the positions, stray codes left out, (rows, cols)."""
    rows, cols = position.shape
    y = np.linspace(-1.0, 1.0, rows)[:, None]
    x = np.linspace(-1.0, 1.0, cols)[None, :]
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    terms = [np.broadcast_to(x**i * y**j, position.shape) for i, j in powers]
    step = max(1, int(np.sqrt(sure.sum() / 20_000)))
    some = np.zeros_like(sure)
    some[::step, ::step] = sure[::step, ::step]
    rows_of = np.stack([term[some] for term in terms], axis=1)
    wanted = position[some]
    kept = np.ones(wanted.size, dtype=bool)
    solution: NDArray[np.floating[Any]] = np.zeros(len(terms))
    for _ in range(5):
        solution, *_ = np.linalg.lstsq(rows_of[kept], wanted[kept], rcond=None)
        rest = np.abs(wanted - rows_of @ solution)
        kept = rest <= 3.0 * 1.4826 * max(float(np.median(rest)), 0.3)
    surface = sum(c * term for c, term in zip(solution, terms, strict=True))
    return np.asarray(surface, dtype=np.float32)
