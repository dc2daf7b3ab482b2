"""The step that fits one medium to stripes and white light together, as a session allows it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Medium, Phase, Tank
from analysis.stripe_aware import (
    SideWalls,
    StripeAware,
    fit_stripe_aware,
    stripe_answer,
)
from analysis.stripe_problem import WHITE_TAU, Observed
from analysis.transport.side_walls import side_wall_loss
from calibration.errors import CalibrationError
from labrig.models.analysis import Analysis
from labrig.models.setup import Setup
from labrig.steps.decay import Decay
from labrig.steps.rectify import Pictures
from labrig.steps.waves import Seen, observe

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

NARROW_TAU = 2.0  # optical width of the narrowest tank
OFF_PERIOD = 0.02  # the stripes' measured period against the one that was set
OFF_SLANT_DEG = 1.0
OFF_MODEL = 4.0  # chi^2 per degree of freedom at which the model does not hold
G_UNKNOWN, G_ASSUMED = 0.4, 0.0  # std of g from which on it is not known; what is assumed then
ILL = 1000.0  # condition number above which the data do not tell the parameters apart


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """What stripes and white light together say.

    Attributes
    ----------
    observed, fit : None where no such fit exists; the notes say why
    g_unknown : the data do not tell g; the fit is that of ``G_ASSUMED``
    other_phase : the medium by the other phase function, likewise fitted
    share : (n_periods, n_x), part of the stripes' light that was scattered once; NaN outside
    """

    observed: Observed | None
    fit: StripeAware | None
    other_phase: StripeAware | None
    share: Array | None
    notes: tuple[str, ...]
    g_unknown: bool = False

    @property
    def medium(self) -> Medium | None:
        """The medium found."""
        return None if self.fit is None else self.fit.medium


def fit_joint(pictures: Pictures, setup: Setup, config: Analysis, decay: Decay) -> Joint:
    """Fit sigma_t, sigma_s and g to the stripes of every period and the white light."""
    guess = decay.attenuation.sigma_t_per_mm
    try:
        refuse_near_walls(decay.tank, guess)
        seen = observe(pictures, setup, guess, decay.tank)
        walls = walls_of(decay, seen.observed)
        observed, fit = seen.observed, fit_seen(seen, guess, config.phase, walls)
        g_unknown = std_of_g(fit) > G_UNKNOWN
        if g_unknown:
            fit = fit_seen(seen, guess, config.phase, walls, g=G_ASSUMED)
    except (AnalysisError, CalibrationError) as error:
        note = (
            f"No fit of stripes and white light together ({error}) The values are those of Eqs. 9 "
            "and 10, which take the separated light for free of low orders of multiple scattering."
        )
        return Joint(observed=None, fit=None, other_phase=None, share=None, notes=(note,))
    share = np.full(fit.stripe_fit.shape, np.nan)
    slope, sigma_t = observed.slope, fit.medium.sigma_t_per_mm
    for row, model, stripe in zip(share, fit.stripe_fit, observed.stripes, strict=True):
        use = np.isfinite(model)
        x_mm, q = observed.x_mm[use], stripe.wavenumber_per_mm
        every = stripe_answer(fit.medium, q, x_mm, depth_mm=observed.depth_mm, slope=slope)
        row[use] = np.exp(-sigma_t * x_mm * math.hypot(1.0, slope)) / every
    return Joint(
        observed=observed,
        fit=fit,
        other_phase=None if g_unknown else _other(observed, fit, guess),
        share=share,
        notes=tuple(_doubts(fit, observed, setup, pictures.unit, g_unknown=g_unknown)),
        g_unknown=g_unknown,
    )


def fit_seen(
    seen: Seen,
    guess_per_mm: float,
    phase: Phase,
    walls: SideWalls,
    g: float | None = None,
    *,
    profile: bool = True,
) -> StripeAware:
    """Fit once with a guess of the stripes' contrast, then with what the medium makes of it.

    Parameters
    ----------
    g : held there; else it is fitted
    profile : whether a g that is fitted gets its profile likelihood

    Raises
    ------
    AnalysisError
        As `fit_stripe_aware` does.
    """
    guessed = tuple(
        replace(stripe, contrast=c1, contrast_std=std)
        for stripe, (c1, std) in zip(seen.observed.stripes, seen.contrasts(), strict=True)
    )
    return fit_stripe_aware(
        replace(seen.observed, stripes=guessed),
        sigma_t_per_mm=guess_per_mm,
        phase=phase,
        side_walls=walls,
        contrasts=seen.contrasts,
        g=g,
        profile=profile and g is None,
    )


def refuse_near_walls(tank: Tank, sigma_t_per_mm: float) -> None:
    """Refuse a tank narrower than light's free path: waves of no end are no picture of it.

    Raises
    ------
    AnalysisError
        If it is.
    """
    across = tank.width_mm * sigma_t_per_mm
    if across < NARROW_TAU:
        msg = (
            f"the tank is {across:.2g} mean free paths wide, its side walls take away most of the "
            "multiple scattering; use a denser sample."
        )
        raise AnalysisError(msg)


def walls_of(decay: Decay, observed: Observed) -> SideWalls:
    """Return what gives the side walls' change of the white waves of any medium."""
    tank, beam = decay.tank, decay.beam
    y, light = beam.profile_points()
    across = float(np.sum(0.5 * (light[1:] + light[:-1]) * np.diff(y)))
    slanted = replace(beam, angle_deg=math.degrees(math.atan(observed.slope)))

    def loss(medium: Medium) -> ComplexArray:
        found = side_wall_loss(
            medium,
            tank,
            slanted,
            wavenumber_per_mm=observed.white.wavenumber_per_mm,
            origin_mm=observed.white.origin_mm,
            x_mm=observed.x_mm,
            deepest_mm=WHITE_TAU / decay.attenuation.sigma_t_per_mm,
        )
        turn = np.outer(observed.white.wavenumber_per_mm, observed.x_mm) * observed.slope
        return np.asarray(found * np.exp(1j * turn) / across)

    return loss


