"""Bounce-tagged Monte Carlo: the independent route to every order, and the light of simulations.

Paths start on the lit face, are forced to collide inside the tank, and score their expected
fluence along each whole ray (Eqs. 1, 3). The first steps of a path follow a randomly shifted
lattice, which leaves the expectation exact and takes most of the noise from the low orders.
Independent batches give standard errors that are true.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.errors import AnalysisError
from analysis.medium import Beam, Medium, Tank
from analysis.phase_function import power_removed
from analysis.transport.montecarlo_kernels import Array, follow

Density = tuple[Array, Array, Array]

N_BATCHES = 16
FIRST_PATHS = 256  # of each batch, before its noise is first looked at
LARGEST_STEP = 8.0  # by which the number of paths grows on the word of that noise
N_LATTICE = 5  # dimensions of the lattice: the entry, then two for each bounce
N_PSI = 8193  # nodes of the tabulated hg-paper, whose error is then below 1e-8


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledField:
    """Cell averages of scattered light, with standard errors.

    Attributes
    ----------
    fluence, std_error : (K - 1, n_y, n_x), phi_k of bounces k = 2 .. K with sigma_s^(k-1)
        applied, for the irradiance of the beam (one, if it has no profile)
    modulated : (n_harmonics, n_y, n_x), complex; the sum of bounces 2 .. K under light entering
        as exp(i h q y), divided by exp(i h q (y - x tan(theta_0))), which is how the beam would
        carry it to where it is seen; one for each harmonic h
    radiance, radiance_std_error : (n_chosen, n_y, n_x, n_theta), per radian, averaged over the
        cell and the angle bin, for the bounces chosen
    x_mm, y_mm : cell centres
    theta_rad : (n_theta,), centres of the angle bins, 2 pi (n + 1/2) / n_theta
    n_paths : paths followed
    """

    fluence: Array
    std_error: Array
    modulated: NDArray[np.complex128]
    radiance: Array
    radiance_std_error: Array
    x_mm: Array
    y_mm: Array
    theta_rad: Array
    n_paths: int

    def relative_noise(self) -> Array:
        """Return each order's rms of std_error / fluence in cells above 1 % of its maximum."""
        return relative_noise(self.fluence, self.std_error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Walls:
    """What makes a tank other than black, and its stripes less sharp with depth.

    Attributes
    ----------
    face_index : refractive index of the medium at the lit face, whose other side is air
    reflectance : of the other walls, which are mirrors
    blur_mm, growth : standard deviation of the stripes' blur at the face, and per mm of depth
    """

    face_index: float = 1.0
    reflectance: float = 0.0
    blur_mm: float = 0.0
    growth: float = 0.0


def simulate(
    medium: Medium,
    tank: Tank,
    beam: Beam,
    *,
    n_bounces: int,
    n_paths: int,
    cell_mm: float,
    seed: int,
    stripe_wavenumber_per_mm: float = 0.0,
    harmonics: tuple[int, ...] = (),
    angular_bounces: tuple[int, ...] = (),
    n_theta: int = 64,
    until_std_error: float | None = None,
    walls: Walls | None = None,
    n_threads: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> SampledField:
    """Follow ``n_paths`` paths through ``n_bounces`` bounces.

    Parameters
    ----------
    stripe_wavenumber_per_mm : 2 pi / period of stripes along y
    harmonics : ascending multiples of it whose modulation is wanted
    angular_bounces : bounces whose radiance is wanted in ``n_theta`` angle bins
    until_std_error : stop once the relative noise of every order is below this; ``n_paths`` is
        then the most that are followed. The answer is the one that this number of paths gives
    walls : what gives light back, and a blur that grows; None for black walls and even stripes
    progress : called with (batches done, batches in all), from the start in each round

    Raises
    ------
    AnalysisError
        If the beam leaves the face, the literal phase function has no integral (|g| = 1), a
        bounce is not there, or a number is too small.

    Notes
    -----
    With ``hg-paper`` a bounce multiplies the weight by its integral N3(g), so weights may grow;
    roulette then lets every path live. The noise is that of sixteen batches, so a standard error
    is itself known to 18 %. They are held until the end: an angular field takes 128 bytes for
    each bounce, cell and bin.
    """
    _refuse(medium, n_bounces, n_paths, cell_mm, angular_bounces, n_theta)
    if walls is not None and angular_bounces:
        msg = "the light field of a tank that is not black is not sampled; ask for none."
        raise AnalysisError(msg)
    if until_std_error is not None and not until_std_error > 0.0:
        msg = f"until_std_error = {until_std_error}: the noise asked for must be positive."
        raise AnalysisError(msg)
    beam = beam.entering(tank)
    n_x = max(1, round(tank.depth_mm / cell_mm))
    n_y = max(1, round(tank.width_mm / cell_mm))
    batches = [
        _Batch(
            medium,
            tank,
            beam,
            seed=[seed, number],
            shape=(n_bounces - 1, n_y, n_x),
            wavenumber_per_mm=stripe_wavenumber_per_mm,
            harmonics=harmonics,
            angular_bounces=angular_bounces,
            n_theta=n_theta,
            walls=walls,
        )
        for number in range(N_BATCHES)
    ]
    most = n_paths // N_BATCHES
    n_batch = most if until_std_error is None else min(most, FIRST_PATHS)
    while True:
        _run_all(batches, n_batch, n_threads, progress)
        fluence, std_error = mean_and_error([batch.scores for batch in batches])
        if until_std_error is None or n_batch == most:
            break
        excess = float(relative_noise(fluence, std_error).max()) / until_std_error
        if excess <= 1.0:
            break
        n_batch = min(most, math.ceil(n_batch * min(1.1 * excess**2, LARGEST_STEP)))

    y_points, irradiance = beam.profile_points()
    # Irradiance is counted across the beam: a slanted one brings its cosine to the face.
    power = float(np.trapezoid(irradiance, y_points)) * math.cos(math.radians(beam.angle_deg))
    weight = power / (n_batch * (tank.depth_mm / n_x) * (tank.width_mm / n_y))
    radiance, radiance_error = mean_and_error([batch.lobes for batch in batches])
    per_bin = weight * n_theta / (2.0 * math.pi)
    return SampledField(
        fluence=weight * fluence,
        std_error=weight * std_error,
        modulated=weight * np.moveaxis(np.mean([batch.modulated for batch in batches], 0), -1, 0),
        radiance=per_bin * np.moveaxis(radiance, 1, -1),
        radiance_std_error=per_bin * np.moveaxis(radiance_error, 1, -1),
        x_mm=(np.arange(n_x) + 0.5) * tank.depth_mm / n_x,
        y_mm=(np.arange(n_y) + 0.5) * tank.width_mm / n_y,
        theta_rad=2.0 * math.pi * (np.arange(n_theta) + 0.5) / n_theta,
        n_paths=n_batch * N_BATCHES,
    )


def _refuse(
    medium: Medium,
    n_bounces: int,
    n_paths: int,
    cell_mm: float,
    angular_bounces: tuple[int, ...],
    n_theta: int,
) -> None:
    """Raise what `simulate` cannot answer."""
    msg = ""
    if medium.phase == "hg-paper" and abs(medium.g) == 1.0:
        msg = f"hg-paper has no integral at g = {medium.g}; choose hg-plane or |g| < 1."
    elif n_bounces < 2 or n_paths < N_BATCHES:
        msg = f"{n_paths} paths of {n_bounces} bounces: at least {N_BATCHES} paths of 2 are needed."
    elif not (math.isfinite(cell_mm) and cell_mm > 0.0):
        msg = f"cell_mm = {cell_mm}: the cell must be a positive length."
    elif any(not 2 <= bounce <= n_bounces for bounce in angular_bounces):
        msg = f"angular_bounces = {angular_bounces}: choose among bounces 2 to {n_bounces}."
    elif n_theta < 1:
        msg = f"n_theta = {n_theta}: at least one angle bin is needed."
    if msg:
        raise AnalysisError(msg)


class _Batch:
    """A stream of paths of its own, which can be taken further at any time."""

    def __init__(
        self,
        medium: Medium,
        tank: Tank,
        beam: Beam,
        *,
        seed: list[int],
        shape: tuple[int, int, int],
        wavenumber_per_mm: float,
        harmonics: tuple[int, ...],
        angular_bounces: tuple[int, ...],
        n_theta: int,
        walls: Walls | None,
    ) -> None:
        n_orders, n_y, n_x = shape
        power = power_removed(medium.g, medium.phase)
        self._medium = np.array(
            [medium.sigma_t_per_mm, medium.sigma_s_per_mm, medium.g, power], dtype=np.float64
        )
        self._tank = np.array([tank.depth_mm, tank.width_mm], dtype=np.float64)
        self._angle = math.radians(beam.angle_deg)
        self._entry = with_cumulative(*beam.profile_points())
        self._stretched = _stretched_phase_function(medium)
        self._rng = np.random.default_rng(seed)
        self._shift = self._rng.random(N_LATTICE)
        self._wavenumber = wavenumber_per_mm
        self._harmonics = np.asarray(harmonics, dtype=np.int64)
        self._slots = np.full(n_orders, -1, dtype=np.int64)
        self._slots[np.asarray(angular_bounces, dtype=np.int64) - 2] = range(len(angular_bounces))
        self._walls = walls
        self._n_done = 0
        self.scores = np.zeros(shape)
        self.lobes = np.zeros((len(angular_bounces), n_theta, n_y, n_x))
        self.modulated = np.zeros((n_y, n_x, len(harmonics)), dtype=np.complex128)

    def run_to(self, n_paths: int) -> None:
        """Follow the paths up to number ``n_paths``, as if they had been asked for at once."""
        if self._walls is not None:
            self._fold_to(n_paths, self._walls)
            return
        follow(
            self._medium,
            self._tank,
            self._angle,
            self._entry,
            self._stretched,
            (self._n_done, n_paths),
            self._rng,
            self._shift,
            lattice_steps(N_LATTICE),
            self._wavenumber,
            self._harmonics,
            self._slots,
            self.scores,
            self.lobes,
            self.modulated,
        )
        self._n_done = n_paths

    def _fold_to(self, n_paths: int, walls: Walls) -> None:
        from analysis.transport.montecarlo_folded import follow_folded  # noqa: PLC0415 - rare

        follow_folded(
            self._medium,
            self._tank,
            np.array([walls.face_index, walls.reflectance], dtype=np.float64),
            np.array([walls.blur_mm, walls.growth], dtype=np.float64),
            self._angle,
            self._entry,
            self._stretched,
            (self._n_done, n_paths),
            self._rng,
            self._shift,
            lattice_steps(N_LATTICE),
            self._wavenumber,
            self._harmonics,
            self.scores,
            self.modulated,
        )
        self._n_done = n_paths


def _run_all(
    batches: list[_Batch],
    n_paths: int,
    n_threads: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Take every batch to ``n_paths``; each has its own numbers, whatever the threads."""
    with ThreadPoolExecutor(n_threads) as pool:
        runs = [pool.submit(batch.run_to, n_paths) for batch in batches]
        try:
            for done, finished in enumerate(as_completed(runs), start=1):
                finished.result()
                if progress is not None:
                    progress(done, N_BATCHES)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Ctrl-C need not wait for all batches
            raise


def mean_and_error(scores: list[Array]) -> tuple[Array, Array]:
    """Return mean and standard error over the batches, of the shape of one."""
    mean = np.mean(scores, axis=0)
    squares = np.zeros_like(mean)
    for batch in scores:
        squares += (batch - mean) ** 2
    return mean, np.sqrt(squares / ((len(scores) - 1) * len(scores)))


def relative_noise(fluence: Array, std_error: Array) -> Array:
    """Return the rms of std_error / fluence in cells above 1 % of each order's maximum, (n,)."""
    bright = fluence > 1e-2 * fluence.max(axis=(1, 2), keepdims=True)
    ratio = np.divide(std_error, fluence, out=np.zeros_like(fluence), where=bright)
    count = np.maximum(bright.sum(axis=(1, 2)), 1)
    return np.asarray(np.sqrt((ratio**2).sum(axis=(1, 2)) / count))


def with_cumulative(nodes: Array, density: Array) -> Density:
    """Return what `draw` needs of a piecewise-linear density: it and its share up to each node."""
    pieces = 0.5 * (density[1:] + density[:-1]) * np.diff(nodes)
    cumulative = np.concatenate([[0.0], np.cumsum(pieces)])
    return (
        np.ascontiguousarray(nodes),
        np.ascontiguousarray(density),
        np.asarray(cumulative / cumulative[-1]),
    )


def _stretched_phase_function(medium: Medium) -> Density:
    """Return the density of the angle psi of `deflect`; empty for hg-plane, where it is uniform.

    Notes
    -----
    Eq. 2 has the exponent 3/2, and in psi becomes sqrt(cos^2 + k'^2 sin^2), k' = (1-|g|)/(1+|g|),
    between -pi/2 and pi/2: its integral is the elliptic E, and no peak is left to be resolved.
    """
    if medium.phase == "hg-plane":
        return np.empty(0), np.empty(0), np.empty(0)
    psi = np.linspace(-0.5 * math.pi, 0.5 * math.pi, N_PSI)
    narrow = (1.0 - abs(medium.g)) / (1.0 + abs(medium.g))
    return with_cumulative(psi, np.hypot(np.cos(psi), narrow * np.sin(psi)))


def lattice_steps(n_dimensions: int) -> Array:
    """Return the steps of the additive recurrence built on the generalised golden ratio."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (n_dimensions + 1))
    return np.asarray((1.0 / ratio) ** np.arange(1, n_dimensions + 1))
