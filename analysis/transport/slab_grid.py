"""Where a slab's light is calculated: depths, polynomials over the height, directions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from analysis.errors import AnalysisError
from analysis.phase_function import Array

FINE_BEARINGS = 384  # polar angles, and twice the azimuths, that are sorted by bearing


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabGrid:
    """Depths, polynomials and directions; directions with mu_y < 0 follow from symmetry.

    Directions are counted from the beam: mu_x = cos(theta), mu_z = sin(theta) cos(phi), mu_y =
    sin(theta) sin(phi). Azimuths phi in 0 .. pi are the surface's mirror images of one another.
    They crowd around pi / 2, where light goes along the layer: the thinner that is, the narrower
    is the fan of directions in which light gets far.

    Attributes
    ----------
    x_mm : (n_x,), rising from zero to the far wall
    n_z : Legendre polynomials over the height
    theta_rad, weight : (n_theta,), polar angles and what they weigh of d mu_x
    n_phi : azimuths in 0 .. pi, an even number
    level : crowding of the azimuths, 0 .. 1: their spacing along the layer is less by this share
    degree : up to which scattering is expanded in spherical harmonics
    n_second : polar angles of the closed second order, see `second_order`
    """

    x_mm: Array
    n_z: int
    theta_rad: Array
    weight: Array
    n_phi: int
    degree: int
    n_second: int = 0
    level: float = 0.0

    def __post_init__(self) -> None:
        if self.x_mm.size < 8 or self.n_z < 2 or self.n_phi < 2 or self.n_phi % 2:
            msg = (
                f"{self.x_mm.size} depths, {self.n_z} polynomials, {self.n_phi} azimuths: at "
                "least 8, 2 and 2 are needed, azimuths an even number."
            )
            raise AnalysisError(msg)

    @property
    def n_directions(self) -> int:
        """Directions of the whole sphere."""
        return 2 * self.n_phi * self.theta_rad.size

    def work(self, n_bounces: int, *, striped: bool) -> float:
        """Return what bounces cost, in multiples of one step of one ray at one height.

        Within a third of the processor's time from g = 0.4 to 0.9, white and striped.
        """
        n_modes = self.n_z if striped else (self.n_z + 1) // 2
        rays = self.n_phi * self.theta_rad.size * n_modes * self.x_mm.size
        second = 66.0 * self.n_second**2 * self.x_mm.size
        return rays * (2.0 * self.n_z + 6.0) * (n_bounces + 1.0) + second

    @property
    def memory_bytes(self) -> float:
        """What a solution under stripes takes."""
        return 128.0 * self.n_phi * self.theta_rad.size * self.n_z * self.x_mm.size

    @property
    def phi_rad(self) -> Array:
        """Azimuths, (n_phi,)."""
        return self._crowded(np.pi * (np.arange(self.n_phi) + 0.5) / self.n_phi)

    @property
    def phi_weight(self) -> Array:
        """What each azimuth weighs of 0 .. pi, (n_phi,); they add up to one."""
        even = np.pi * (np.arange(self.n_phi) + 0.5) / self.n_phi
        return np.asarray((1.0 + self.level * np.cos(2.0 * even)) / self.n_phi)

    def _crowded(self, even: Array) -> Array:
        return np.asarray(even + 0.5 * self.level * np.sin(2.0 * even))

    @property
    def cosines(self) -> tuple[Array, Array, Array]:
        """mu_x (1, n_theta), mu_y and mu_z (n_phi, n_theta)."""
        aside = np.sin(self.theta_rad)
        return (
            np.cos(self.theta_rad)[None, :],
            np.sin(self.phi_rad)[:, None] * aside,
            np.cos(self.phi_rad)[:, None] * aside,
        )

    @property
    def up_edges(self) -> tuple[Array, Array]:
        """Edges of the cells of azimuth and polar angle of the directions that go up.

        (n_phi / 2 + 1,) and (n_theta + 1,).
        """
        between = 0.5 * (self.theta_rad[1:] + self.theta_rad[:-1])
        phi = self._crowded(np.linspace(0.0, 0.5 * np.pi, self.n_phi // 2 + 1))
        return phi, np.concatenate([[0.0], between, [np.pi]])


def polar_angles(n_forward: int, n_backward: int, crowding: float) -> tuple[Array, Array]:
    """Return polar angles and weights of d mu; those ahead crowd towards the beam.

    Gaussian nodes in t with theta = pi/2 t^crowding ahead, even in theta behind. No direction lies
    along the face, where radiance jumps.
    """
    node, weight = np.polynomial.legendre.leggauss(n_forward)
    t = 0.5 * (node + 1.0)
    ahead = 0.5 * math.pi * t**crowding
    by_ahead = 0.25 * math.pi * crowding * t ** (crowding - 1.0) * weight
    node, weight = np.polynomial.legendre.leggauss(n_backward)
    behind = 0.5 * math.pi * (1.0 + 0.5 * (node + 1.0))
    theta = np.concatenate([ahead, behind])
    return theta, np.concatenate([by_ahead, 0.25 * math.pi * weight]) * np.sin(theta)


def bearings_of(grid: SlabGrid, n_bearings: int) -> Array:
    """Return what each direction with mu_y > 0 gives to each bearing, per radian of bearing.

    Radiance is taken to be cubic between the polar angles ahead and between those behind, and
    linear between the azimuths; no light is made or lost.

    Returns
    -------
    (n_bearings, n_phi, n_theta)
    """
    shape = (n_bearings, grid.n_phi, grid.theta_rad.size)
    if n_bearings == 0:
        return np.zeros(shape)
    theta = np.pi * (np.arange(FINE_BEARINGS) + 0.5) / FINE_BEARINGS
    phi = np.pi * (np.arange(FINE_BEARINGS // 2) + 0.5) / (FINE_BEARINGS // 2)
    by_theta = _between(grid.theta_rad, theta)
    by_phi = np.array([np.interp(phi, grid.phi_rad, row) for row in np.eye(shape[1])])
    at = np.arctan2(np.sin(theta) * np.sin(phi)[:, None], np.cos(theta))
    place = np.floor(at / (2.0 * np.pi) * n_bearings).astype(np.int64)
    area = np.broadcast_to(np.sin(theta), place.shape)
    found = np.zeros(shape)
    for n in np.unique(place):
        found[n] = by_phi @ np.where(place == n, area, 0.0) @ by_theta.T
    whole = 2.0 * np.pi * np.outer(grid.phi_weight, grid.weight)  # both halves of y together
    # A direction whose neighbours are nearer than the sorting is fine has one bearing alone.
    _, mu_y, _ = grid.cosines
    own = np.arctan2(mu_y, np.cos(grid.theta_rad)) / (2.0 * np.pi) * n_bearings
    alone = found.sum(axis=0) == 0.0
    found[np.floor(own[alone]).astype(np.int64), alone] = 1.0
    found *= 0.5 * whole / found.sum(axis=0)
    return found * n_bearings / (2.0 * np.pi)


def _between(theta_rad: Array, at_rad: Array) -> Array:
    """Return what each polar angle's radiance is worth at others, (n_theta, n).

    Linear pieces would give the last angles before and behind the face's own, which are Gaussian,
    a fifth too much room.
    """
    found = np.zeros((theta_rad.size, at_rad.size))
    for of, there in zip(
        (theta_rad < 0.5 * np.pi, theta_rad > 0.5 * np.pi),
        (at_rad < 0.5 * np.pi, at_rad >= 0.5 * np.pi),
        strict=True,
    ):
        spline = CubicSpline(theta_rad[of], np.eye(int(of.sum())))
        found[np.ix_(of, there)] = spline(at_rad[there]).T
    return found


def graded_depths(depth_mm: float, n_x: int, *, finest_mm: float, coarsest_mm: float) -> Array:
    """Return depths whose spacing grows with depth until it is even.

    The spacing is proportional to (x + f) / (1 + x / c): f and c are the lengths over which light
    changes at the face and far from it.
    """
    x = np.concatenate([[0.0], np.geomspace(1e-4 * finest_mm, depth_mm, 2000)])
    count = np.log1p(x / finest_mm) + x / coarsest_mm
    found = np.interp(np.linspace(0.0, count[-1], n_x), count, x)
    found[-1] = depth_mm
    return np.asarray(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scattering:
    """The scattering integral over the directions of a grid, by azimuth and by Legendre sums.

    The share f = g^(degree + 1) of the light goes on unscattered (delta splitting), so that the
    moments kept, g^l - f, fall to zero smoothly. Moments are exact.

    Attributes
    ----------
    cosine, sine : (n_m, n_phi), the azimuthal functions
    to_cosine, to_sine : (n_m, n_phi), to the moments of the even and the odd part
    legendre : (n_m, n_theta, n_theta), what is scattered from one polar angle to another
    camera : (n_m n_theta,), from the even moments to the direction of the camera, +z
    share_ahead : f
    """

    cosine: Array
    sine: Array
    to_cosine: Array
    to_sine: Array
    legendre: Array
    camera: Array
    share_ahead: float

    @classmethod
    def of(cls, g: float, grid: SlabGrid) -> Scattering:
        """Return the integral for an asymmetry g."""
        n_m = min(grid.degree, grid.n_phi - 1) + 1
        m = np.arange(n_m)[:, None]
        twice = np.where(m, 2.0, 1.0) * grid.phi_weight
        ahead = g ** (grid.degree + 1)
        moments = g ** np.arange(grid.degree + 1, dtype=np.float64) - ahead
        mu = np.append(np.cos(grid.theta_rad), 0.0)
        legendre = np.zeros((n_m, grid.theta_rad.size, grid.theta_rad.size))
        camera = np.zeros((n_m, grid.theta_rad.size))
        for order in range(n_m):
            basis = normalised_legendre(grid.degree, order, mu)
            into = (basis[:, :-1] * grid.weight) * moments[order:, None]
            legendre[order] = basis[:, :-1].T @ into
            camera[order] = basis[:, -1] @ into
        cosine, sine = np.cos(m * grid.phi_rad), np.sin(m * grid.phi_rad)
        return cls(
            cosine=cosine,
            sine=sine,
            to_cosine=cosine * twice,
            to_sine=sine * twice,
            legendre=legendre,
            camera=camera.ravel(),
            share_ahead=float(ahead),
        )


def normalised_legendre(degree: int, order: int, mu: Array) -> Array:
    """Return associated Legendre functions of l = order .. degree whose squares integrate to one.

    (degree - order + 1, n), by the recurrence in l, which is stable.
    """
    scale = 0.5
    for m in range(1, order + 1):
        scale *= (2.0 * m + 1.0) / (2.0 * m)
    found = [np.asarray(math.sqrt(scale) * (1.0 - mu * mu) ** (0.5 * order))]
    if degree > order:
        found.append(math.sqrt(2.0 * order + 3.0) * mu * found[0])
    for n in range(order + 2, degree + 1):
        a = math.sqrt((4.0 * n * n - 1.0) / (n * n - order * order))
        b = math.sqrt(((n - 1.0) ** 2 - order**2) / (4.0 * (n - 1.0) ** 2 - 1.0))
        found.append(a * (mu * found[-1] - b * found[-2]))
    return np.array(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """Transport over the height, in Legendre polynomials P_l(2 z / h - 1): upwind Galerkin.

    ``mu_z dL/dz`` with nothing entering at the floor is ``mu_z D c`` on the coefficients c of L.
    Its eigenvectors turn the layer into independent depths, each with an extinction larger by
    mu_z times an eigenvalue. Downgoing light is the same from the surface's point of view.

    Attributes
    ----------
    slope : (n_z, n_z), D, 1/mm
    eigenvalue : (n_z,), 1/mm
    from_modes, to_modes : (n_z, n_z)
    inflow : (n_z,), what light entering at the floor adds to dc/dz, 1/mm
    """

    slope: Array
    eigenvalue: NDArray[np.complex128]
    from_modes: NDArray[np.complex128]
    to_modes: NDArray[np.complex128]
    inflow: Array

    @classmethod
    def of(cls, height_mm: float, n_z: int) -> Height:
        """Return the operators of a height and a number of polynomials."""
        degree = np.arange(n_z)
        sign = (-1.0) ** degree
        lag = degree[None, :] - degree[:, None]
        rises = np.where((lag > 0) & (lag % 2 == 1), 2.0, 0.0)
        slope = (2.0 * degree[:, None] + 1.0) / height_mm * (rises + np.outer(sign, sign))
        eigenvalue, vectors = np.linalg.eig(slope)
        return cls(
            slope=slope,
            eigenvalue=eigenvalue.astype(np.complex128),
            from_modes=vectors.astype(np.complex128),
            to_modes=np.linalg.inv(vectors).astype(np.complex128),
            inflow=(2.0 * degree + 1.0) * sign / height_mm,
        )

    def of_real(self) -> Height:
        """Return the operators for real light: one mode of each conjugate pair, counted twice."""
        one = self.eigenvalue.imag >= 0.0
        twice = np.where(self.eigenvalue.imag[one] > 0.0, 2.0, 1.0)
        return Height(
            slope=self.slope,
            eigenvalue=self.eigenvalue[one],
            from_modes=np.ascontiguousarray(self.from_modes[:, one] * twice),
            to_modes=np.ascontiguousarray(self.to_modes[one]),
            inflow=self.inflow,
        )


def camera_weights(height_mm: float, sigma_t_per_mm: float, n_z: int) -> Array:
    """Return what each polynomial's light is worth to the camera, the first one's being one.

    The mean of P_l over the height, weighed by exp(-sigma_t (h - z)).
    """
    node, weight = np.polynomial.legendre.leggauss(n_z + 16)
    left = weight * np.exp(-0.5 * sigma_t_per_mm * height_mm * (node[-1] - node))
    values = np.polynomial.legendre.legvander(node, n_z - 1)
    return np.asarray(left @ values / left.sum())
