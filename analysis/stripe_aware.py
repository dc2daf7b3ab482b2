"""Extinction, scattering and asymmetry from stripes and white light together.

Light scattered forward keeps the stripes, so that "single" scattering separated by them still
holds low orders, and Eq. 9 reads a sigma_t that is too small (a third at g = 0.9). Here nothing
is separated: the amplitude of the stripes and the waves of the white light along the face are
each ``C w^(q) A(x; q; sigma_t, sigma_s, g)`` with A the sum of all bounces, and the medium is
fitted to all of them at once. C, the profile's waves w^(q_j) and the stripes' contrast are fitted
too, the last two near what the pictures tell of them: no absolute light and no shape of the beam
is assumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from analysis.errors import AnalysisError
from analysis.medium import Medium, Phase
from analysis.spectrum import StripeWave, WhiteLight, in_phase
from analysis.transport.eigenmodes import plane_light

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MODEL_ERROR = 1e-3  # of the light at a depth: what plane waves and side walls leave unexplained
FACE_ERROR = 1e-4  # and of the light at the face
WHITE_SHARE = 0.01  # of the brightest: darker white light is not fitted
STRIPE_SNR = 5.0  # where the stripes sink below it they are not fitted further
FACE_TAU = (
    0.04  # optical depth from which on light is fitted: blur mixes in what is before the face
)
WHITE_TAU = 4.5  # and to which the white light is: deeper, it is other walls' and strays' light
STRIPE_TAU = 6.0  # the same of the stripes
PROFILE_ERROR = 1e-3  # of the waves of the illumination
UNKNOWN = 1e3  # of the logarithm of a contrast that was not measured
FEWEST_DEPTHS = 8
ALBEDOS, ASYMMETRIES = (0.4, 0.85), (0.0, 0.5, 0.85)  # where a fit may start
STEP = 1e-4  # of the finite differences in log sigma_t, albedo and g
G_LIMIT = 0.97
AT_LIMIT = 1e-4
REMEMBERED = 64  # media whose light is kept
ROUNDS = 8
CLOSE = (1e-2, 1e-2, 1e-2)  # change from which on derivatives are kept
SETTLED = (3e-4, 1e-3, 1e-3)  # change of (log sigma_t, albedo, g) that ends these rounds
BOUNDS = ((-12.0, 0.0, -G_LIMIT), (6.0, 1.0, G_LIMIT))

Contrasts = Callable[[Medium], Sequence[tuple[float | None, float]]]
SideWalls = Callable[[Medium], ComplexArray]  # of sigma, the change of the white waves (J+1, n_x)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """What is fitted: at depths x_mm (n_x,), in a tank of a given depth.

    Attributes
    ----------
    white : its moment is NaN at depths that are not known
    stripes : one for each period
    depth_mm : of the tank
    """

    x_mm: Array
    white: WhiteLight
    stripes: tuple[StripeWave, ...]
    depth_mm: float

    @property
    def slope(self) -> float:
        """Return tan of the beam's direction, the mean over the periods."""
        return float(np.mean([s.slope for s in self.stripes]))


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeAware:
    """The medium that explains stripes and white light together.

    Attributes
    ----------
    covariance : (3, 3) of (sigma_t, sigma_s, g): camera noise carried through the fit; where
        that is unknown, the scatter of the residuals
    model_covariance : (3, 3), what the model's own error, taken as independent from depth to
        depth, would do to them
    condition : condition number of the scaled normal matrix of (log sigma_t, albedo, g)
    scale_c, scale_c_std : light of the ballistic beam where it enters, times mm across it
    contrast : (n_periods,), amplitude of the stripes over the white light, c1 as it arrived
    profile : (J,) complex, w^(q_j) / w^(0)
    losses : (J + 1, n_x) complex, what the side walls change of the white waves, per unit of C
    chi2_per_dof : mean squared residual in units of noise and model error together
    at_limit : albedo or g stopped at the end of what is possible
    depth_range_mm : of the white light fitted; ``stripe_range_mm`` of the stripes
    white_fit : (J + 1, n_x) complex, the model of the white waves; NaN where not fitted
    stripe_fit : (n_periods, n_x), likewise
    """

    medium: Medium
    covariance: Array
    model_covariance: Array
    condition: float
    scale_c: float
    scale_c_std: float
    contrast: Array
    profile: ComplexArray
    losses: ComplexArray
    chi2_per_dof: float
    at_limit: bool
    depth_range_mm: tuple[float, float]
    stripe_range_mm: tuple[float, float]
    white_fit: ComplexArray
    stripe_fit: Array