def _other(observed: Observed, fit: StripeAware, guess_per_mm: float) -> StripeAware | None:
    """Fit the phase function that was not asked for; None where no such medium explains it."""
    phase: Phase = "hg-paper" if fit.medium.phase == "hg-plane" else "hg-plane"
    try:
        return fit_stripe_aware(observed, sigma_t_per_mm=guess_per_mm, phase=phase, near=fit)
    except AnalysisError:
        return None


def std_of_g(fit: StripeAware) -> float:
    """Return the standard deviation of g, by the camera's noise and the model's error."""
    return math.sqrt(float(fit.covariance[2, 2] + fit.model_covariance[2, 2]))


def _doubts(
    fit: StripeAware, observed: Observed, setup: Setup, unit: str, *, g_unknown: bool
) -> list[str]:
    notes = []
    if g_unknown:
        std = math.sqrt(float(fit.covariance[1, 1] + fit.model_covariance[1, 1]))
        most = max(fit.medium.sigma_s_per_mm, 0.0) + 2.0 * std
        notes.append(
            "g cannot be determined: too little light is scattered more than once. sigma_s is "
            f"that of g = {G_ASSUMED:g}, and below {most:.2g} per {unit}."
        )
    elif fit.at_limit:
        notes.append(
            "The fit of stripes and white light stopped at the end of what is possible: sigma_s "
            "and g are not determined."
        )
    known = np.isfinite(observed.white.moment[0])
    lost_mm = float(observed.x_mm[np.argmax(known)] - observed.x_mm[0])
    if lost_mm > 0.0:
        notes.append(
            f"The first {lost_mm:.3g} {unit} are saturated in every exposure and left out; without "
            "them the contrast of the stripes is not known. Take a shorter exposure too."
        )
    if fit.condition > ILL:
        notes.append("The data hardly tell sigma_s from g: see their correlation.")
    if fit.chi2_per_dof > OFF_MODEL:
        times = math.sqrt(fit.chi2_per_dof)
        notes.append(
            f"Stripes and white light miss their model by {times:.1f} times its own error and the "
            "noise: something else than a homogeneous medium between black walls is seen."
        )
    if setup.projection is not None and setup.stripes is not None:
        wanted = setup.stripes.period_px * setup.projection.mm_per_px
        period = 2.0 * math.pi / abs(observed.stripes[0].wavenumber_per_mm)
        if abs(period / wanted - 1.0) > OFF_PERIOD:
            notes.append(
                f"The stripes' period in the picture is {period:.4g} {unit}, the calibration says "
                f"{wanted:.4g}: check geometry.mm_per_px and projection.mm_per_px."
            )
    slant = math.degrees(math.atan(observed.slope))
    if setup.beam is not None and abs(slant - setup.beam.angle_deg) > OFF_SLANT_DEG:
        notes.append(
            f"The stripes run at {slant:.1f} degrees through the medium, {setup.beam.angle_deg:g} "
            "are set: the measured slant was used."
        )
    return notes
