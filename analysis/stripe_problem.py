"""What the fit of stripes and white light compares: what is seen, and what a medium would show.

Transport is solved once a medium. Its derivatives by log sigma_t, albedo and g are kept, and
mended by every further medium solved (Broyden 1965), which saves most of the solutions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
# Light is fitted from this optical depth on: blur mixes in what is before the face.
FACE_TAU = 0.04
WHITE_TAU = 4.5  # and to which the white light is: deeper, it is other walls' and strays' light
STRIPE_TAU = 6.0  # the same of the stripes
PROFILE_ERROR = 1e-3  # of the waves of the illumination
UNKNOWN = 1e3  # of the logarithm of a contrast that was not measured
FEWEST_DEPTHS = 8
STEP = 1e-4  # of the finite differences in log sigma_t, albedo and g
G_LIMIT = 0.97
HELD = 1e-7  # half of the room that is left to a g that is held
LEAST_STEP = 1e-3  # shorter ones change the derivatives less than they would spoil them
NEARBY = 5e-3  # of log sigma_t, albedo and g: derivatives are taken anew from there on
WHITE_DIRECTIONS = 64
REMEMBERED = 64  # media whose light is kept
BOUNDS = ((-12.0, 0.0, -G_LIMIT), (6.0, 1.0, G_LIMIT))


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


class Problem:
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
        self._memory: dict[tuple[float, ...], ComplexArray] = {}
        self._slope: ComplexArray | None = None  # of the answer, (n, 3)
        self._renewed = np.zeros(3)  # where it was taken by differences
        self._last = (np.zeros(3), np.zeros(0, dtype=np.complex128))
        self.bounds = tuple(np.array(bound) for bound in BOUNDS)
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
                f"{FEWEST_DEPTHS} are needed from {FACE_TAU:g} mean free paths on."
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

    def hold_g(self, g: float) -> None:
        """Leave g where it is told to be."""
        self.bounds[0][2], self.bounds[1][2] = g - HELD, g + HELD

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

    def answer(self, parameters: Sequence[float] | Array) -> ComplexArray:
        """Return A of the white waves, ((J + 1) n_lit,), and of each period's stripes in phase."""
        at = tuple(float(v) for v in parameters[:3])
        if at not in self._memory:
            if len(self._memory) > REMEMBERED:
                self._memory.clear()
            self._memory[at] = self._solved(self.medium(at))
            self._mend(np.array(at), self._memory[at])
        return self._memory[at]

    def _solved(self, medium: Medium) -> ComplexArray:
        o = self.o
        lit_mm = o.x_mm[self.lit]
        q_j = o.white.wavenumber_per_mm
        waves = [self._light(medium, float(q), lit_mm) for q in q_j]
        for stripe, use in zip(o.stripes, self.striped, strict=True):
            x_mm, q = o.x_mm[use], abs(stripe.wavenumber_per_mm)
            n_theta = directions(q, float(x_mm[-1]), o.slope)
            wave = in_phase(self._light(medium, q, x_mm, n_theta), x_mm)[0]
            waves.append(wave.astype(np.complex128))
        return np.concatenate(waves)

    def _light(
        self, medium: Medium, q: float, x_mm: Array, steps: int | None = None
    ) -> ComplexArray:
        return plane_light(
            medium,
            x_mm,
            depth_mm=self.o.depth_mm,
            wavenumber_per_mm=q,
            angle_deg=self._slant_deg,
            n_theta=steps or WHITE_DIRECTIONS,
            equal_steps=steps is not None,
        )

    def _mend(self, at: Array, answer: ComplexArray) -> None:
        """Make the kept derivatives true along the step to a further medium."""
        if self._slope is None:
            return
        step, change = at - self._last[0], answer - self._last[1]
        if step @ step > LEAST_STEP**2:
            self._slope += np.outer(change - self._slope @ step, step) / (step @ step)
        self._last = (at, answer)

    def renew(self, parameters: Array) -> None:
        """Take the derivatives by differences, (n, 3), if the last ones are of another place."""
        at = parameters[:3].copy()
        if self._slope is not None and np.all(np.abs(at - self._renewed) < NEARBY):
            return
        self._renewed = at
        here, columns = self.answer(at), []
        self._slope = None
        for k, high in enumerate(BOUNDS[1]):
            nearby = at.copy()
            nearby[k] += -STEP if at[k] + STEP > high else STEP
            columns.append((self.answer(nearby) - here) / (nearby[k] - at[k]))
        self._slope, self._last = np.stack(columns, axis=1), (at, here)

    def start(self, medium: Sequence[float] | Array) -> Array:
        """Return parameters whose free scales suit a medium (log sigma_t, albedo, g)."""
        white, stripes = self._split(self.answer(medium))
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
        """Return the residual's derivatives; those of the answer are the kept ones."""
        if self._slope is None:
            self.renew(parameters)
        answer, here = self.answer(parameters), self._predicted(parameters)
        columns = []
        for k in range(parameters.size):
            if self._slope is not None and k < self._slope.shape[1]:
                there = self._predicted(parameters, answer + STEP * self._slope[:, k])
            else:
                nearby = parameters.copy()
                nearby[k] += STEP
                there = self._predicted(nearby)
            columns.append((there - here) / STEP * self.weight)
        return np.stack(columns, axis=1)

    def _predicted(self, parameters: Array, answer: ComplexArray | None = None) -> Array:
        n = self.n_waves
        scale, free = math.exp(parameters[3]), parameters[4 : 4 + 2 * n]
        profile = np.r_[1.0, free[:n] + 1j * free[n:]]
        white, stripes = self._split(self.answer(parameters) if answer is None else answer)
        waves = scale * (profile[:, None] * white + self.losses[:, self.lit])
        contrast = parameters[4 + 2 * n :]
        striped = [scale * math.exp(c) * row for c, row in zip(contrast, stripes, strict=True)]
        parts = [waves.real.ravel(), waves.imag[1:].ravel(), *striped, free, contrast]
        return np.concatenate(parts)

    def change_by_walls(self, parameters: Array, share: float) -> Array:
        """Return what a share of the side walls' losses makes of what is seen."""
        here, losses = self._predicted(parameters), self.losses
        self.losses = (1.0 + share) * losses
        there = self._predicted(parameters)
        self.losses = losses
        return there - here

    def _split(self, answer: ComplexArray) -> tuple[ComplexArray, list[Array]]:
        """Return the white waves (J + 1, n_lit), and each period's stripes."""
        n_lit = int(self.lit.sum())
        ends = np.cumsum([(self.n_waves + 1) * n_lit, *(int(s.sum()) for s in self.striped[:-1])])
        white, *stripes = np.split(answer, ends)
        return white.reshape(-1, n_lit), [row.real for row in stripes]

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


def _until(ended: NDArray[np.bool_], value: Array) -> NDArray[np.bool_]:
    """Return the depths before the first, behind the maximum, at which ``ended`` holds."""
    finite = np.where(np.isfinite(value), value, -np.inf)
    behind = ended & np.isfinite(value) & (np.arange(value.size) > int(np.argmax(finite)))
    last = np.flatnonzero(behind)
    return np.asarray(np.arange(value.size) < (last[0] if last.size else value.size))


def _scale(wave: Array, seen: Array, weight: Array) -> float:
    w = (weight * wave) ** 2
    return max(float(np.sum(w * seen / wave) / np.sum(w)), 1e-300)


def directions(wavenumber_per_mm: float, deepest_mm: float, slope: float) -> int:
    """Return equal steps of direction enough to resolve stripes down to a depth.

    What they miss of the light stays below a thousandth of it plus a ten-thousandth of that at the
    face, to asymmetries of 0.9 and slants of 30 degrees.
    """
    n = max(64.0, 1.1 * wavenumber_per_mm * deepest_mm * (1.0 + slope**2) + 32.0)
    return int(min(512, 4 * math.ceil(n / 4.0)))