class _Problem:
    """Residuals over their weights, and their derivatives; each medium is solved once.

    Parameters are log sigma_t, albedo, g, log C, the profile's waves (J real parts, J imaginary
    ones) and the log contrast of each period.

    Attributes
    ----------
    lit : (n_x,), depths at which the white light is fitted
    striped : the same of each period's stripes
    losses : (J + 1, n_x), what the side walls change, per unit of C
    """

    def __init__(self, observed: Observed, phase: Phase, sigma_t_per_mm: float) -> None:
        self.o = o = observed
        self._phase = phase
        self._slant_deg = math.degrees(math.atan(o.slope))
        self._memory: dict[tuple[float, ...], tuple[ComplexArray, list[Array]]] = {}
        self.n_waves = o.white.wavenumber_per_mm.size - 1
        self.losses = np.zeros((self.n_waves + 1, o.x_mm.size), dtype=np.complex128)
        self.lit, self.striped = self._depths(sigma_t_per_mm)
        self._weigh()
        turn = np.exp(1j * o.slope * np.outer(o.white.wavenumber_per_mm, o.x_mm))
        waves = (o.white.moment * turn)[:, self.lit]
        amplitudes = [s.amplitude[use] for s, use in zip(o.stripes, self.striped, strict=True)]
        self.prior = o.stripes[0].profile
        self._seen = np.concatenate(
            [
                *(waves.real.ravel(), waves.imag[1:].ravel(), *amplitudes),
                *(self.prior.real, self.prior.imag),
                np.array([math.log(s.contrast or 1.0) for s in o.stripes]),
            ]
        )

    def _depths(self, sigma_t_per_mm: float) -> tuple[NDArray[np.bool_], list[NDArray[np.bool_]]]:
        o = self.o
        total = np.abs(o.white.moment[0])
        if not np.isfinite(total).any():
            msg = "no depth has all its rows unsaturated: the white light cannot be fitted."
            raise AnalysisError(msg)
        lit = np.isfinite(total) & _until(total < WHITE_SHARE * np.nanmax(total), total)
        lit &= (o.x_mm > FACE_TAU / sigma_t_per_mm) & (o.x_mm < WHITE_TAU / sigma_t_per_mm)
        striped = [
            np.isfinite(s.amplitude)
            & (o.x_mm > FACE_TAU / sigma_t_per_mm)
            & (o.x_mm < STRIPE_TAU / sigma_t_per_mm)
            & _until(s.amplitude < STRIPE_SNR * s.std, s.amplitude)
            for s in o.stripes
        ]
        fewest = min(int(lit.sum()), *(int(s.sum()) for s in striped))
        if fewest < FEWEST_DEPTHS:
            msg = (
                f"{fewest} depths are left to fit the stripes and the white light together, "
                f"{FEWEST_DEPTHS} are needed; take longer exposures or a less dense sample."
            )
            raise AnalysisError(msg)
        return lit, striped

    def _weigh(self) -> None:
        """Set the standard deviations of all that is seen: the camera's, and the model's own."""
        o, n = self.o, self.n_waves
        parts = np.r_[np.arange(n + 1), np.arange(1, n + 1) + n + 1]  # the sum is real
        self._white_covariance = o.white.covariance[self.lit][:, parts][:, :, parts]
        noise = np.sqrt(np.diagonal(self._white_covariance, axis1=1, axis2=2)).T
        total = np.abs(o.white.moment[0])
        floor = MODEL_ERROR * total[self.lit] + FACE_ERROR * np.nanmax(total)
        self.n_seen = noise.size + sum(int(use.sum()) for use in self.striped)
        std, error = [noise.ravel()], [np.broadcast_to(floor, noise.shape).ravel()]
        for stripe, use in zip(o.stripes, self.striped, strict=True):
            light = stripe.amplitude
            std.append(stripe.std[use])
            error.append(MODEL_ERROR * np.abs(light[use]) + FACE_ERROR * np.nanmax(light))
        std += [np.tile(o.stripes[0].profile_std, 2), np.zeros(len(o.stripes))]
        error += [
            np.full(2 * n, PROFILE_ERROR),
            np.array([s.contrast_std if s.contrast else UNKNOWN for s in o.stripes]),
        ]
        self.noise, self.error = np.concatenate(std), np.concatenate(error)
        self.weight = 1.0 / np.hypot(self.noise, self.error)

    def set_contrasts(self, known: Sequence[tuple[float | None, float]]) -> None:
        """Hold the contrasts to other values."""
        n = len(known)
        self._seen[-n:] = [math.log(value or 1.0) for value, _ in known]
        self.error[-n:] = [std if value else UNKNOWN for value, std in known]
        self.weight = 1.0 / np.hypot(self.noise, self.error)

    def medium(self, parameters: Sequence[float] | Array) -> Medium:
        """Return the medium of (log sigma_t, albedo, g)."""
        log_t, albedo, g = (float(v) for v in parameters[:3])
        sigma_t = math.exp(log_t)
        return Medium(
            sigma_t_per_mm=sigma_t, sigma_s_per_mm=albedo * sigma_t, g=g, phase=self._phase
        )

    def waves(self, parameters: Sequence[float] | Array) -> tuple[ComplexArray, list[Array]]:
        """Return A of the white waves (J + 1, n_lit), and of each period's stripes in phase."""
        key = tuple(float(v) for v in parameters[:3])
        if key not in self._memory:
            if len(self._memory) > REMEMBERED:
                self._memory.clear()
            self._memory[key] = self._solve(self.medium(key))
        return self._memory[key]

    def _solve(self, medium: Medium) -> tuple[ComplexArray, list[Array]]:
        o = self.o
        lit_mm = o.x_mm[self.lit]
        white = [self._light(medium, float(q), lit_mm, 0.0) for q in o.white.wavenumber_per_mm]
        stripes = []
        for stripe, use in zip(o.stripes, self.striped, strict=True):
            x_mm, q = o.x_mm[use], abs(stripe.wavenumber_per_mm)
            stripes.append(in_phase(self._light(medium, q, x_mm, float(x_mm[-1])), x_mm)[0])
        return np.stack(white), stripes

    def _light(self, medium: Medium, q: float, x_mm: Array, resolved_mm: float) -> ComplexArray:
        return plane_light(
            medium,
            x_mm,
            depth_mm=self.o.depth_mm,
            wavenumber_per_mm=q,
            angle_deg=self._slant_deg,
            n_theta=_directions(medium.g, q, resolved_mm),
        )

    def start(self, medium: Sequence[float]) -> Array:
        """Return parameters whose free scales suit a medium (log sigma_t, albedo, g)."""
        white, stripes = self.waves(medium)
        n_lit = int(self.lit.sum())
        wave = white[0].real + self.losses[0].real[self.lit]
        scale = _scale(wave, self._seen[:n_lit], self.weight[:n_lit])
        contrast, first = [], (2 * self.n_waves + 1) * n_lit
        for row in stripes:
            some = slice(first, first + row.size)
            found = _scale(row, self._seen[some], self.weight[some])
            contrast.append(math.log(max(found / scale, 1e-6)))
            first += row.size
        profile = [*self.prior.real, *self.prior.imag]
        return np.array([*medium[:3], math.log(scale), *profile, *contrast])

    def residual(self, parameters: Array) -> Array:
        """Return model less data over their standard deviations."""
        return np.asarray((self._predicted(parameters) - self._seen) * self.weight)

    def jacobian(self, parameters: Array) -> Array:
        """Return the residual's derivatives, by differences."""
        here = self._predicted(parameters)
        out = np.empty((here.size, parameters.size))
        for k in range(parameters.size):
            nearby = parameters.copy()
            outside = k < len(BOUNDS[1]) and parameters[k] + STEP > BOUNDS[1][k]
            nearby[k] += -STEP if outside else STEP
            change = self._predicted(nearby) - here
            out[:, k] = change / (nearby[k] - parameters[k]) * self.weight
        return out

    def _predicted(self, parameters: Array) -> Array:
        n = self.n_waves
        scale, free = math.exp(parameters[3]), parameters[4 : 4 + 2 * n]
        profile = np.r_[1.0, free[:n] + 1j * free[n:]]
        white, stripes = self.waves(parameters)
        waves = scale * (profile[:, None] * white + self.losses[:, self.lit])
        contrast = parameters[4 + 2 * n :]
        striped = [scale * math.exp(c) * row for c, row in zip(contrast, stripes, strict=True)]
        parts = [waves.real.ravel(), waves.imag[1:].ravel(), *striped, free, contrast]
        return np.concatenate(parts)

    def light(self, parameters: Array) -> tuple[ComplexArray, Array]:
        """Return the model of the white waves (J + 1, n_x) and the stripes, NaN if not fitted."""
        o, n = self.o, self.n_waves
        predicted, n_lit = self._predicted(parameters), int(self.lit.sum())
        real = predicted[: (n + 1) * n_lit].reshape(n + 1, n_lit)
        imaginary = predicted[(n + 1) * n_lit : (2 * n + 1) * n_lit].reshape(n, n_lit)
        white = np.full((n + 1, o.x_mm.size), np.nan, dtype=np.complex128)
        white[:, self.lit] = real + 1j * np.concatenate([np.zeros((1, n_lit)), imaginary])
        white *= np.exp(-1j * o.slope * np.outer(o.white.wavenumber_per_mm, o.x_mm))
        stripes, first = np.full((len(o.stripes), o.x_mm.size), np.nan), (2 * n + 1) * n_lit
        for row, use in zip(stripes, self.striped, strict=True):
            row[use] = predicted[first : first + int(use.sum())]
            first += int(use.sum())
        return white, stripes

    def carried_noise(self, pull: Array) -> Array:
        """Return the covariance of ``pull`` (n_p, n_data) times the data, the camera's noise.

        The white waves of one depth share their pixels' noise; everything else is independent.
        """
        n_depths, n_parts = self._white_covariance.shape[:2]
        white = pull[:, : n_depths * n_parts].reshape(-1, n_parts, n_depths)
        found = np.einsum("pax,xab,qbx->pq", white, self._white_covariance, white, optimize=True)
        other = pull[:, n_depths * n_parts :] * self.noise[n_depths * n_parts :]
        return np.asarray(found + other @ other.T)

    def carried_error(self, pull: Array) -> Array:
        """Return the same of the model's own error, independent from depth to depth."""
        return np.asarray((pull * self.error) @ (pull * self.error).T)


