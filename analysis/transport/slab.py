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

from analysis.errors import AnalysisError
from analysis.medium import Medium, Slab
from analysis.phase_function import Array, phase_function
from analysis.transport.blas import BLAS
from analysis.transport.fresnel import mean_reflectance
from analysis.transport.plane import node_steps
from analysis.transport.slab_grid import (
    Height,
    Scattering,
    SlabGrid,
    bearings_of,
    camera_weights,
)
from analysis.transport.slab_kernels import climb_and_fall
from analysis.transport.slab_second import second_order

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabField:
    """Orders of a slab against depth, for an albedo of one, times exp(sigma_t x).

    Attributes
    ----------
    camera : (K, n_x), what the camera sees of bounces 1 .. K, A_1 = 1
    fluence : (K, n_x), mean over the height
    escape : (K, n_x), flux out through surface and floor, over the height, 1/mm
    ends : (K, 2), flux out through the lit face and the far wall, mean over the height, without the
        beam itself
    bearing : (K, n_x, n_b) complex, mean over the height of the radiance per radian of its bearing
        in the plane, atan2(mu_y, mu_x), whatever its elevation: its sum over all bearings is the
        fluence. Zero for the beam, which is a delta; n_b is zero where none was asked for
    """

    x_mm: Array
    sigma_t_per_mm: float
    camera: Array
    fluence: Array
    escape: Array
    ends: Array
    bearing: ComplexArray


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rays:
    """What every ray that goes up keeps and gathers; those going down are its mirror."""

    height: Height
    forward: NDArray[np.bool_]
    left: ComplexArray
    share: ComplexArray
    entering: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Light:
    """A source or a radiance, (n_phi, n_theta, n_z, n_x): its even and odd part in mu_y."""

    even: Array
    odd: Array


def solve_slab(
    medium: Medium,
    slab: Slab,
    grid: SlabGrid,
    *,
    n_bounces: int,
    wavenumber_per_mm: float = 0.0,
    least: float = 0.0,
    n_bearings: int = 0,
) -> SlabField:
    """Return bounces 1 .. n_bounces of light that enters as exp(i q y) along +x.

    ``mu_x dL/dx + mu_z dL/dz + (sigma_t + i q mu_y) L_k = sigma_s int p(Omega . Omega') L_(k-1)``
    with Eq. 2 on the sphere, nothing entering at x = 0, at the far wall and at the floor, and
    ``L(-mu_z) = R(mu_z) L(mu_z)`` at the surface. The medium's ``phase``, which is about
    flatland, and its sigma_s are not looked at.

    Parameters
    ----------
    least : bounces end early once the last one holds less than this share of all, everywhere
    n_bearings : of the angular distribution, at `light_field.equal_angles`

    Raises
    ------
    AnalysisError
        If nothing extinguishes the light, |g| is one, or the grid ends elsewhere than the slab.
    """
    _refuse(medium, slab, grid, n_bounces)
    with BLAS.limit(limits=1):
        return _march(medium, slab, grid, n_bounces, wavenumber_per_mm, least, n_bearings)


def _march(
    medium: Medium,
    slab: Slab,
    grid: SlabGrid,
    n_bounces: int,
    wavenumber: float,
    least: float,
    n_bearings: int,
) -> SlabField:
    """Go from order to order: transport, then scattering and the camera's part of it."""
    sigma_t = medium.sigma_t_per_mm
    scattering = Scattering.of(medium.g, grid)
    rays = _rays(medium, slab, grid, wavenumber)
    seen = camera_weights(slab.height_mm, sigma_t, grid.n_z)
    across = float(phase_function(np.array(0.5 * np.pi), medium.g, "hg-paper"))
    upward = np.linalg.inv(np.eye(grid.n_z) + rays.height.slope / sigma_t)
    second = second_order(
        grid.x_mm, medium, slab, wavenumber_per_mm=wavenumber, n_angles=grid.n_second
    )
    camera, fluence = [np.ones(grid.x_mm.size), second], [np.ones(grid.x_mm.size)]
    escape, ends = [np.zeros(grid.x_mm.size)], [np.zeros(2)]
    to_bearings = bearings_of(grid, n_bearings)
    bearing = [np.zeros((grid.x_mm.size, n_bearings), dtype=np.complex128)]
    source = _first_source(medium, grid, striped=wavenumber != 0.0)
    watched = np.zeros((grid.n_z, grid.x_mm.size))
    watched[0] = across
    watched = upward @ watched
    for k in range(2, n_bounces + 1):
        light = _transport(source, rays)
        fluence.append(_fluence(light.even, grid))
        escape.append(_escape(light.even, grid) / slab.height_mm)
        ends.append(_ends(light.even, grid))
        bearing.append(_bearing(light, to_bearings))
        source, to_camera = _scatter(light, scattering, sigma_t)
        to_camera += scattering.share_ahead * watched
        watched = upward @ to_camera
        if k > 2:
            camera.append(seen @ to_camera / across)
        if np.all(np.abs(camera[-1]) <= least * np.abs(np.sum(camera, axis=0))):
            break
    return SlabField(
        x_mm=grid.x_mm,
        sigma_t_per_mm=sigma_t,
        camera=np.array(camera[:n_bounces]),
        fluence=np.array(fluence),
        escape=np.array(escape),
        ends=np.array(ends),
        bearing=np.array(bearing),
    )


def _first_source(medium: Medium, grid: SlabGrid, *, striped: bool) -> _Light:
    """Return what the beam scatters, even over height and depth once exp(-sigma_t x) is out."""
    shape = (grid.n_phi, grid.theta_rad.size, grid.n_z, grid.x_mm.size)
    even = np.zeros(shape)
    scattered = phase_function(grid.theta_rad, medium.g, "hg-paper")
    even[:, :, 0] = medium.sigma_t_per_mm * scattered[:, None]
    return _Light(even=even, odd=np.zeros(shape if striped else 0))


