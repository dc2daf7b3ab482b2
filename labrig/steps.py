"""The steps of an analysis: each takes what the one before returned, and knows the session's setup.

The equations are in `analysis`; here stands what a session allows, and what must be said of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.attenuation import Attenuation, fit_attenuation
from analysis.bounces import BounceTable, tabulate
from analysis.errors import AnalysisError
from analysis.inversion import Inversion, invert
from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import UNRESOLVED
from analysis.profile import WHOLE, DepthProfile, depth_profile, measure_beam
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
from analysis.transport.ordinates import solve_on
from calibration.projector import stripe_light
from labrig.corrections import Corrections
from labrig.errors import AnalysisRefusedError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup, StripesConfig
from labrig.rectify import Pictures

Array = NDArray[np.float64]
Picture = NDArray[np.floating[Any]]

EXCESS_CHI2 = 4.0  # residuals twice the noise
ROWS_DISAGREE = 2.0  # ratio of two standard deviations of one thing
POOR_FIT = 0.1  # rms of the residual of Eq. 10 over rms of the picture
MARGIN, WIDEST_MARGIN = 0.05, 0.35  # of the beam's width, left out at each of its edges
UNRESOLVED_PX = 3.0  # a mean free path below it is not resolved
FINE_PHASES = 4096  # of one period of the stripes, looked up linearly
MAX_RADIANCES = 60_000_000  # nodes x angles: half a gigabyte an array


@dataclass(frozen=True, slots=True, kw_only=True)
class Separated:
    """Single and multiple scattering by the best estimator the session allows, and by Eqs. 7, 8."""

    best: Separation
    extrema: Separation
    notes: tuple[str, ...]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """The bounces of the medium found.

    ``inversion`` is the medium that the paper's way finds (Eqs. 9, 10), ``bounces`` are of the
    one taken for the truth. ``layer_fluence`` is (K, n_y, n_x), the mean over the height of a
    layer's light, which its camera sees only a part of; None in a plane.
    """

    inversion: Inversion
    multiple: Array
    grid: Grid
    bounces: BounceField
    notes: tuple[str, ...]
    layer_fluence: Array | None = None


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


def render_bounces(decay: Decay, pictures: Pictures, config: Analysis) -> BounceTable:
    """Render every bounce for a range of g: L_1 analytic, L_2 closed, then recursively (Eq. 4).

    Raises
    ------
    AnalysisRefusedError
        If the grid would not fit in memory.
    AnalysisError
        If the angles cannot resolve the range of g.
    """
    cell = config.cell_mm if pictures.unit == "mm" else decay.tank.depth_mm / 100.0
    grid = Grid.covering(decay.tank, cell_mm=cell, n_theta=config.n_theta)
    if grid.n_x * grid.n_y * grid.n_theta > MAX_RADIANCES:
        msg = (
            f"a grid of {grid.n_y} x {grid.n_x} nodes and {grid.n_theta} angles holds more than "
            f"{MAX_RADIANCES / 1e6:.0f} million radiances; choose a larger cell_mm."
        )
        raise AnalysisRefusedError(msg)
    return tabulate(
        decay.attenuation.sigma_t_per_mm,
        decay.beam,
        grid,
        phase=config.phase,
        n_bounces=config.n_bounces,
        g_range=config.g_range,
        n_g=config.n_g,
    )


def explain(
    separated: Separated,
    decay: Decay,
    table: BounceTable,
    pictures: Pictures,
    known: Medium | None = None,
) -> Explained:
    """Find sigma_s and g whose bounces explain the multiple scattering (Eqs. 10, 11).

    The bounces returned are those of the medium ``known`` better, if there is one.

    Raises
    ------
    AnalysisError
        If there is no multiple scattering to explain.
    """
    grid = table.grid
    multiple, count = grid.average(separated.best.multiple, pictures.pixel)
    variance, _ = grid.average(separated.best.multiple_variance, pictures.pixel)
    valid, _ = grid.average(np.isfinite(separated.best.multiple).astype(float), pictures.pixel)
    multiple = np.where(valid >= WHOLE, multiple, np.nan)
    found = invert(multiple, variance / np.maximum(count, 1.0), decay.attenuation, table)
    medium = Medium(
        sigma_t_per_mm=decay.attenuation.sigma_t_per_mm,
        sigma_s_per_mm=found.sigma_s_per_mm,
        g=found.g,
        phase=table.phase,
    )
    n_bounces = table.fluence.shape[1]
    notes = []
    if found.at_limit:
        notes.append(
            "The fit of sigma_s and g stopped at the end of its range: they are not determined."
        )
    if found.rms_relative > POOR_FIT:
        notes.append(
            f"The bounces leave {100 * found.rms_relative:.0f} % (rms) of the multiple scattering "
            "unexplained: the model of Eq. 10 does not fit, and its sigma_s and g mean little."
        )
    if found.last_bounce_share > 0.01:
        notes.append(
            f"Bounce {n_bounces} still holds {100 * found.last_bounce_share:.1f} % of the "
            "multiple scattering: raise n_bounces."
        )
    return Explained(
        inversion=found,
        multiple=multiple,
        grid=grid,
        bounces=solve_on(
            known or medium,
            decay.beam,
            _resolving(grid, known),
            n_bounces=n_bounces,
            dtype=np.float32,  # as they are written
        ),
        notes=tuple(notes) if known is None else (),
    )


def _resolving(grid: Grid, medium: Medium | None) -> Grid:
    """Return the grid with directions enough for a medium."""
    n_theta = grid.n_theta
    while medium is not None and abs(medium.g) ** (n_theta // 2) > UNRESOLVED:
        n_theta += 32
    return replace(grid, n_theta=n_theta)


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


def _period(setup: Setup) -> float:
    """Return the stripes' period in the tank, mm; zero where it is unknown."""
    if setup.projection is None or setup.stripes is None:
        return 0.0
    return setup.stripes.period_px * setup.projection.mm_per_px


def _if_any(fit: Callable[[], Attenuation]) -> Attenuation | None:
    """Return a fit that only stands beside the main one; None where there is none."""
    try:
        return fit()
    except AnalysisError:
        return None
