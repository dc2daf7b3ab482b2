"""The bounces of a layer over its whole picture, and what they leave of the white light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.slab_field import slab_bounces
from analysis.stripe_problem import FACE_ERROR, MODEL_ERROR
from labrig.models.analysis import Analysis
from labrig.steps.bounces import Explained
from labrig.steps.decay import Decay
from labrig.steps.remainder import Remainder
from labrig.steps.slab import Layer

Array = NDArray[np.float64]

MOST_RATIO = 0.99  # of successive bounces, beyond the last one computed


def as_layer(
    layer: Layer | None,
    explained: Explained,
    left: Remainder | None,
    decay: Decay,
    config: Analysis,
) -> tuple[Explained, Remainder | None]:
    """Return the bounces of a layer in place of a plane's, and what they leave of white light.

    Without a fit of a layer both are returned as they are.
    """
    if layer is None or layer.fit is None or layer.medium is None or layer.slab is None:
        return explained, left
    found = slab_bounces(
        layer.medium, layer.slab, decay.beam, explained.grid, n_bounces=config.n_bounces
    )
    explained = replace(explained, bounces=found.seen, layer_fluence=found.fluence)
    if left is None:
        return explained, None
    model = scale_c_of(layer, decay) * _all(found.seen.fluence)
    residual = np.where(np.isfinite(left.residual), left.white - model, np.nan)
    error = MODEL_ERROR * model + FACE_ERROR * np.nanmax(left.white)
    return explained, Remainder(
        white=left.white,
        residual=residual,
        rms_relative=float(np.sqrt(np.nanmean(residual**2) / np.nanmean(left.white**2))),
        chi2=float(np.nanmean((residual / error) ** 2)),
    )


def scale_c_of(layer: Layer, decay: Decay) -> float:
    """Return the light of the ballistic beam where it enters, counts/s: c of Eq. 9."""
    if layer.fit is None:
        msg = "a layer without a fit has no scale"
        raise ValueError(msg)
    y, light = decay.beam.profile_points()
    across = float(np.sum(0.5 * (light[1:] + light[:-1]) * np.diff(y)))
    return float(layer.fit.scales[-1]) / across


def _all(orders: Array) -> Array:
    """Return the sum of bounces (K, n_y, n_x), going on with the ratio of the last two."""
    total, last, before = orders.sum(axis=0), orders[-1], orders[-2]
    ratio = np.divide(last, before, out=np.zeros_like(last), where=before > 0.0)
    ratio = np.clip(ratio, 0.0, MOST_RATIO)
    return np.asarray(total + last * ratio / (1.0 - ratio))
