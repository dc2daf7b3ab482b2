"""Discrete ordinates: every bounce from the one before by short characteristics (Eqs. 1, 4).

L_2 is the closed form; each later order is swept along every direction through the grid.
Scattering turns a light field by its Fourier moments over direction, as many as the phase
function has that matter: isotropic scattering needs one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.light_field import BounceField, Grid, equal_angles
from analysis.medium import Beam, Medium
from analysis.phase_function import UNRESOLVED, Array, phase_function, scattering_moments
from analysis.transport.beam import ballistic_fluence, second_bounce
from analysis.transport.blas import on_one_thread
from analysis.transport.choose import relative_error
from analysis.transport.sweep import sweep

LARGEST = 600.0  # logarithm; leaves room for sums
DType = type[np.float32] | type[np.float64]

BLOCK = 32  # directions whose sources are held at a time
NEGLIGIBLE = 1e-5  # share of the phase function's first moment


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """The directions whose rays cross every line of constant x (or y), and their radiance.

    Lines lie in memory one after another, so that a sweep runs along them.

    Attributes
    ----------
    of_x : whether these are the lines of constant x
    index, theta_rad : (n,), the directions' places in the grid and values
    across, along : (n,), components of the directions across the lines and along them
    pitch_mm : from line to line, and from node to node on them
    to_moments : (r, n), takes radiance to its moments over direction
    to_source : (n, r), takes the moments of all light to what is scattered into a direction
    radiance : (n, n_x, n_y) if ``of_x``, else (n, n_y, n_x); overwritten by each bounce
    """

    of_x: bool
    index: NDArray[np.int64]
    theta_rad: Array
    across: Array
    along: Array
    pitch_mm: tuple[float, float]
    to_moments: Array
    to_source: Array
    radiance: Array

    def light_from(self, medium: Medium, beam: Beam, grid: Grid) -> Array:
        """Fill in the second bounce and return its moments, shaped like it."""
        second_bounce(
            grid,
            beam,
            self.theta_rad,
            sigma_t_per_mm=medium.sigma_t_per_mm,
            weight=_weight(medium, beam, self.theta_rad),
            lines_of_x=self.of_x,
            out=self.radiance,
        )
        moments = self.to_moments @ self._flat()
        return np.asarray(moments).reshape(-1, *self.radiance.shape[1:])

    def scatter(self, moments: Array, weight: float, sigma_t_per_mm: float) -> Array:
        """Fill in the light scattered by all directions, and return its moments, shaped like it.

        What is scattered is ``weight`` times these moments.
        """
        shape = self.radiance.shape[1:]
        lines = _transposed(moments) if self.of_x else moments
        flat = np.ascontiguousarray(lines).reshape(moments.shape[0], -1)
        to_source = self.to_source * self.to_source.dtype.type(weight)
        out = np.zeros_like(flat) if self.index.size == 0 else None
        buffer = np.empty((BLOCK, flat.shape[1]), dtype=flat.dtype)
        for first in range(0, self.index.size, BLOCK):
            some = slice(first, min(first + BLOCK, self.index.size))
            source = buffer[: some.stop - first]
            np.matmul(to_source[some], flat, out=source)
            # What the moments left out may show as a trace of negative light.
            np.maximum(source, 0.0, out=source)
            sweep(
                source.reshape(-1, *shape),
                self.across[some],
                self.along[some],
                self.pitch_mm,
                sigma_t_per_mm,
                self.radiance[some],
            )
            light = self.to_moments[:, some] @ self._flat()[some]
            if out is None:
                out = light
            else:
                out += light
        return np.asarray(out).reshape(-1, *shape)

    def _flat(self) -> Array:
        n, n_lines, n_nodes = self.radiance.shape
        return self.radiance.reshape(n, n_lines * n_nodes)


@dataclass(frozen=True, slots=True)
class Radiance:
    """L_k of one bounce for a scattering coefficient of one per mm, over exp(log_scale).

    Attributes
    ----------
    parts : the directions and their radiance, overwritten by the next bounce
    fluence : (n_y, n_x), the integral over direction
    log_scale : its exponential is taken out, so that no order over- or underflows
    fewer : of bounce 2, if summed over more directions than the grid's, the fluence by these alone
    """

    grid: Grid
    parts: tuple[Part, Part]
    fluence: Array
    log_scale: float
    fewer: Array | None = None

    def light_field(self, weight: float, out: Array) -> None:
        """Write weight * L_k, its scale still taken out, into out (n_theta, n_y, n_x)."""
        for part in self.parts:
            lines = _transposed(part.radiance) if part.of_x else part.radiance
            for n, light in zip(part.index, lines, strict=True):
                np.multiply(light, weight, out=out[n])


def solve_on(
    medium: Medium,
    beam: Beam,
    grid: Grid,
    *,
    n_bounces: int,
    light_field: bool = True,
    dtype: DType = np.float64,
    second_times: int = 1,
    negligible: float = NEGLIGIBLE,
) -> BounceField:
    """Return bounces 1 .. n_bounces on a given grid; `transport.solve.solve` chooses one.

    ``second_times`` and ``negligible`` are those of `march`. If there are several times,
    ``error_estimate`` tells how much they changed bounce 2, relative to it; what is not known is
    NaN.

    Raises
    ------
    AnalysisError
        As `march` does, or if an order is too large for a number.
    """
    fluence = np.empty((n_bounces, grid.n_y, grid.n_x))
    # Direction after direction in memory, as they are swept.
    shape = (n_bounces - 1, grid.n_theta, grid.n_y, grid.n_x)
    field = np.empty(shape, dtype=dtype) if light_field else None
    fluence[0] = ballistic_fluence(
        grid.x_mm, grid.y_mm, sigma_t_per_mm=medium.sigma_t_per_mm, beam=beam
    )
    error = np.full(n_bounces, np.nan)
    marching = march(
        medium,
        beam,
        grid,
        n_bounces=n_bounces,
        dtype=dtype,
        second_times=second_times,
        negligible=negligible,
    )
    for k, radiance in enumerate(marching, start=2):
        weight = bounce_weight(medium, k, radiance.log_scale)
        np.multiply(radiance.fluence.astype(np.float64), weight, out=fluence[k - 1])
        if field is not None:
            radiance.light_field(weight, field[k - 2])
        if radiance.fewer is not None:
            error[1] = relative_error(radiance.fewer, radiance.fluence)
    return BounceField(
        medium=medium,
        beam=beam,
        grid=grid,
        fluence=fluence,
        light_field=None if field is None else np.moveaxis(field, 1, -1),
        engine="ordinates",
        error_estimate=error if second_times > 1 else None,
    )


def bounce_weight(medium: Medium, k: int, log_scale: float) -> float:
    """Return what makes bounce k of this medium from a normalised radiance.

    Raises
    ------
    AnalysisError
        If the order is too large for a number, which takes a medium with gain.
    """
    if medium.sigma_s_per_mm == 0.0:
        return 0.0
    power = (k - 1) * math.log(medium.sigma_s_per_mm) + log_scale
    if power > LARGEST:
        msg = f"bounce {k} exceeds the largest number there is; ask for fewer orders."
        raise AnalysisError(msg)
    return math.exp(power)


def march(
    medium: Medium,
    beam: Beam,
    grid: Grid,
    *,
    n_bounces: int,
    dtype: DType = np.float64,
    second_times: int = 1,
    negligible: float = NEGLIGIBLE,
) -> Iterator[Radiance]:
    """Yield L_k of bounces k = 2 .. n_bounces for a scattering coefficient of one.

    ``w . grad L_k + sigma_t L_k = integral p(theta - theta') L_(k-1)(theta') dtheta'``
    with black walls; the true L_k is sigma_s^(k-1) times as much. In single precision (``dtype``)
    all but the closed form is; rounding then costs about 1e-6 of the brightest.

    L_2 has kinks over direction that later bounces have no more: its fluence, and what it feeds
    to the third bounce, are summed over ``second_times`` (odd) as many directions as the grid has.
    Moments of the phase function below a ``negligible`` share of the first scatter nothing.

    Raises
    ------
    AnalysisError
        If the beam misses the tank's face, or the angles cannot resolve the phase function
        (g^(n_theta/2) above one percent).
    """
    beam = beam.entering(grid.tank)
    if n_bounces < 2:
        return
    unresolved = abs(medium.g) ** (grid.n_theta // 2)
    if unresolved > UNRESOLVED:
        msg = (
            f"{grid.n_theta} angles cannot resolve g = {medium.g} "
            f"(|g|^(n/2) = {unresolved:.2g} > {UNRESOLVED}); use more angles."
        )
        raise AnalysisError(msg)
    parts, fewer = _parts(medium, grid, dtype, negligible), None
    with on_one_thread():
        moments = _together([part.light_from(medium, beam, grid) for part in parts])
        if second_times > 1:
            fewer = moments[0].copy()
            moments += _second_between(medium, beam, grid, second_times, dtype, negligible)
            moments /= second_times
    log_scale = 0.0
    for k in range(2, n_bounces + 1):
        fluence = moments[0].copy()
        yield Radiance(grid, parts, fluence, log_scale, fewer if k == 2 else None)
        if k == n_bounces:
            return
        brightest = float(fluence.max()) or 1.0
        log_scale += math.log(brightest)
        t = medium.sigma_t_per_mm
        with on_one_thread():
            moments = _together([part.scatter(moments, 1.0 / brightest, t) for part in parts])


def second_fluence(medium: Medium, beam: Beam, grid: Grid, theta_rad: Array) -> Array:
    """Return the fluence of the second bounce, (n_y, n_x), summed over equal steps of direction.

    In closed form at every node and direction, for a scattering coefficient of one.
    """
    beam = beam.entering(grid.tank)
    one = np.full((1, theta_rad.size), 2.0 * np.pi / theta_rad.size)
    with on_one_thread():
        return np.asarray(_second_moments(medium, beam, grid, theta_rad, one)[0])


def _second_between(
    medium: Medium, beam: Beam, grid: Grid, times: int, dtype: DType, negligible: float
) -> Array:
    """Return moments of L_2, (r, n_y, n_x), over the directions between those of the grid."""
    n_theta = grid.n_theta
    theta_rad = equal_angles(times * n_theta)[np.arange(times * n_theta) % times != times // 2]
    basis, _ = scattering_moments(
        medium.g, medium.phase, theta_rad, n_orders=n_theta // 2, negligible=negligible
    )
    to_moments: Array = (basis * (2.0 * np.pi / n_theta)).astype(dtype)
    return _second_moments(medium, beam, grid, theta_rad, to_moments)


def _second_moments(
    medium: Medium, beam: Beam, grid: Grid, theta_rad: Array, to_moments: Array
) -> Array:
    """Return to_moments (r, n) times L_2 of n directions at every node, (r, n_y, n_x)."""
    dtype, t = to_moments.dtype, medium.sigma_t_per_mm
    weight = _weight(medium, beam, theta_rad)
    total = np.zeros((to_moments.shape[0], grid.n_y * grid.n_x), dtype=dtype)
    buffer = np.empty((BLOCK, grid.n_y, grid.n_x), dtype=dtype)
    for first in range(0, theta_rad.size, BLOCK):
        some = slice(first, min(first + BLOCK, theta_rad.size))
        light = buffer[: some.stop - first]
        second_bounce(grid, beam, theta_rad[some], sigma_t_per_mm=t, weight=weight[some], out=light)
        total += to_moments[:, some] @ light.reshape(light.shape[0], -1)
    return total.reshape(-1, grid.n_y, grid.n_x)


def _weight(medium: Medium, beam: Beam, theta_rad: Array) -> Array:
    """Return the share of the beam that is scattered into each direction, per radian."""
    return phase_function(theta_rad - math.radians(beam.angle_deg), medium.g, medium.phase)


def _together(moments: list[Array]) -> Array:
    """Return the sum of the moments of both parts, (r, n_y, n_x)."""
    of_x, of_y = moments
    of_y += _transposed(of_x)
    return of_y


def _transposed(planes: Array) -> Array:
    return planes.transpose(0, 2, 1)


def _parts(medium: Medium, grid: Grid, dtype: DType, negligible: float) -> tuple[Part, Part]:
    """Part the directions of a grid, and the moments that scattering weighs with them."""
    theta = grid.theta_rad
    basis, weights = scattering_moments(
        medium.g, medium.phase, theta, n_orders=grid.n_theta // 2, negligible=negligible
    )
    cos_t, sin_t = np.cos(theta), np.sin(theta)
    along_x = np.abs(cos_t) * grid.cell_y_mm >= np.abs(sin_t) * grid.cell_x_mm

    def part(of_x: bool) -> Part:
        index = np.flatnonzero(along_x == of_x)
        shape, pitch = (grid.n_y, grid.n_x), (grid.cell_y_mm, grid.cell_x_mm)
        across, along = sin_t[index], cos_t[index]
        if of_x:
            shape, pitch, across, along = shape[::-1], pitch[::-1], along, across
        return Part(
            of_x=of_x,
            index=index,
            theta_rad=theta[index],
            across=across,
            along=along,
            pitch_mm=pitch,
            to_moments=(basis[:, index] * (2.0 * np.pi / grid.n_theta)).astype(dtype),
            to_source=np.ascontiguousarray((basis[:, index] * weights[:, None]).T, dtype=dtype),
            radiance=np.empty((index.size, *shape), dtype=dtype),
        )

    return part(True), part(False)
