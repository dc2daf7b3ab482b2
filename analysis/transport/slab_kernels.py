"""The compiled step of transport in a slab: every ray of a pair of azimuths, up and down again."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from analysis.phase_function import Array

ComplexArray = NDArray[np.complex128]


@njit(cache=True, nogil=True)
def climb_and_fall(
    even: Array,
    odd: Array,
    forward: NDArray[np.bool_],
    left: ComplexArray,
    share: ComplexArray,
    to_modes: ComplexArray,
    from_modes: ComplexArray,
    inflow: Array,
    entering: Array,
    out_even: Array,
    out_odd: Array,
) -> None:
    """Carry a source up to the surface, mirror what arrives there, and carry the other half down.

    Parameters
    ----------
    even, odd : (n_phi, n_theta, n_z, n_x), real and imaginary part of the source; ``odd`` is empty
        where all is real
    forward : (n_theta,), whether mu_x > 0
    left, share : (n_phi / 2, n_theta, n_modes, n_x) and (3, ...), as `plane.node_steps` makes them
    to_modes, from_modes : (n_modes, n_z) and (n_z, n_modes)
    inflow : (n_z,), with the sign of the mirror
    entering : (n_phi / 2, n_theta), mu_z R, what of the light at the surface comes back in
    out_even, out_odd : the radiance, overwritten
    """
    n_phi, n_theta, n_z, n_x = even.shape
    striped = odd.size > 0
    source = np.zeros((n_z, n_x), dtype=np.complex128)
    light = np.zeros((n_z, n_x), dtype=np.complex128)
    nothing = np.zeros((n_z, n_x))
    for p in range(n_phi // 2):
        fall = n_phi - 1 - p
        for t in range(n_theta):
            kept, gathered = left[p, t], share[:, p, t]
            for z in range(n_z):
                source[z] = even[p, t, z] + 1j * (odd[p, t, z] if striped else nothing[z])
            _carry_modes(source, forward[t], kept, gathered, to_modes, from_modes, light)
            top = np.zeros(n_x, dtype=np.complex128)
            for z in range(n_z):
                out_even[p, t, z] = light[z].real
                if striped:
                    out_odd[p, t, z] = light[z].imag
                # Every P_l is one at the surface. Half the modes leave an imaginary part.
                top += light[z] if striped else light[z].real + 0.0j
            for z in range(n_z):
                sign = 1.0 if z % 2 == 0 else -1.0
                source[z] = sign * (
                    even[fall, t, z] + 1j * (odd[fall, t, z] if striped else nothing[z])
                )
                source[z] += inflow[z] * entering[p, t] * top
            _carry_modes(source, forward[t], kept, gathered, to_modes, from_modes, light)
            for z in range(n_z):
                sign = 1.0 if z % 2 == 0 else -1.0
                out_even[fall, t, z] = sign * light[z].real
                if striped:
                    out_odd[fall, t, z] = sign * light[z].imag


@njit(cache=True, nogil=True)
def _carry_modes(
    source: ComplexArray,
    forward: bool,
    left: ComplexArray,
    share: ComplexArray,
    to_modes: ComplexArray,
    from_modes: ComplexArray,
    light: ComplexArray,
) -> None:
    """Carry one ray's source along x in each mode of the height, nothing entering at the walls."""
    n_modes, n_z = to_modes.shape
    n_x = source.shape[1]
    last = n_x - 1
    fed = np.empty(n_x, dtype=np.complex128)
    light[:] = 0.0
    for m in range(n_modes):
        fed[:] = 0.0
        for z in range(n_z):
            factor = to_modes[m, z]
            for x in range(n_x):
                fed[x] += factor * source[z, x]
        step, i = (1, 0) if forward else (-1, last)
        carried = 0.0j
        for done in range(last):
            i += step
            beyond = i + step if done < last - 1 else i - 2 * step
            carried = (
                left[m, i] * carried
                + share[0, m, i] * fed[i - step]
                + share[1, m, i] * fed[i]
                + share[2, m, i] * fed[beyond]
            )
            for z in range(n_z):
                light[z, i] += from_modes[z, m] * carried
