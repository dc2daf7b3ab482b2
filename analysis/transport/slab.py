"""Every bounce in a thin layer of liquid seen from above, under uniform or striped light.

The real tank: light along +x, uniform over the height, escapes through the surface and is
swallowed by the floor. Stripes exp(i q y) keep their form at every order, so that transport is in
depth and height with the complex extinction sigma_t + i q mu_y. All orders are for an albedo of
one; order k at another albedo is albedo^(k-1) times that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.medium import Medium, Slab
from analysis.phase_function import Array, phase_function
from analysis.transport.blas import BLAS
from analysis.transport.fresnel import reflectance
from analysis.transport.plane import carry, node_steps
from analysis.transport.slab_grid import Height, Scattering, SlabGrid, camera_weights
from analysis.transport.slab_second import second_order

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabField:
    """Orders of a slab against depth, for an albedo of one, times exp(sigma_t x).

    Attributes
    ----------
    camera : (K, n_x), what the camera sees of bounces 1 .. K, A_1 = 1
    fluence : (K, n_x), mean over the height
    ratio : A_K / A_(K-1) where both are brightest; later bounces go on with it
    """

    grid: SlabGrid
    sigma_t_per_mm: float
    camera: Array
    fluence: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rays:
    """What every ray keeps and gathers, for the half of the azimuths that goes up."""

    height: Height
    forward: NDArray[np.bool_]
    left: ComplexArray
    share: ComplexArray
    climb: Array
    mirror: Array


def solve_slab(
    medium: Medium,
    slab: Slab,
    grid: SlabGrid,
    *,
    n_bounces: int,
    wavenumber_per_mm: float = 0.0,
) -> SlabField:
    """Return bounces 1 .. n_bounces of light that enters as exp(i q y) along +x.

    ``mu_x dL/dx + mu_z dL/dz + (sigma_t + i q mu_y) L_k = sigma_s int p(Omega . Omega') L_(k-1)``
    with Eq. 2 on the sphere, nothing entering at x = 0, at the far wall and at the floor, and
    ``L(-mu_z) = R(mu_z) L(mu_z)`` at the surface. The medium's ``phase``, which is about
    flatland, and its sigma_s are not looked at.
    """
    sigma_t = medium.sigma_t_per_mm
    scattering = Scattering.of(medium.g, grid)
    rays = _rays(medium, slab, grid, wavenumber_per_mm)
    seen = camera_weights(slab.height_mm, sigma_t, grid.n_z)
    across = float(phase_function(np.array(0.5 * np.pi), medium.g, "hg-paper"))
    upward = np.linalg.inv(sigma_t * np.eye(grid.n_z) + rays.height.slope)
    second = second_order(grid.x_mm, medium, slab, wavenumber_per_mm=wavenumber_per_mm)
    camera, fluence = [np.ones(grid.x_mm.size), second], [np.ones(grid.x_mm.size)]
    source = np.zeros((grid.n_phi, grid.theta_rad.size, grid.n_z, grid.x_mm.size), np.complex128)
    source[:, :, 0] = sigma_t * phase_function(grid.theta_rad, medium.g, "hg-paper")[:, None]
    to_camera = np.zeros((grid.n_z, grid.x_mm.size))
    to_camera[0] = sigma_t * across
    watched = upward @ to_camera
    for k in range(2, n_bounces + 1):
        light = _transport(source, rays)
        fluence.append(_fluence(light.real, grid))
        if k == n_bounces:
            break
        source, into_camera = _scatter(light, scattering)
        to_camera = sigma_t * (into_camera + scattering.share_ahead * watched)
        source *= sigma_t
        if k > 2:
            camera.append(seen @ to_camera / (sigma_t * across))
        watched = upward @ to_camera
    if n_bounces > 2:
        into_camera = _scatter(light, scattering)[1] + scattering.share_ahead * watched
        camera.append(seen @ into_camera / across)
    return SlabField(
        grid=grid,
        sigma_t_per_mm=sigma_t,
        camera=np.array(camera[:n_bounces]),
        fluence=np.array(fluence[:n_bounces]),
    )


def _rays(medium: Medium, slab: Slab, grid: SlabGrid, wavenumber: float) -> _Rays:
    """Return the steps of every ray, extinction being less sigma_t mu_x by the factor taken out."""
    half = grid.n_phi // 2
    height = Height.of(slab.height_mm, grid.n_z)
    mu_x, mu_y, mu_z = grid.cosines
    climb = mu_z[:half]
    rate = medium.sigma_t_per_mm * (1.0 - mu_x) + 1j * wavenumber * mu_y[:half]
    rate = rate[:, :, None] + climb[:, :, None] * height.eigenvalue
    along = np.broadcast_to(mu_x[:, :, None], rate.shape).ravel()
    left, share = node_steps(grid.x_mm, along, rate.ravel())
    mirror = [[reflectance(c, slab.surface_index) for c in row] for row in climb]
    return _Rays(
        height=height,
        forward=np.asarray(along > 0.0),
        left=left,
        share=share,
        climb=climb,
        mirror=np.array(mirror),
    )


def _transport(source: ComplexArray, rays: _Rays) -> ComplexArray:
    """Return the radiance that a source makes, both (n_phi, n_theta, n_z, n_x)."""
    height = rays.height
    half, shape = source.shape[0] // 2, (source.shape[0] // 2, *source.shape[1:])

    def climbing(from_below: ComplexArray) -> ComplexArray:
        modes = (height.to_modes @ from_below).reshape(-1, source.shape[-1])
        carried = carry(modes, rays.forward, rays.left, rays.share)
        return np.asarray(height.from_modes @ carried.reshape(shape))

    with BLAS.limit(limits=1):
        up = climbing(source[:half])
        # P_l is one at the surface; azimuth pi - phi is the mirror of phi.
        entering = (rays.climb * rays.mirror)[:, :, None] * up.sum(axis=2)
        below = source[half:][::-1] * height.mirrored[:, None]
        below = below + height.inflow[:, None] * entering[:, :, None, :]
        down = climbing(below)[::-1] * height.mirrored[:, None]
    return np.concatenate([up, down])


def _scatter(light: ComplexArray, scattering: Scattering) -> tuple[ComplexArray, Array]:
    """Return the scattered light per direction, and that towards the camera but for f.

    The real part of the light is even in mu_y, the imaginary part is odd.
    """
    n_phi, n_theta = light.shape[:2]
    n_m = scattering.cosine.shape[0]

    def legendre(moments: Array) -> Array:
        apart = moments.reshape(n_m, n_theta, -1)
        return np.asarray(scattering.legendre @ apart).reshape(n_m, -1)

    with BLAS.limit(limits=1):
        even = scattering.to_cosine @ light.real.reshape(n_phi, -1)
        to_camera = scattering.camera @ even.reshape(n_m * n_theta, -1)
        scattered = scattering.share_ahead * light
        scattered.real += (scattering.cosine.T @ legendre(even)).reshape(light.shape)
        if light.imag.any():
            odd = scattering.to_sine @ light.imag.reshape(n_phi, -1)
            scattered.imag += (scattering.sine.T @ legendre(odd)).reshape(light.shape)
    return scattered, to_camera.reshape(light.shape[2:])


def _fluence(light: Array, grid: SlabGrid) -> Array:
    """Return the integral over all directions of the mean over the height, (n_x,)."""
    per_phi = 2.0 * np.pi / grid.n_phi
    return np.asarray(per_phi * np.einsum("t,ptx->x", grid.weight, light[:, :, 0]))
