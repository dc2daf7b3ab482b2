"""Separates and fits a set of live stripes on a reduced grid, by the steps of any analysis."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from labrig.config import parse
from labrig.door import StripeSet
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.rectify import Pictures
from labrig.shown import Fitted
from labrig.steps import attenuate, explain, render_bounces, separate

NODES = 33  # of the reduced grid, along the depth
SHOWN = 6  # bounces
COARSE = {
    "schema": "labrig-analysis/1",
    "n_theta": 28,
    "n_bounces": 8,
    "g_range": (-0.3, 0.7),
    "n_g": 5,
}


def decompose(found: StripeSet) -> Fitted:
    """Return extinction, scattering and the first bounces of a live set.

    What stops the fit is said in ``why``; what was found before stands. Uncertainties are
    statistical. ``plan_std`` is what shot noise leaves of that of sigma_t under the whole plan,
    which exposes every shift ``plan_s``.
    """
    begun = time.process_time()
    setup = parse(found.setup, Setup, source="live")
    pictures = _pictures(found, setup)
    values: dict[str, tuple[float, float]] = {}
    bounces: NDArray[np.float64] | None = None
    depth = single = fit = np.empty(0)
    plan_std, why = math.nan, ""
    config = _config(setup, pictures)
    separated = separate(pictures, setup, config)
    try:
        decay = attenuate(separated, pictures, setup, config)
        of = decay.attenuation
        depth, single, fit = decay.single.depth_mm, decay.single.value, of.at(decay.single.depth_mm)
        std = math.sqrt(of.covariance[1, 1] * max(of.chi2_per_dof, 1.0))
        values["sigma_t"] = (of.sigma_t_per_mm, std)
        shot_noise = math.sqrt(of.covariance[1, 1])
        plan_std = shot_noise * math.sqrt(found.exposure_s / found.plan_s)
        explained = explain(separated, decay, render_bounces(decay, pictures, config), pictures)
        of_g = explained.inversion
        values["sigma_s"] = (of_g.sigma_s_per_mm, _std(of_g.covariance[0, 0]))
        values["g"] = (of_g.g, _std(of_g.covariance[1, 1]))
        grid = explained.grid
        inside = (grid.y_mm > decay.beam.from_mm) & (grid.y_mm < decay.beam.to_mm)
        bounces = of.scale_c * explained.bounces.fluence[:SHOWN, inside].mean(axis=1)
        if of_g.at_limit:
            why = "g or the albedo stands at the end of its range: not determined."
    except (AnalysisError, AnalysisRefusedError) as error:
        why = " ".join(str(error).split())
    unit = pictures.unit
    return Fitted(
        unit=unit,
        sigma_t=values.get("sigma_t"),
        sigma_s=values.get("sigma_s"),
        g=values.get("g"),
        depth=depth,
        single=single,
        fit=fit,
        bounce_depth=np.empty(0) if bounces is None else grid.x_mm,
        bounces=np.empty((0, 0)) if bounces is None else bounces,
        multiple=_along(separated.best.multiple),
        plan_std=plan_std,
        why=why,
        taken_s=found.taken_s,
        cpu_s=time.process_time() - begun,
    )


def _pictures(found: StripeSet, setup: Setup) -> Pictures:
    camera, n = setup.camera, found.binned
    gain = camera.gain_dn_per_e or math.nan
    read_noise_dn = gain * (camera.read_noise_e or math.nan)

    def variance(counts: NDArray[np.float32]) -> NDArray[np.float32]:
        light = np.maximum(counts - camera.black_level_dn, 0.0)
        raw = gain * light + read_noise_dn**2 + 1.0 / 12.0
        return np.asarray(raw / (n * found.exposure_s) ** 2, dtype=np.float32)

    net = (found.counts - found.black) / np.float32(found.exposure_s)
    scale = setup.geometry.mm_per_px
    black = (found.black - camera.black_level_dn) / found.exposure_s
    return Pictures(
        stripes=net.astype(np.float32),
        stripes_variance=variance(found.counts),
        white=None,
        white_variance=None,
        black=black.astype(np.float64),
        black_variance=variance(found.black).astype(np.float64),
        leak=None,
        position_px=None,
        captured=found.counts[0].astype(np.float64),
        beam_angle_deg=None,
        pixel=n * (scale or 1.0),
        unit="px" if scale is None else "mm",
        saturated_fraction=float(np.mean(~np.isfinite(net))),
        notes=(),
    )


def _config(setup: Setup, pictures: Pictures) -> Analysis:
    """Return the coarse settings: so few nodes that a set takes a fraction of a second."""
    depth_mm = setup.tank.depth_mm if setup.tank else pictures.stripes.shape[2] * pictures.pixel
    content = {**COARSE, "cell_mm": depth_mm / (NODES - 1)}
    return parse(content, Analysis, source="live analysis")


def _std(variance: float) -> float:
    return math.sqrt(variance) if math.isfinite(variance) and variance > 0.0 else math.nan


def _along(picture: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    finite = np.isfinite(picture)
    count = np.maximum(finite.sum(axis=0), 1)
    return np.asarray(np.where(finite, picture, 0.0).sum(axis=0, dtype=np.float64) / count)
