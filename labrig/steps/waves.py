"""The step that tells stripes and white light by waves along the face, as they are fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.medium import Medium, Tank
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
    stripe_answer,
)
from analysis.stripe_problem import Observed
from labrig.models.setup import Setup
from labrig.steps.rectify import Pictures, Series

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BIN_TAU = 0.05  # optical depth gathered to one value
MIN_BINS, MAX_BINS = 50, 400
NEAR_TAU = 0.6  # optical depth within which the stripes' contrast is measured
N_WAVES = 3  # of the white light along the face, besides its sum


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
        n, kept = self.net.shape[0], np.ones(bins.x_mm.size)
        if self.series.contrast is not None:
            c1 = self.series.contrast(bins.x_mm)
            kept = c1[0] / c1
        shared = self.uneven * kept / (n * self.lit * n_series)
        noise = self.variance * 2.0 / n
        found = stripe_wave(demodulate(self.net), noise, pixel, bins, white, shared)
        return replace(found, amplitude=found.amplitude * kept, std=found.std * kept)

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
