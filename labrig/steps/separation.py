"""The step that tells single from multiple scattering, by what a session knows of its stripes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.separation import (
    Method,
    Separation,
    as_if_white,
    refuse_few_phases,
    separate_extrema,
    separate_harmonic,
    separate_known,
    square_contrast,
)
from calibration.projector import stripe_light
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup, StripesConfig
from labrig.steps.corrections import Corrections
from labrig.steps.rectify import Pictures

Array = NDArray[np.float64]

FINE_PHASES = 4096  # of one period of the stripes, looked up linearly


@dataclass(frozen=True, slots=True, kw_only=True)
class Separated:
    """Single and multiple scattering by the best estimator the session allows, and by Eqs. 7, 8."""

    best: Separation
    extrema: Separation
    notes: tuple[str, ...]


def separate(
    pictures: Pictures, setup: Setup, config: Analysis, known: Corrections | None = None
) -> Separated:
    """Tell single from multiple scattering (Eqs. 7, 8).

    The pattern is known from a projector record's map, else from a calibrated projection.

    Raises
    ------
    AnalysisError, AnalysisRefusedError
        If the estimator asked for does not suit the pictures.
    """
    stripes = setup.stripes or StripesConfig()
    net, variance = pictures.stripes, pictures.stripes_variance
    mapped = pictures.position_px is not None and known is not None
    told = (mapped or setup.projection is not None) and stripes.profile == "square"
    method = config.separation
    if method == "auto":
        method = "known-pattern" if told else _unknown_phase(net.shape[0], stripes)

    def white(found: Separation) -> Separation:
        if pictures.black_variance is not None:
            # Subtracted from every shift alike, the black picture's noise is all in the mean.
            common = pictures.black_variance / stripes.duty**2
            found = replace(found, multiple_variance=found.multiple_variance + common)
        return as_if_white(found, low=stripes.low, high=stripes.high, duty=stripes.duty)

    extrema = white(separate_extrema(net, variance, stripes.duty))
    if method == "known-pattern":
        if not told:
            msg = "separation known-pattern needs square stripes and a calibrated projection."
            raise AnalysisRefusedError(msg)
        pattern = _mapped(pictures, stripes, known) if mapped else _pattern(setup, pictures)
        best = separate_known(net, variance, pattern, stripes.duty)
        return Separated(best=white(best), extrema=extrema, notes=())
    if method == "harmonic":
        contrast, notes = _contrast(pictures, stripes, known)
        best = separate_harmonic(net, variance, contrast=contrast, duty=stripes.duty)
        return Separated(best=white(best), extrema=extrema, notes=notes)
    note = "Separated by extremes over the shifts: noise and blur are not corrected."
    return Separated(best=extrema, extrema=extrema, notes=(note,))


def _unknown_phase(n_shifts: int, stripes: StripesConfig) -> Method:
    """Return the estimator for stripes of unknown phase; a pattern and its inverse need no four."""
    if n_shifts == 2 and stripes.profile == "square":
        return "extrema"
    refuse_few_phases(n_shifts)
    return "harmonic"


def _contrast(
    pictures: Pictures, stripes: StripesConfig, known: Corrections | None
) -> tuple[float | Array, tuple[str, ...]]:
    """Return c1, of every column if a record knows it, and what must be said of it.

    Raises
    ------
    AnalysisRefusedError
        If the record is about another period or unit.
    """
    measured = known.projected.contrast if known is not None and known.projected else None
    if measured is None:
        sharp = 0.5 if stripes.profile == "sinusoid" else square_contrast(stripes.duty)
        note = "The stripes' contrast was not calibrated: blur makes single scattering too small."
        return sharp, (note,)
    if measured.unit != pictures.unit or measured.period_px != stripes.period_px:
        msg = (
            f"c1 was measured for stripes of {measured.period_px:g} px in {measured.unit}, the "
            f"session has {stripes.period_px:g} px in {pictures.unit}; measure it for these."
        )
        raise AnalysisRefusedError(msg)
    depth = np.arange(pictures.stripes.shape[2], dtype=np.float64)
    return measured.at((depth + 0.5) * pictures.pixel), ()


def _mapped(
    pictures: Pictures, stripes: StripesConfig, known: Corrections | None
) -> NDArray[np.float32]:
    """Return the light of each stripe picture by the projector's map, (n, rows, cols).

    One period is computed finely and looked up.
    """
    projected = known.projected if known is not None else None
    if projected is None or pictures.position_px is None:
        msg = "the pattern is known only with a projector record."
        raise AnalysisRefusedError(msg)
    n = pictures.stripes.shape[0]
    transfer = projected.transfer.get(stripes.axis)
    fine = np.linspace(0.0, stripes.period_px, FINE_PHASES + 1, dtype=np.float64)
    light = stripe_light(
        fine,
        period_px=stripes.period_px,
        duty=stripes.duty,
        n_shifts=n,
        transfer=None if transfer is None else transfer.at,
    )
    where = np.mod(pictures.position_px - stripes.offset_px, stripes.period_px)
    return np.stack([np.interp(where, fine, line) for line in light]).astype(np.float32)


def _pattern(setup: Setup, pictures: Pictures) -> Array:
    """Return the light of each stripe picture where it falls in the tank, (n, rows, 1 or cols)."""
    projection, stripes = setup.projection, setup.stripes or StripesConfig()
    if projection is None:
        msg = "the pattern is known only where the projection is calibrated."
        raise AnalysisRefusedError(msg)
    n_shifts, rows, cols = pictures.stripes.shape
    slope = math.tan(math.radians(setup.beam.angle_deg)) if setup.beam else 0.0
    y = (np.arange(rows) + 0.5) * pictures.pixel
    x = (np.arange(cols) + 0.5) * pictures.pixel if slope else np.zeros(1)
    entry = y[:, None] - x[None, :] * slope
    return stripe_light(
        (entry - projection.origin_mm) / projection.mm_per_px,
        period_px=stripes.period_px,
        duty=stripes.duty,
        n_shifts=n_shifts,
        blur_px=projection.blur_px,
        pixel_px=pictures.pixel / projection.mm_per_px,
    )
