"""A tank's answer by the solver of the analysis: quick and free of noise, but no independent truth.

White light is solved in two dimensions with the tank's walls. A wave along the face needs one
dimension only: the part of the face that is lit makes of it a sum of waves, each of which keeps
its form in depth with a complex extinction. The side walls are left out of the waves, whose
scattered light does not reach them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.medium import Beam, Medium
from analysis.transport.plane import PlaneGrid, solve_plane
from analysis.transport.solve import solve
from labrig.models.scene import Scene
from labrig.scene.answer import Answer, Array, Wave
from labrig.scene.response import bounces_of

TOLERANCE = 1e-3  # of each bounce under white light
REACH = 12.0  # mean free paths between the lit part and its repetition
FINEST_MM = 0.05
N_TABLE = 48  # wavenumbers that are solved for; the answer is smooth between them
N_DEPTHS, N_ANGLES = 120, 192  # half as many angles: a third harmonic wrong by 0.1, not 0.03


def answer_by_ordinates(
    scene: Scene,
    harmonics: Mapping[float, tuple[int, ...]],
    progress: Callable[[int, int], None] | None = None,
) -> Answer:
    """Return a tank's answer to stripes of some periods (mm), each with its first harmonics."""
    medium, tank = scene.medium.record(), scene.tank.record()
    beam = scene.beam.record().entering(tank)
    n_bounces, begun_s = bounces_of(scene), time.process_time()
    follow = progress or (lambda _done, _total: None)
    follow(0, N_TABLE + 1)
    white = solve(
        medium,
        tank,
        beam,
        orders=n_bounces,
        tolerance=TOLERANCE,
        engine="ordinates",
        light_field=False,
    )
    y_mm, x_mm = white.grid.y_mm, white.grid.x_mm
    waves: dict[tuple[float, int], Wave] = {}
    if harmonics:
        wanted = [(p, h) for p, some in harmonics.items() for h in some]
        fastest = 2.0 * math.pi * max(h / p for p, h in wanted)
        window = _Window(beam, medium)
        table = _Table(medium, beam, n_bounces, fastest + window.fastest, tank.depth_mm, follow)
        for period_mm, harmonic in wanted:
            q = 2.0 * math.pi * harmonic / period_mm
            waves[period_mm, harmonic] = window.lit(table, q, x_mm, y_mm)
    return Answer(
        x_mm=x_mm,
        y_mm=y_mm,
        fluence=white.fluence[1:],
        std_error=None,
        waves=waves,
        method="ordinates",
        seconds=time.process_time() - begun_s,
        from_cache=False,
    )


class _Table:
    """The depth profile of a wave for every wavenumber up to the fastest."""

    def __init__(
        self,
        medium: Medium,
        beam: Beam,
        n_bounces: int,
        fastest_per_mm: float,
        depth_mm: float,
        follow: Callable[[int, int], None],
    ) -> None:
        grid = PlaneGrid.graded(
            depth_mm,
            sigma_t_per_mm=medium.sigma_t_per_mm,
            n_x=N_DEPTHS,
            n_theta=N_ANGLES,
            striped=True,
        )
        slow = max(0.25 * medium.sigma_t_per_mm, 1e-3 * fastest_per_mm)
        top = math.asinh(fastest_per_mm / slow)
        q = slow * np.sinh(np.linspace(0.0, top, N_TABLE))
        rows = []
        for done, one in enumerate(q, start=1):
            found = solve_plane(
                medium,
                grid,
                n_bounces=n_bounces,
                angle_deg=beam.angle_deg,
                wavenumber_per_mm=float(one),
            )
            rows.append(found.weighted(medium.sigma_s_per_mm)[1:].sum(axis=0))
            follow(done, N_TABLE + 1)
        self._of_q = CubicSpline(q, np.array(rows), axis=0)
        self._x_mm = grid.x_mm

    def at(self, q_per_mm: Array, x_mm: Array) -> Wave:
        """Return the amplitudes of waves, of either sign, at depths: (n_q, n_x)."""
        values = self._of_q(np.abs(q_per_mm))
        values = np.where(q_per_mm[:, None] < 0.0, values.conj(), values)
        return np.asarray(CubicSpline(self._x_mm, values, axis=1)(x_mm))


class _Window:
    """The lit part of the face, repeated at a distance, as a sum of waves."""

    def __init__(self, beam: Beam, medium: Medium) -> None:
        width = beam.to_mm - beam.from_mm
        self._slope = math.tan(math.radians(beam.angle_deg))
        apart = width + REACH / max(medium.sigma_t_per_mm, REACH / (9.0 * width))
        n = 2 * math.ceil(apart / max(FINEST_MM, apart / 4096.0))
        y = beam.from_mm + np.arange(n) * (apart / n)
        heights, irradiance = beam.profile_points()
        # The mean over a sample, not its middle: a beam's edge may fall between two samples.
        edges = np.append(y, beam.from_mm + apart) - 0.5 * apart / n
        cumulative = np.concatenate(
            [[0.0], np.cumsum(0.5 * (irradiance[1:] + irradiance[:-1]) * np.diff(heights))]
        )
        fine = np.linspace(beam.from_mm, beam.to_mm, 4097)
        inside = (
            CubicSpline(heights, cumulative)(fine)
            if heights.size > 2
            else ((fine - beam.from_mm) / width * cumulative[-1])
        )
        shown = np.diff(np.interp(edges, fine, inside)) / (apart / n)
        share = np.fft.fft(shown) / n
        k = 2.0 * np.pi * np.fft.fftfreq(n, apart / n)
        keep = np.abs(k) <= 0.5 * np.abs(k).max()
        self._share = share[keep] * np.exp(-1j * k[keep] * beam.from_mm)
        self._k = k[keep]
        self.fastest = float(np.abs(self._k).max())

    def lit(self, table: _Table, q_per_mm: float, x_mm: Array, y_mm: Array) -> Wave:
        """Return the answer to a wave on the lit part, over the wave itself, (n_y, n_x)."""
        carried = np.exp(-1j * self._slope * self._k[:, None] * x_mm[None, :])
        amplitudes = self._share[:, None] * table.at(q_per_mm + self._k, x_mm) * carried
        return np.asarray(np.exp(1j * y_mm[:, None] * self._k[None, :]) @ amplitudes)
