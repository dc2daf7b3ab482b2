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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from analysis.errors import AnalysisError
from analysis.medium import Medium, Phase
from analysis.phase_function import alike
from analysis.stripe_problem import G_LIMIT, Observed, Problem, directions
from analysis.transport.eigenmodes import plane_light

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

ALBEDOS, ASYMMETRIES = (0.4, 0.85), (0.0, 0.5, 0.85)  # where a fit may start
AT_LIMIT = 1e-4
WALL_ERROR = 0.06  # of what the side walls take away: how well that is known
ROUNDS = 8
ROUGH, FINE = 1e-3, 1e-5  # change of a fit's residual, or of its parameters, that ends it
PROFILE_STDS, PROFILE_STEPS = 3.0, 3
SETTLED = (3e-4, 1e-3, 1e-3)  # change of (log sigma_t, albedo, g) that ends these rounds

Contrasts = Callable[[Medium], Sequence[tuple[float | None, float]]]
SideWalls = Callable[[Medium], ComplexArray]  # of sigma, the change of the white waves (J+1, n_x)


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeAware:
    """The medium that explains stripes and white light together.

    Attributes
    ----------
    covariance : (3, 3) of (sigma_t, sigma_s, g): camera noise carried through the fit; where
        that is unknown, the scatter of the residuals
    model_covariance : (3, 3), what the model's own error, taken as independent from depth to
        depth, would do to them; where the light misses the model by more, what that much would.
        Beside it what an error of the side walls' losses would do
    condition : condition number of the scaled normal matrix of (log sigma_t, albedo, g)
    scale_c, scale_c_std : light of the ballistic beam where it enters, times mm across it
    contrast : (n_periods,), amplitude of the stripes over the white light, c1 as it arrived
    profile : (J,) complex, w^(q_j) / w^(0)
    losses : (J + 1, n_x) complex, what the side walls change of the white waves, per unit of C
    chi2_per_dof : mean squared residual in units of noise and model error together
    profile_g : (n, 2), the profile likelihood: values of g, and how much chi^2 is above its least
        there, all else fitted anew; empty if it was not asked for
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
    profile_g: Array
    at_limit: bool
    depth_range_mm: tuple[float, float]
    stripe_range_mm: tuple[float, float]
    white_fit: ComplexArray
    stripe_fit: Array


def fit_stripe_aware(
    observed: Observed,
    *,
    sigma_t_per_mm: float,
    phase: Phase = "hg-plane",
    side_walls: SideWalls | None = None,
    contrasts: Contrasts | None = None,
    near: Medium | StripeAware | None = None,
    g: float | None = None,
    profile: bool = False,
) -> StripeAware:
    """Fit (sigma_t, sigma_s, g) to the stripes of every period and to the white light.

    What depends weakly on the medium (side walls, contrast) is found anew for each medium found,
    until it settles; each round looks ahead by those before it.

    Parameters
    ----------
    sigma_t_per_mm : a guess, such as Eq. 9 gives; it may be a third too small
    side_walls : what the side walls change of the white waves per unit of C, (J + 1, n_x)
    contrasts : value and relative std of each period's contrast, better known with a medium
    near : where to start, else at several asymmetries and albedos: a medium, or a fit by the other
        phase function, whose losses are taken too
    g : held there, for data that do not tell it
    profile : whether the profile likelihood of g is wanted too

    Raises
    ------
    AnalysisError
        If too few depths hold stripes and white light, or no fit is found; if no medium scatters
        like that of ``near``.
    """
    with threadpool_limits(limits=1):  # small matrices: a second thread only waits
        problem = Problem(observed, phase, sigma_t_per_mm)
        at = np.array(_start(problem, sigma_t_per_mm) if near is None else _near(near, phase))
        if g is not None:
            problem.hold_g(g)
            at[2] = g
        if isinstance(near, StripeAware):
            problem.losses = near.losses
        found = problem.start(at)
        path: list[tuple[Array, Array]] = []
        for done in range(ROUNDS):
            medium = problem.medium(at)
            if side_walls is not None and done > 0:
                problem.losses = side_walls(medium)
            if contrasts is not None and done > 0:
                problem.set_contrasts(contrasts(medium))
            found = _solve(problem, found, ROUGH if done == 0 else FINE)
            move = found[:3] - at
            if side_walls is None and contrasts is None:
                break
            if done > 0 and np.all(np.abs(move) < SETTLED):
                break
            problem.renew(found)
            at, path = found[:3], [*path[-2:], (at, move)] if done > 0 else []
            if path:
                at = np.clip(_ahead(path), *problem.bounds)
            found[:3] = at
        problem.renew(found)
        found = _solve(problem, found)
        described = _described(problem, found)
        return replace(described, profile_g=_profile(problem, found)) if profile else described


def _ahead(path: Sequence[tuple[Array, Array]]) -> Array:
    """Return where the next move of a path of (point, move) will be least (Anderson 1965)."""
    at, move = path[-1]
    if len(path) == 1:
        return at + move
    moves = np.stack([move - other for _, other in path[:-1]], axis=1)
    steps = np.stack([at - other for other, _ in path[:-1]], axis=1)
    share = np.linalg.lstsq(moves, move, rcond=1e-3)[0]
    return np.asarray(at + move - (steps + moves) @ share)


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
        n_theta=directions(q, float(x_mm.max()), slope),
        equal_steps=True,
    )
    return np.abs(light)


def _profile(problem: Problem, found: Array) -> Array:
    """Return g and chi^2 above its least, all else fitted anew, over three std to each side."""
    normal = problem.jacobian(found).T @ problem.jacobian(found)
    std = math.sqrt(float(np.linalg.pinv(normal)[2, 2]))
    least = float(np.sum(problem.residual(found) ** 2))
    curve = [(float(found[2]), 0.0)]
    for side in (-1.0, 1.0):
        before, at = found, found
        for step in range(1, PROFILE_STEPS + 1):
            g = float(found[2] + side * step * std * PROFILE_STDS / PROFILE_STEPS)
            if abs(g) >= G_LIMIT:
                break
            problem.hold_g(g)
            start = 2.0 * at - before  # the valley goes on as it went
            start[2] = g
            before, at = at, _solve(problem, start, ROUGH)
            curve.append((g, float(np.sum(problem.residual(at) ** 2) - least)))
    return np.array(sorted(curve))


def _near(known: Medium | StripeAware, phase: Phase) -> tuple[float, float, float]:
    medium = known if isinstance(known, Medium) else alike(known.medium, phase)
    if medium is None:
        msg = f"no medium of phase function {phase} scatters like the one that was found."
        raise AnalysisError(msg)
    return math.log(medium.sigma_t_per_mm), medium.albedo, medium.g


def _start(problem: Problem, sigma_t_per_mm: float) -> tuple[float, float, float]:
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


def _solve(problem: Problem, start: Array, tolerance: float = FINE) -> Array:
    """Return the best parameters near ``start``."""
    low, high = np.full(start.size, -np.inf), np.full(start.size, np.inf)
    low[:3], high[:3] = problem.bounds
    found = least_squares(
        problem.residual,
        np.clip(start, low + 1e-9, high - 1e-9),
        jac=problem.jacobian,
        bounds=(low, high),
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=1e-9,
        max_nfev=60,
    )
    if not found.success:
        msg = "the fit of stripes and white light together did not converge; see the alternatives."
        raise AnalysisError(msg)
    return np.asarray(found.x)


def _described(problem: Problem, found: Array) -> StripeAware:
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
    by_walls = pull @ problem.change_by_walls(found, WALL_ERROR)
    scaled = jacobian[:, :3] / np.linalg.norm(jacobian[:, :3], axis=0)
    striped = np.concatenate([o.x_mm[use] for use in problem.striped])
    lit = o.x_mm[problem.lit]
    white_fit, stripe_fit = problem.light(found)
    return StripeAware(
        medium=medium,
        covariance=carried(pull),
        model_covariance=max(1.0, chi2_per_dof) * problem.carried_error(pull)
        + np.outer(by_walls, by_walls),
        condition=float(np.linalg.cond(scaled)),
        scale_c=math.exp(found[3]),
        scale_c_std=math.exp(found[3]) * math.sqrt(of_scale),
        contrast=np.exp(found[4 + 2 * n :]),
        profile=found[4 : 4 + n] + 1j * found[4 + n : 4 + 2 * n],
        losses=problem.losses,
        chi2_per_dof=chi2_per_dof,
        profile_g=np.empty((0, 2)),
        at_limit=bool(medium.albedo > 1.0 - AT_LIMIT or abs(medium.g) > G_LIMIT - AT_LIMIT),
        depth_range_mm=(float(lit[0]), float(lit[-1])),
        stripe_range_mm=(float(striped.min()), float(striped.max())),
        white_fit=white_fit,
        stripe_fit=stripe_fit,
    )