def _rays(medium: Medium, slab: Slab, grid: SlabGrid, wavenumber: float) -> _Rays:
    """Return the steps of every ray, extinction being less sigma_t mu_x by the factor taken out."""
    half = grid.n_phi // 2
    height = Height.of(slab.height_mm, grid.n_z)
    if wavenumber == 0.0:
        height = height.of_real()
    mu_x, mu_y, mu_z = grid.cosines
    climb = mu_z[:half]
    rate = medium.sigma_t_per_mm * (1.0 - mu_x) + 1j * wavenumber * mu_y[:half]
    rate = rate[:, :, None] + climb[:, :, None] * height.eigenvalue
    along = np.broadcast_to(mu_x[:, :, None], rate.shape)
    left, share = node_steps(grid.x_mm, along.ravel(), rate.ravel())
    shape = (*rate.shape, grid.x_mm.size)
    return _Rays(
        height=height,
        forward=np.asarray(mu_x[0] > 0.0),
        left=left.reshape(shape),
        share=share.reshape(3, *shape),
        entering=climb * mean_reflectance(*grid.up_edges, slab.surface_index),
    )


def _transport(source: _Light, rays: _Rays) -> _Light:
    """Return the radiance that a source makes."""
    found = _Light(even=np.empty_like(source.even), odd=np.empty_like(source.odd))
    odd, out_odd = source.odd, found.odd
    if odd.size == 0:
        odd, out_odd = np.empty((0, 0, 0, 0)), np.empty((0, 0, 0, 0))
    climb_and_fall(
        source.even,
        odd,
        rays.forward,
        rays.left,
        rays.share,
        rays.height.to_modes,
        rays.height.from_modes,
        rays.height.inflow,
        rays.entering,
        found.even,
        out_odd,
    )
    return found


def _scatter(light: _Light, scattering: Scattering, sigma_t: float) -> tuple[_Light, Array]:
    """Return what is scattered per direction per mm, and what the camera sees of it but for f."""
    shape = light.even.shape
    n_m = scattering.cosine.shape[0]

    def scattered(part: Array, moments: Array, back: Array) -> Array:
        apart = moments.reshape(n_m, shape[1], -1)
        mixed = (scattering.legendre @ apart).reshape(n_m, -1)
        found = (back.T @ mixed).reshape(shape)
        found += scattering.share_ahead * part
        found *= sigma_t
        return np.asarray(found)

    odd = light.odd
    moments = scattering.to_cosine @ light.even.reshape(shape[0], -1)
    to_camera = scattering.camera @ moments.reshape(n_m * shape[1], -1)
    even = scattered(light.even, moments, scattering.cosine)
    if odd.size > 0:
        moments = scattering.to_sine @ odd.reshape(shape[0], -1)
        odd = scattered(light.odd, moments, scattering.sine)
    return _Light(even=even, odd=odd), to_camera.reshape(shape[2:])


def _fluence(even: Array, grid: SlabGrid) -> Array:
    """Return the integral over all directions of the mean over the height, (n_x,)."""
    mean = np.tensordot(grid.phi_weight, even[:, :, 0], axes=1)
    return np.asarray(2.0 * np.pi * (grid.weight @ mean))


def _bearing(light: _Light, to_bearings: Array) -> ComplexArray:
    """Return the mean over the height of the radiance by bearing, (n_x, n_b)."""
    n_b = to_bearings.shape[0]
    plus = to_bearings.reshape(n_b, to_bearings.shape[1] * to_bearings.shape[2])
    minus = plus[::-1]  # of mu_y < 0, whose radiance is the conjugate
    flat = (plus.shape[1], light.even.shape[3])
    found = np.zeros((n_b, flat[1]), dtype=np.complex128)
    found.real = (plus + minus) @ light.even[:, :, 0].reshape(flat)
    if light.odd.size:
        found.imag = (plus - minus) @ light.odd[:, :, 0].reshape(flat)
    return found.T


def _escape(even: Array, grid: SlabGrid) -> Array:
    """Return the net flux out through surface and floor, (n_x,)."""
    climb = 2.0 * np.pi * grid.cosines[2] * np.outer(grid.phi_weight, grid.weight)
    sign = (-1.0) ** np.arange(grid.n_z)
    surface = np.einsum("pt,ptzx->x", climb, even)
    floor = np.einsum("pt,ptzx,z->x", np.minimum(climb, 0.0), even, sign)
    return np.asarray(surface - floor)


def _ends(even: Array, grid: SlabGrid) -> Array:
    """Return the flux out through face and far wall, times exp(sigma_t x), (2,)."""
    along = 2.0 * np.pi * np.cos(grid.theta_rad) * grid.weight
    mean = np.tensordot(grid.phi_weight, even[:, :, 0], axes=1)
    return np.array([-np.minimum(along, 0.0) @ mean[:, 0], np.maximum(along, 0.0) @ mean[:, -1]])


def _refuse(medium: Medium, slab: Slab, grid: SlabGrid, n_bounces: int) -> None:
    msg = ""
    if medium.sigma_t_per_mm == 0.0 or abs(medium.g) == 1.0:
        msg = (
            f"sigma_t = {medium.sigma_t_per_mm}, g = {medium.g}: a slab needs some extinction and "
            "|g| < 1."
        )
    elif n_bounces < 2:
        msg = f"n_bounces = {n_bounces}: at least two are needed."
    elif not np.isclose(grid.x_mm[-1], slab.depth_mm):
        msg = f"the grid ends at {grid.x_mm[-1]} mm, the slab at {slab.depth_mm} mm."
    if msg:
        raise AnalysisError(msg)
