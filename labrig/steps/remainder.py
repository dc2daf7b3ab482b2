"""What the fit of stripes and white light leaves of the white light, node by node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.light_field import Grid
from analysis.stripe_problem import FACE_ERROR, MODEL_ERROR
from analysis.white_picture import white_picture
from labrig.models.setup import Setup
from labrig.steps.decay import Decay
from labrig.steps.joint import Joint
from labrig.steps.rectify import Pictures, Series

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Remainder:
    """White light on the solver's nodes, and what its model leaves; those on walls are NaN.

    Attributes
    ----------
    white, residual : (n_y, n_x), counts/s
    rms_relative : rms of the residual over rms of the light
    chi2 : mean square of the residual in units of noise and model error together
    """

    white: Array
    residual: Array
    rms_relative: float
    chi2: float


def remainder(
    pictures: Pictures, setup: Setup, decay: Decay, joint: Joint, grid: Grid
) -> Remainder | None:
    """Compare the mean of the shifts with the picture of all bounces; None without such a fit."""
    if joint.fit is None or joint.observed is None:
        return None
    series = Series.main(pictures, setup)
    lit, n = series.low + (series.high - series.low) * series.duty, series.net.shape[0]
    white, count = grid.average(series.net.mean(axis=0, dtype=np.float64) / lit, pictures.pixel)
    spread = series.variance.mean(axis=0, dtype=np.float64) / (n * lit**2)
    noise = grid.average(spread, pictures.pixel)[0] / np.maximum(count, 1.0)
    model = white_picture(joint.fit, joint.observed, decay.tank, decay.beam, grid.x_mm, grid.y_mm)
    residual = white - model
    for picture in (white, residual):
        picture[[0, -1]] = picture[:, [0, -1]] = np.nan
    error = MODEL_ERROR * model + FACE_ERROR * np.nanmax(white)
    weighted = residual**2 / (error**2 + np.where(np.isfinite(noise), noise, 0.0))
    return Remainder(
        white=white,
        residual=residual,
        rms_relative=float(np.sqrt(np.nanmean(residual**2) / np.nanmean(white**2))),
        chi2=float(np.nanmean(weighted)),
    )