def _scale(wave: Array, seen: Array, weight: Array) -> float:
    w = (weight * wave) ** 2
    return max(float(np.sum(w * seen / wave) / np.sum(w)), 1e-300)


def fit_stripe_aware(
    observed: Observed,
    *,
    sigma_t_per_mm: float,
    phase: Phase = "hg-plane",
    side_walls: SideWalls | None = None,
    contrasts: Contrasts | None = None,
    near: Medium | None = None,
) -> StripeAware:
    """Fit (sigma_t, sigma_s, g) to the stripes of every period and to the white light.

    What depends weakly on the medium (side walls, contrast) is found anew for each medium found,
    until it settles; the last of these rounds keep the derivatives of the one before.

    Parameters
    ----------
    sigma_t_per_mm : a guess, such as Eq. 9 gives; it may be a third too small
    side_walls : what the side walls change of the white waves per unit of C, (J + 1, n_x)
    contrasts : value and relative std of each period's contrast, better known with a medium
    near : where to start; else from several asymmetries and albedos

    Raises
    ------
    AnalysisError
        If too few depths hold stripes and white light, or no fit is found.
    """
    with threadpool_limits(limits=1):  # small matrices: a second thread only waits
        problem = _Problem(observed, phase, sigma_t_per_mm)
        at = _start(problem, sigma_t_per_mm) if near is None else _of(near)
        found, slope = np.array(at), None
        for done in range(ROUNDS):
            before = found[:3].copy()
            medium = problem.medium(found)
            if side_walls is not None:
                problem.losses = side_walls(medium)
            if contrasts is not None and done > 0:
                problem.set_contrasts(contrasts(medium))
            if done == 0:
                found = problem.start(at)
            found = _solve(problem, found, slope=slope)
            if side_walls is None and contrasts is None:
                break
            if done > 0 and np.all(np.abs(found[:3] - before) < SETTLED):
                break
            near_enough = done > 0 and np.all(np.abs(found[:3] - before) < CLOSE)
            slope = problem.jacobian(found) if near_enough else None
        return _described(problem, found)


