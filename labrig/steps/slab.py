"""The step that fits the medium of a layer of known height to stripes and white light together."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.medium import Medium, Slab
from analysis.separation import square_contrast
from analysis.slab_fit import SlabFit, fit_slab
from analysis.slab_profiles import SlabProfiles, summed
from analysis.slab_search import Contrasts
from analysis.slab_table import STRIPED_ORDERS, camera_orders
from analysis.stripe_problem import FACE_ERROR, MODEL_ERROR, Observed, Problem
from analysis.transport.slab_resolution import depths, directions
from calibration.errors import CalibrationError
from labrig.models.analysis import Analysis
from labrig.models.setup import WATER, Setup
from labrig.steps.decay import Decay
from labrig.steps.joint import Joint
from labrig.steps.rectify import Pictures
from labrig.steps.slab_tables import fit_by_kept, keep_table
from labrig.steps.waves import Seen, observe

Array = NDArray[np.float64]

OF_CONTRAST = 0.6  # fineness of what the stripes' contrast is corrected by
UNKNOWN_HEIGHT = 0.05  # of the height: what a mistake of this size does is told
OFF_PLANE = 10.0  # chi^2 per degree of freedom of the plane's fit from which a layer is tried
TRIED_HEIGHT = 1.0  # mean free paths
FAR_BETTER = 2.0  # ratio of misfits at which light is said to be a layer's
LEAST_GAP = 3.0  # mean free paths between beam and side walls: 0.1 % of the light is lost there
OFF_MODEL = 4.0  # chi^2 per degree of freedom at which the model does not hold


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """What stripes and white light say of a layer.

    Attributes
    ----------
    fit, observed : None where no such fit exists; the notes say why
    harmonics, white : (n_periods, n_x) and (n_x,), the fit's light in the units of what was
        observed; NaN where it was not fitted
    contrast : (n_periods,), c1 of the stripes
    height_std_mm, index_std : how well height and index are known; None where nobody said
    """

    slab: Slab | None
    fit: SlabFit | None
    observed: Observed | None
    harmonics: Array
    white: Array
    contrast: Array
    notes: tuple[str, ...]
    height_std_mm: float | None = None
    index_std: float | None = None

    @classmethod
    def without_fit(cls, slab: Slab | None, note: str) -> Layer:
        """Return a layer that there is only something to say of."""
        none = np.empty(0)
        return cls(
            slab=slab,
            fit=None,
            observed=None,
            harmonics=none,
            white=none,
            contrast=none,
            notes=(note,),
        )

    def walls_std(self) -> Array | None:
        """Return what is not known of height and index makes of the answer, (3,).

        None where nobody said how well either is known.
        """
        if self.fit is None or (self.height_std_mm is None and self.index_std is None):
            return None
        by_height = self.fit.by_height * (self.height_std_mm or 0.0)
        return np.hypot(by_height, self.fit.by_index * (self.index_std or 0.0))

    @property
    def medium(self) -> Medium | None:
        """The medium found; Eq. 2 on the sphere."""
        if self.fit is None:
            return None
        return Medium(
            sigma_t_per_mm=self.fit.sigma_t_per_mm,
            sigma_s_per_mm=min(self.fit.sigma_s_per_mm, self.fit.sigma_t_per_mm),
            g=self.fit.g,
        )


def fit_layer(
    pictures: Pictures, setup: Setup, config: Analysis, decay: Decay, joint: Joint | None
) -> Layer | None:
    """Fit sigma_t, sigma_s and g of a layer, if the height of the liquid is known.

    Where it is not, and a plane does not explain the light, a layer of some height is tried, and
    said to be one if it does; None if nothing is to be said. ``joint`` is the plane's fit, None
    where nobody made it.
    """
    slab = None if setup.tank is None else setup.tank.slab()
    guess = decay.attenuation.sigma_t_per_mm
    if slab is None:
        note = _looks_like_layer(pictures, setup, decay, joint)
        return Layer.without_fit(None, note) if note else None
    try:
        seen = observe(pictures, setup, guess, decay.tank)
        profiles, sharp = profiles_of(seen, pictures.pixel, guess)
        fit, of_table = _fit(profiles, slab, _contrasts(seen, slab, sharp), config)
    except (AnalysisError, CalibrationError) as error:
        note = f"No fit of a layer ({error}) The values are effective parameters of a plane."
        return Layer.without_fit(slab, note)
    used = np.isfinite(profiles.stacked()[1])
    model = np.where(used, fit.model, np.nan)
    return Layer(
        slab=slab,
        fit=fit,
        observed=seen.observed,
        harmonics=model[:-1] * sharp[:, None],
        white=model[-1],
        contrast=sharp * fit.scales[:-1] / fit.scales[-1],
        notes=(*of_table, *_doubts(fit, slab), *_near_walls(decay, fit)),
        height_std_mm=setup.tank.height_std_mm if setup.tank else None,
        index_std=setup.tank.index_std if setup.tank else None,
    )


def _fit(
    profiles: SlabProfiles, slab: Slab, contrasts: Contrasts, config: Analysis
) -> tuple[SlabFit, tuple[str, ...]]:
    """Fit by a kept table if there is one, else by solutions; return also what is said of it."""
    if config.slab_table == "kept":
        looked = fit_by_kept(profiles, slab, contrasts)
        if looked is not None:
            note = f"Looked up in a kept table, known to {100.0 * looked.error:.1g} % of the light."
            return looked.fit, (note,)
    fit = fit_slab(profiles, slab, contrasts=contrasts, unknown_walls=True)
    if config.slab_table == "kept" and not fit.at_limit:
        keep_table(profiles, slab, fit)
    return fit, ()


def profiles_of(seen: Seen, pixel_mm: float, sigma_t_per_mm: float) -> tuple[SlabProfiles, Array]:
    """Return what is fitted, and the contrasts (n_periods,) that its harmonics are divided by.

    Depths are those at which the plane model is fitted too.
    """
    observed, contrasts = seen.observed, seen.contrasts()
    depths_of = Problem(observed, "hg-plane", sigma_t_per_mm)
    known = [c1 is not None for c1, _ in contrasts]
    sharp = np.array([square_contrast(0.5) if c1 is None else c1 for c1, _ in contrasts])
    amplitude = np.array([s.amplitude for s in observed.stripes]) / sharp[:, None]
    variance = (np.array([s.std for s in observed.stripes]) / sharp[:, None]) ** 2
    lit = observed.white.moment[0].real
    return SlabProfiles(
        depth_mm=observed.x_mm,
        bin_mm=float(np.diff(seen.bins.first).mean()) * pixel_mm,
        wavenumbers_per_mm=np.array([abs(s.wavenumber_per_mm) for s in observed.stripes]),
        harmonics=np.where(np.array(depths_of.striped), amplitude, np.nan),
        variance=variance,
        white=np.where(depths_of.lit, lit, np.nan),
        white_variance=observed.white.covariance[:, 0, 0],
        contrast_std=np.array(
            [std if told else math.inf for told, (_, std) in zip(known, contrasts, strict=True)]
        ),
        shared=_shared(observed) / sharp[:, None],
        model_error=MODEL_ERROR,
        face_error=FACE_ERROR,
    ), sharp


def _shared(observed: Observed) -> Array:
    none = np.zeros(observed.x_mm.size)
    return np.array([none if s.shared is None else s.shared for s in observed.stripes])


def _looks_like_layer(
    pictures: Pictures, setup: Setup, decay: Decay, joint: Joint | None
) -> str | None:
    """Return a warning where a layer explains the light far better than the plane does.

    The projector's leak, where no black picture takes it away, is enough to miss a plane.
    """
    if (
        joint is None
        or joint.fit is None
        or joint.fit.chi2_per_dof < OFF_PLANE
        or pictures.black_variance is None
    ):
        return None
    guess = decay.attenuation.sigma_t_per_mm
    height_mm = TRIED_HEIGHT / guess
    tried = Slab(depth_mm=decay.tank.depth_mm, height_mm=height_mm, surface_index=WATER)
    try:
        seen = observe(pictures, setup, guess, decay.tank)
        profiles, sharp = profiles_of(seen, pictures.pixel, guess)
        fit = fit_slab(profiles, tried, contrasts=_contrasts(seen, tried, sharp))
    except (AnalysisError, CalibrationError):
        return None
    times = math.sqrt(joint.fit.chi2_per_dof / fit.chi2_per_dof)
    if times < FAR_BETTER:
        return None
    return (
        f"This looks like light of a thin layer, not of a plane: one of {height_mm:.2g} "
        f"{pictures.unit} misses it {times:.1f} times less. The values are effective parameters "
        "of a plane, whose sigma_s and g are far off: give tank.height_mm."
    )


def _contrasts(seen: Seen, slab: Slab, sharp: Array) -> Contrasts:
    """Return what the stripes' third harmonic says of their contrast, once a medium is known."""

    def found(sigma_t: float, sigma_s: float, g: float) -> tuple[Array, Array]:
        told = seen.contrasts_by(answer_of(sigma_t, sigma_s, g, slab))
        ratio = np.array([1.0 if c1 is None else c1 for c1, _ in told]) / sharp
        std = np.array([math.inf if c1 is None else std for c1, std in told])
        return np.where(np.isinf(std), 1.0, ratio), std

    return found


