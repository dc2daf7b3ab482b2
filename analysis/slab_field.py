"""Every bounce of a slab over its whole picture: light under a beam of any width and profile.

A beam's profile is a sum of waves along the face, each of which a slab answers on its own. The
side walls are left out: light in a thin layer goes a few heights aside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.light_field import BounceField, Grid
from analysis.medium import Beam, Medium, Slab
from analysis.phase_function import Array
from analysis.transport.slab import solve_slab
from analysis.transport.slab_grid import SlabGrid
from analysis.transport.slab_resolution import depths, directions

N_TABLE = 14  # wave numbers that are solved for; the answer is smooth between them
APART = 8.0  # heights between the tank and the beam's repetition
FINE_PROFILE = 4001
FINENESS = 1.0
LEAST_FINENESS = 0.85  # of any wave


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabBounces:
    """Bounces 1 .. K of a slab.

    Attributes
    ----------
    seen : its ``fluence`` is what the camera sees of each bounce, A_k with sigma_s^(k-1) applied,
        over single scattering where the beam enters; its ``light_field`` the mean over the height
        of the radiance by bearing
    fluence : (K, n_y, n_x), mean over the height; the integral of the light field over bearing
    """

    seen: BounceField
    fluence: Array


def slab_bounces(
    medium: Medium,
    slab: Slab,
    beam: Beam,
    grid: Grid,
    *,
    n_bounces: int,
    fineness: float = FINENESS,
) -> SlabBounces:
    """Return bounces 1 .. n_bounces at the nodes of a grid, along y as means over its cells.

    Parameters
    ----------
    fineness : of `slab_resolution.directions`; `slab_tolerance` finds one for a tolerance

    Raises
    ------
    AnalysisError
        If the beam leaves the face, or as `solve_slab` does.
    """
    beam = beam.entering(grid.tank)
    waves = wave_grids(medium, slab, beam, grid, fineness=fineness)
    nodes = np.array([q for q, _ in waves])
    fields = [
        solve_slab(
            medium,
            slab,
            of_wave,
            n_bounces=n_bounces,
            wavenumber_per_mm=q,
            n_bearings=grid.n_theta,
        )
        for q, of_wave in waves
    ]
    even, odd, plain = _window(beam, slab, grid, nodes)
    albedo = (medium.sigma_s_per_mm / medium.sigma_t_per_mm) ** np.arange(n_bounces)
    decay = np.exp(-medium.sigma_t_per_mm * grid.x_mm)
    to_grid = CubicSpline(fields[0].x_mm, np.eye(fields[0].x_mm.size))(grid.x_mm) * decay[:, None]

    def over(found: list[Array]) -> Array:
        """Return (K, n_y, n_x) of values (K, n_x) for each wave number."""
        of_y = np.einsum("yq,qkx->kyx", even, np.array(found))
        return np.asarray(albedo[:, None, None] * (of_y @ to_grid.T))

    seen, fluence = over([f.camera for f in fields]), over([f.fluence for f in fields])
    seen[0] = fluence[0] = plain[:, None] * decay
    light_field = np.empty((n_bounces - 1, grid.n_y, grid.n_x, grid.n_theta), dtype=np.float32)
    for k in range(1, n_bounces):
        real = np.array([f.bearing[k].real for f in fields])
        imaginary = np.array([f.bearing[k].imag for f in fields])
        of_y = np.tensordot(even, real, axes=1) + np.tensordot(odd, imaginary, axes=1)
        light_field[k - 1] = albedo[k] * np.einsum("gx,yxb->ygb", to_grid, of_y, optimize=True)
    return SlabBounces(
        seen=BounceField(
            medium=medium,
            beam=beam,
            grid=grid,
            fluence=np.maximum(seen, 0.0),
            light_field=np.maximum(light_field, 0.0, out=light_field),
            engine="slab",
        ),
        fluence=np.maximum(fluence, 0.0),
    )


def wave_grids(
    medium: Medium, slab: Slab, beam: Beam, grid: Grid, *, fineness: float
) -> list[tuple[float, SlabGrid]]:
    """Return the wave numbers that are solved for, and what each is solved on."""
    slow = 0.25 * max(medium.sigma_t_per_mm, 1.0 / slab.height_mm)
    top = np.arcsinh(np.pi / grid.cell_y_mm / slow)
    x_mm = depths(medium.sigma_t_per_mm, slab, fineness=fineness)
    found = []
    for q in slow * np.sinh(np.linspace(0.0, top, N_TABLE)):
        of_wave = _fineness_of(q, beam, fineness)
        on = directions(medium.g, slab, x_mm, wavenumber_per_mm=q, fineness=of_wave)
        found.append((float(q), on))
    return found


def _fineness_of(wavenumber: float, beam: Beam, fineness: float) -> float:
    """Return how finely a wave is solved for: the less it holds of the beam, the less finely.

    A lit part of width w with sharp edges holds 2 / (q w) of its light in a wave; errors fall with
    the square of the fineness.
    """
    share = 1.0 / (1.0 + 0.5 * wavenumber * (beam.to_mm - beam.from_mm))
    return max(fineness * math.sqrt(share), min(fineness, LEAST_FINENESS))


def _window(beam: Beam, slab: Slab, grid: Grid, nodes: Array) -> tuple[Array, Array, Array]:
    """Return what each wave number's even and odd answer gives to each row, and the beam itself.

    (n_y, n_q) twice, and (n_y,).
    """
    apart = grid.tank.width_mm + APART * slab.height_mm
    k = np.arange(0.0, nodes[-1], 2.0 * np.pi / apart)
    heights, light = beam.profile_points()
    fine = np.linspace(beam.from_mm, beam.to_mm, FINE_PROFILE)
    shown = np.interp(fine, heights, light)
    wave = np.exp(-1j * np.outer(k, fine)) * shown
    share = np.trapezoid(wave, fine, axis=1) / apart
    share *= np.where(k > 0.0, 2.0, 1.0) * np.sinc(k * grid.cell_y_mm / (2.0 * np.pi))
    turned = share * np.exp(1j * np.outer(grid.y_mm, k))
    unit = np.eye(nodes.size)
    # Even and odd in the wave number, about zero.
    of_even = CubicSpline(nodes, unit, bc_type=((1, 0.0 * unit[0]), "not-a-knot"))(k)
    of_odd = CubicSpline(nodes, unit, bc_type=((2, 0.0 * unit[0]), "not-a-knot"))(k)
    plain = _mean_over_cells(beam, grid)
    return turned.real @ of_even, -turned.imag @ of_odd, plain


def _mean_over_cells(beam: Beam, grid: Grid) -> Array:
    """Return the beam's irradiance as means over the cells around each row, (n_y,)."""
    heights, light = beam.profile_points()
    fine = np.linspace(beam.from_mm, beam.to_mm, FINE_PROFILE)
    shown = np.interp(fine, heights, light)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (shown[1:] + shown[:-1]) * np.diff(fine))])
    half = 0.5 * grid.cell_y_mm
    ends = [np.interp(grid.y_mm + off, fine, summed) for off in (-half, half)]
    return np.asarray((ends[1] - ends[0]) / grid.cell_y_mm)