def stripe_answer(
    medium: Medium, wavenumber_per_mm: float, x_mm: Array, *, depth_mm: float, slope: float
) -> Array:
    """Return the size of stripes of all bounces against depth, one where they enter, (n_x,)."""
    q = abs(wavenumber_per_mm)
    light = plane_light(
        medium,
        x_mm,
        depth_mm=depth_mm,
        wavenumber_per_mm=q,
        angle_deg=math.degrees(math.atan(slope)),
        n_theta=_directions(medium.g, q, float(x_mm.max())),
    )
    return np.abs(light)


def _of(medium: Medium) -> tuple[float, float, float]:
    return math.log(medium.sigma_t_per_mm), medium.albedo, medium.g


def _start(problem: _Problem, sigma_t_per_mm: float) -> tuple[float, float, float]:
    """Return the medium of a few that explains the light best, its scales suited."""
    best, least = None, math.inf
    for albedo in ALBEDOS:
        for g in ASYMMETRIES:
            # What Eq. 9 misses grows with what is scattered forward.
            log_t = math.log(sigma_t_per_mm / (1.0 - 0.4 * albedo * max(g, 0.0) ** 3))
            start = problem.start((log_t, albedo, g))
            cost = float(np.sum(np.arcsinh(problem.residual(start)) ** 2))
            if cost < least:
                best, least = (log_t, albedo, g), cost
    if best is None:
        msg = "the stripes and the white light fit no medium at all; is the sample scattering?"
        raise AnalysisError(msg)
    return best