def answer_of(
    sigma_t: float, sigma_s: float, g: float, slab: Slab
) -> Callable[[float, Array], Array]:
    """Return what a layer makes of a wave near its face, A(q, x)."""

    def answer(wavenumber_per_mm: float, x_mm: Array) -> Array:
        deep = min(slab.depth_mm, float(x_mm.max()) + 3.0 * slab.height_mm)
        near = replace(slab, depth_mm=deep)
        at = depths(sigma_t, near, fineness=OF_CONTRAST)
        grid = directions(g, near, at, wavenumber_per_mm=wavenumber_per_mm, fineness=OF_CONTRAST)
        orders = camera_orders(sigma_t, g, near, grid, wavenumber_per_mm, STRIPED_ORDERS)
        light = CubicSpline(at, summed(orders, sigma_s / sigma_t))(x_mm)
        return np.asarray(light * np.exp(-sigma_t * x_mm))

    return answer


def _near_walls(decay: Decay, fit: SlabFit) -> list[str]:
    """Return what is to be said of side walls, which the layer's model knows nothing of."""
    gap_mm = min(decay.beam.from_mm, decay.tank.width_mm - decay.beam.to_mm)
    gap = gap_mm * fit.sigma_t_per_mm
    if gap >= LEAST_GAP:
        return []
    return [
        f"The beam ends {gap_mm:.3g} mm from a side wall, {gap:.2g} mean free paths: below "
        f"{LEAST_GAP:g} the wall takes percents of the deep light, which the layer's model takes "
        "for another medium. Narrow the beam, or use a wider tank."
    ]


def _doubts(fit: SlabFit, slab: Slab) -> list[str]:
    share = UNKNOWN_HEIGHT * slab.height_mm * fit.by_height[1] / fit.sigma_s_per_mm
    of_index = 0.01 * fit.by_index[1] / fit.sigma_s_per_mm
    notes = [
        f"The layer is taken to be {slab.height_mm:g} mm high with a surface of index "
        f"{slab.surface_index:g}. A height {100.0 * UNKNOWN_HEIGHT:.0f} % too large makes sigma_s "
        f"{100.0 * share:+.1f} %, an index 0.01 too large {100.0 * of_index:+.2f} %, and no misfit "
        "shows either: measure them."
    ]
    if fit.at_limit:
        notes.append(
            "The fit of the layer ended at a limit or did not settle: its values mean little."
        )
    if fit.chi2_per_dof > OFF_MODEL:
        notes.append(
            f"Stripes and white light miss the layer's model by {math.sqrt(fit.chi2_per_dof):.1f} "
            "times its own error and the noise: something else than a homogeneous layer over a "
            "black floor is seen."
        )
    return notes
