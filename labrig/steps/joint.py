"""The step that fits one medium to stripes and white light together, as a session allows it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Medium, Phase, Tank
from analysis.spectrum import (
    Bins,
    StripeWave,
    WhiteLight,
    demodulate,
    measured_contrast,
    stripe_wave,
    third_harmonic,
    white_light,
)
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
from labrig.steps.rectify import Pictures, Series

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BIN_TAU = 0.05  # optical depth gathered to one value
MIN_BINS, MAX_BINS = 50, 400
NARROW_TAU = 2.0  # optical width of the narrowest tank
NEAR_TAU = 0.6  # optical depth within which the stripes' contrast is measured
N_WAVES = 3  # of the white light along the face, besides its sum
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Stripes and white light by waves along the face, and what tells the stripes' contrast.

    Attributes
    ----------
    thirds : of each series (rows, n_x), the third harmonic over the shifts; None if unknown
    near_mm : how deep the contrast is measured
    """

    observed: Observed
    series: tuple[Series, ...]
    thirds: tuple[ComplexArray | None, ...]
    bins: Bins
    pixel: float
    near_mm: float

    def contrasts(self, medium: Medium | None = None) -> list[tuple[float | None, float]]:
        """Return c1 of each period and its relative std, corrected for a medium if there is one.

        Without a medium the contrast is up to half a percent wrong; None where it is not known.
        """
        if medium is None:
            return self.contrasts_by(None)
        return self.contrasts_by(lambda q, x_mm: self._answer(medium, q, x_mm))

    def contrasts_by(
        self, answer: Callable[[float, Array], Array] | None
    ) -> list[tuple[float | None, float]]:
        """Return the same, corrected by what any model makes of a wave, A(q, x)."""
        found = []
        for stripe, series, third in zip(
            self.observed.stripes, self.series, self.thirds, strict=True
        ):
            told = stripe
            if third is not None:
                told = measured_contrast(
                    stripe,
                    third,
                    self.pixel,
                    self.bins,
                    duty=series.duty,
                    near_mm=self.near_mm,
                    answer=answer,
                )
            of_white = series.high - series.low
            c1 = None if told.contrast is None else told.contrast * of_white
            found.append((c1, told.contrast_std))
        return found

    def _answer(self, medium: Medium, wavenumber_per_mm: float, x_mm: Array) -> Array:
        o = self.observed
        return stripe_answer(medium, wavenumber_per_mm, x_mm, depth_mm=o.depth_mm, slope=o.slope)


def depth_bins(n_cols: int, pixel_mm: float, sigma_t_per_mm: float) -> Bins:
    """Return columns gathered to depths, as finely as light that decays so is looked at."""
    depth_mm = n_cols * pixel_mm
    width = min(BIN_TAU / sigma_t_per_mm, depth_mm / MIN_BINS)
    return Bins.of(n_cols, pixel_mm, max(width, depth_mm / MAX_BINS))


def observe(pictures: Pictures, setup: Setup, sigma_t_per_mm: float, tank: Tank) -> Seen:
    """Return stripes and white light by waves along the face.

    The white light is the mean over the shifts of every series, which holds more frames than the
    white picture and needs none.

    Raises
    ------
    AnalysisError
        If the shifts are too few, or no stripes are found.
    """
    pixel, cols = pictures.pixel, pictures.stripes.shape[2]
    bins = depth_bins(cols, pixel, sigma_t_per_mm)
    height = pictures.stripes.shape[1] * pixel
    waves = 2.0 * np.pi * np.arange(N_WAVES + 1) / height
    series = (Series.main(pictures, setup), *pictures.more)
    black = pictures.black_variance
    of_black = None if black is None else bins.gather(black[None], black[None])[1]
    gathered = [_gather(one, bins) for one in series]
    white = white_light(*_mean([g.white(of_black) for g in gathered]), pixel, waves)
    return Seen(
        observed=Observed(
            x_mm=bins.x_mm,
            white=white,
            stripes=tuple(g.stripes(pixel, bins, white, n_series=len(series)) for g in gathered),
            depth_mm=tank.depth_mm,
        ),
        series=series,
        thirds=tuple(g.third() for g in gathered),
        bins=bins,
        pixel=pixel,
        near_mm=NEAR_TAU / sigma_t_per_mm,
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Gathered:
    """A series by depths: (n_shifts, rows, n_x), and the variance of one shift, (rows, n_x).

    ``uneven`` is the variance's own wave over the shifts, (rows, n_x): lit pixels are noisier.
    """

    series: Series
    net: Array
    variance: Array
    uneven: ComplexArray

    @property
    def lit(self) -> float:
        """Light of the mean of the shifts, as a share of that of a wholly lit field."""
        series = self.series
        return series.low + (series.high - series.low) * series.duty

    def white(self, black_variance: Array | None) -> tuple[Array, Array]:
        """Return a wholly lit field from the mean of the shifts, and its variance."""
        lit, n = self.lit, self.net.shape[0]
        noise = self.variance / n + (0.0 if black_variance is None else black_variance)
        return self.net.mean(axis=0) / lit, noise / lit**2

    def stripes(self, pixel: float, bins: Bins, white: WhiteLight, *, n_series: int) -> StripeWave:
        """Return the stripes' wave, a known loss of contrast with depth taken out.

        The white light is the mean of ``n_series`` series, of which this is one.
        """
        n = self.net.shape[0]
        shared = self.uneven / (n * self.lit * n_series)
        noise = self.variance * 2.0 / n
        found = stripe_wave(demodulate(self.net), noise, pixel, bins, white, shared)
        if self.series.contrast is None or found.shared is None:
            return found
        c1 = self.series.contrast(bins.x_mm)
        kept = c1[0] / c1
        return replace(
            found,
            amplitude=found.amplitude * kept,
            std=found.std * kept,
            shared=found.shared * kept,
        )

    def third(self) -> ComplexArray | None:
        """Return the third harmonic over the shifts, (rows, n_x), where there is one."""
        return third_harmonic(self.net) if self.series.square else None


def _gather(series: Series, bins: Bins) -> _Gathered:
    net, variance = bins.gather(series.net, series.variance)
    each, _ = bins.gather(series.variance, series.variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        uneven = demodulate(each) * (variance / each.mean(axis=0))
    return _Gathered(series=series, net=net, variance=variance, uneven=uneven)


def _mean(whites: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the mean of equally good fields; black, common to all, is counted too often."""
    value = np.mean([w for w, _ in whites], axis=0)
    return value, np.mean([v for _, v in whites], axis=0) / len(whites)


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