def _solve(problem: _Problem, start: Array, *, slope: Array | None = None) -> Array:
    """Return the best parameters near ``start``; with ``slope`` for all derivatives on the way."""
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[:3], high[:3] = BOUNDS
    found = least_squares(
        problem.residual,
        np.clip(start, low + 1e-9, high - 1e-9),
        jac=problem.jacobian if slope is None else lambda _: slope,
        bounds=(low, high),
        x_scale="jac",
        ftol=1e-5,
        xtol=1e-5,
        gtol=1e-9,
        max_nfev=60,
    )
    if not found.success:
        msg = "the fit of stripes and white light together did not converge; see the alternatives."
        raise AnalysisError(msg)
    return np.asarray(found.x)


def _described(problem: _Problem, found: Array) -> StripeAware:
    o, n = problem.o, problem.n_waves
    jacobian = problem.jacobian(found)
    pull = np.linalg.pinv(jacobian)[:4] * problem.weight
    medium = problem.medium(found)
    sigma_t = medium.sigma_t_per_mm
    # (sigma_t, sigma_s, g) by (log sigma_t, albedo, g)
    turn = np.array([[sigma_t, 0.0, 0.0], [medium.sigma_s_per_mm, sigma_t, 0.0], [0.0, 0.0, 1.0]])
    residual = problem.residual(found)
    chi2_per_dof = float(residual @ residual) / max(residual.size - found.size, 1)
    known = bool(problem.noise[: problem.n_seen].all())

    def carried(by: Array) -> Array:
        return problem.carried_noise(by) if known else chi2_per_dof * problem.carried_error(by)

    of_scale = float(carried(pull[3:])[0, 0])
    pull = turn @ pull[:3]
    scaled = jacobian[:, :3] / np.linalg.norm(jacobian[:, :3], axis=0)
    striped = np.concatenate([o.x_mm[use] for use in problem.striped])
    lit = o.x_mm[problem.lit]
    white_fit, stripe_fit = problem.light(found)
    return StripeAware(
        medium=medium,
        covariance=carried(pull),
        model_covariance=problem.carried_error(pull),
        condition=float(np.linalg.cond(scaled)),
        scale_c=math.exp(found[3]),
        scale_c_std=math.exp(found[3]) * math.sqrt(of_scale),
        contrast=np.exp(found[4 + 2 * n :]),
        profile=found[4 : 4 + n] + 1j * found[4 + n : 4 + 2 * n],
        losses=problem.losses,
        chi2_per_dof=chi2_per_dof,
        at_limit=bool(medium.albedo > 1.0 - AT_LIMIT or abs(medium.g) > G_LIMIT - AT_LIMIT),
        depth_range_mm=(float(lit[0]), float(lit[-1])),
        stripe_range_mm=(float(striped.min()), float(striped.max())),
        white_fit=white_fit,
        stripe_fit=stripe_fit,
    )


def _until(ended: NDArray[np.bool_], value: Array) -> NDArray[np.bool_]:
    """Return the depths before the first, behind the maximum, at which ``ended`` holds."""
    finite = np.where(np.isfinite(value), value, -np.inf)
    behind = ended & np.isfinite(value) & (np.arange(value.size) > int(np.argmax(finite)))
    last = np.flatnonzero(behind)
    return np.asarray(np.arange(value.size) < (last[0] if last.size else value.size))


def _directions(g: float, wavenumber_per_mm: float, deepest_mm: float) -> int:
    """Return directions enough for the phase function, and for stripes down to a depth."""
    n = max(64.0 if abs(g) <= 0.72 else 128.0, 1.2 * wavenumber_per_mm * deepest_mm)
    return int(min(512, 4 * math.ceil(n / 4.0)))
