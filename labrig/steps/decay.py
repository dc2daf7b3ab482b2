"""The step that fits the decay of single scattering, and says what must be said of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.attenuation import Attenuation, fit_attenuation
from analysis.errors import AnalysisError
from analysis.medium import Beam, Tank
from analysis.profile import DepthProfile, depth_profile, measure_beam
from analysis.separation import (
    Separation,
)
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.steps.rectify import Pictures
from labrig.steps.separation import Separated

Picture = NDArray[np.floating[Any]]

EXCESS_CHI2 = 4.0  # residuals twice the noise
ROWS_DISAGREE = 2.0  # ratio of two standard deviations of one thing
MARGIN, WIDEST_MARGIN = 0.05, 0.35  # of the beam's width, left out at each of its edges
UNRESOLVED_PX = 3.0  # a mean free path below it is not resolved


@dataclass(frozen=True, slots=True, kw_only=True)
class Decay:
    """Light along the beam, and the fits of Eq. 9; None where the data hold no such fit.

    ``attenuation`` is of the single scattering, ``by_extrema`` of Eq. 7's, ``unseparated`` of the
    white light.
    """

    tank: Tank
    beam: Beam
    single: DepthProfile
    white: DepthProfile | None
    attenuation: Attenuation
    by_extrema: Attenuation | None
    unseparated: Attenuation | None
    notes: tuple[str, ...]


def attenuate(separated: Separated, pictures: Pictures, setup: Setup, config: Analysis) -> Decay:
    """Fit the decay of single scattering, and of the light without separation (Eq. 9, Fig. 11).

    Raises
    ------
    AnalysisError
        If single scattering gives no signal, or does not decay.
    """
    rows, cols = separated.best.single.shape
    tank = Tank(depth_mm=cols * pictures.pixel, width_mm=rows * pictures.pixel)
    if setup.tank:
        tank = setup.tank.record()
    beam, notes = _beam(pictures, setup)
    beam = beam.entering(tank)
    period, across = _period(setup), beam.to_mm - beam.from_mm
    margin = min(max(period, MARGIN * across), WIDEST_MARGIN * across)
    if period > WIDEST_MARGIN * across:
        notes = (*notes, _too_coarse(period, across, pictures.unit))

    def profile(
        picture: Picture, variance: Picture, detected: NDArray[np.bool_] | None = None
    ) -> DepthProfile:
        return depth_profile(
            picture, variance, pictures.pixel, beam, margin_mm=margin, detected=detected
        )

    def of_single(found: Separation) -> DepthProfile:
        # Only least squares with a known pattern is signed, and so unbiased below the noise.
        signed = found.method == "known-pattern"
        return profile(
            found.single, found.single_variance, detected=None if signed else found.detected
        )

    def fit(of: DepthProfile) -> Attenuation:
        return fit_attenuation(of, config.depth_range_mm)

    single = of_single(separated.best)
    extrema = of_single(separated.extrema)
    white = None
    if pictures.white is not None and pictures.white_variance is not None:
        white = profile(pictures.white, pictures.white_variance)
    attenuation = fit(single)
    free_path = 1.0 / attenuation.sigma_t_per_mm
    if free_path < UNRESOLVED_PX * pictures.pixel:
        msg = (
            f"light falls to 1/e within {free_path / pictures.pixel:.1f} pixels: sigma_t cannot be "
            f"resolved, it is about {attenuation.sigma_t_per_mm:.2g} per {pictures.unit} or more; "
            "dilute the sample, or look from nearer."
        )
        raise AnalysisError(msg)
    return Decay(
        tank=tank,
        beam=beam,
        single=single,
        white=white,
        attenuation=attenuation,
        by_extrema=_if_any(lambda: fit(extrema)),
        unseparated=None if white is None else _if_any(lambda: fit(white)),
        notes=(*notes, *_doubts(attenuation)),
    )


def _beam(pictures: Pictures, setup: Setup) -> tuple[Beam, tuple[str, ...]]:
    if setup.beam:
        return setup.beam.record(), ()
    lit = pictures.white
    if lit is None:
        lit = pictures.stripes.mean(axis=0).astype(np.float64)
    beam = measure_beam(lit, pictures.pixel)
    angle = pictures.beam_angle_deg
    direction = "taken to enter straight (0 degrees)"
    if angle is not None:
        beam = replace(beam, angle_deg=angle)
        direction = f"at {angle:.2f} degrees by the geometry record"
    note = (
        f"The beam was measured from the picture: {beam.from_mm:.4g} to {beam.to_mm:.4g} "
        f"{pictures.unit}, {direction}."
    )
    return beam, (note,)


def _period(setup: Setup) -> float:
    """Return the stripes' period in the tank, mm; zero where it is unknown."""
    if setup.projection is None or setup.stripes is None:
        return 0.0
    return setup.stripes.period_px * setup.projection.mm_per_px


def _too_coarse(period: float, across: float, unit: str) -> str:
    return (
        f"The stripes' period of {period:.3g} {unit} is too coarse for a beam {across:.3g} {unit} "
        "wide: at its edges single scattering is not separated. Show finer stripes."
    )


def _doubts(fit: Attenuation) -> tuple[str, ...]:
    """Return what makes the stated deviations of Eq. 9 wrong."""
    notes = []
    if fit.chi2_per_dof > EXCESS_CHI2:
        times = math.sqrt(fit.chi2_per_dof)
        notes.append(
            f"The residuals of Eq. 9 are {times:.1f} times the noise: something else than camera "
            "noise bends the decay, and the std of sigma_t and c is too small."
        )
    by_rows, stated = fit.row_std[1], math.sqrt(fit.covariance[1, 1])
    if by_rows > ROWS_DISAGREE * stated or stated > ROWS_DISAGREE * by_rows:
        notes.append(
            f"The std of Eq. 9's sigma_t is {stated:.2g} by the camera's noise and {by_rows:.2g} "
            "by the scatter of the rows: rows differ by more, or by less, than by noise."
        )
    return tuple(notes)


def _if_any(fit: Callable[[], Attenuation]) -> Attenuation | None:
    """Return a fit that only stands beside the main one; None where there is none."""
    try:
        return fit()
    except AnalysisError:
        return None
