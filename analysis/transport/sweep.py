"""Short characteristics: light carried along one direction through a rectangle of nodes.

A ray reaches a node from the line of nodes before it. What it brings is interpolated there by a
cubic; what is added on the way follows a parabola through the source before, at and behind the
node, integrated exactly with the extinction. Cubic and parabola may undershoot beside an edge:
there both are linear, which cannot. Beside a wall that grazing light enters by, the radiance rises
within less than a cell: what is interpolated there is the share of that rise.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from analysis.phase_function import Array

Ray = tuple[float, float, float, float, float, float, float, float, float, float, float, float]


@njit(cache=True, nogil=True)
def sweep(
    source: Array,
    cos_theta: Array,
    sin_theta: Array,
    pitch_mm: tuple[float, float],
    sigma_t_per_mm: float,
    out: Array,
) -> None:
    """Carry ``source`` along its directions into ``out``, nothing entering through the walls.

    Parameters
    ----------
    source, out : (n, n_lines, n_nodes), power set out per mm of path and radiance; rays cross
        every line
    cos_theta, sin_theta : (n,), components of the direction across the lines and along them;
        ``abs(cos) * pitch[1] >= abs(sin) * pitch[0]``
    pitch_mm : from line to line, and from node to node
    sigma_t_per_mm : extinction coefficient
    """
    h_line, h_node = pitch_mm
    for n in range(source.shape[0]):
        path = h_line / abs(cos_theta[n])
        shift = sin_theta[n] * path / h_node
        ray = _describe(shift, path, sigma_t_per_mm * path)
        _march(source[n], cos_theta[n] > 0.0, ray, out[n])


@njit(cache=True, nogil=True)
def _describe(shift: float, path: float, tau: float) -> Ray:
    """Return what the rays of one direction share.

    Their shift in nodes from line to line; the light left after that path; the path; the moments
    of the exponential; and what the nodes 1, 2 and 3 away from the wall of entry weigh for the
    light that reaches the nodes one and two away from it.
    """
    share = abs(shift)
    depth = max(tau / share, 1e-6) if share > 0.0 else 1.0  # optical, of a node's distance
    first = _rising_weights(1.0 - share, depth)
    second = _rising_weights(2.0 - share, depth)
    return (shift, math.exp(-tau), path, *exponential_moments(tau), *first, *second)


@njit(cache=True, nogil=True)
def _rising_weights(position: float, depth: float) -> tuple[float, float, float]:
    """Return the weights of nodes 1, 2, 3 for light that enters nowhere but is set out evenly.

    Its radiance is 1 - exp(-depth x) times a parabola; where ``depth`` is small, the cubic that
    vanishes at the wall.
    """
    a, b, c = position - 1.0, position - 2.0, position - 3.0
    rise = math.expm1(-depth * position)
    return (
        0.5 * b * c * rise / math.expm1(-depth),
        -a * c * rise / math.expm1(-2.0 * depth),
        0.5 * a * b * rise / math.expm1(-3.0 * depth),
    )


@njit(cache=True, nogil=True)
def _march(
    source: Array,
    forward: bool,
    ray: Ray,
    out: Array,
) -> None:
    """Fill one direction, line after line; rays come from ``shift`` nodes lower a line before."""
    n_lines, n_nodes = source.shape
    shift = ray[0]
    inflow = 0 if shift > 0.0 else n_nodes - 1
    p, step = (0, 1) if forward else (n_lines - 1, -1)
    out[p] = 0.0
    for done in range(1, n_lines):
        p += step
        if done == n_lines - 1 or _fill_line(source, p, step, ray, out):
            for q in range(2, n_nodes - 2):
                out[p, q] = _node(source, out, p, q, step, done, ray)
        for q in (0, 1, abs(inflow - 2), n_nodes - 2, n_nodes - 1):
            out[p, q] = 0.0 if q == inflow else _node(source, out, p, q, step, done, ray)


@njit(cache=True, nogil=True)
def _fill_line(
    source: Array,
    line: int,
    step: int,
    ray: Ray,
    out: Array,
) -> bool:
    """Fill all but the two outermost nodes of either end; return whether any undershot.

    The indices are unsigned: a test for negative ones would keep the loop off the vector unit.
    """
    shift, left, path, e0, e1, e2 = ray[:6]
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    before, here, behind = np.uint64(line - step), np.uint64(line), np.uint64(line + step)
    low, high = (np.uint64(0), one) if shift > 0.0 else (one, np.uint64(0))
    w0, w1, w2, w3 = cubic_weights(2.0 - float(low) - shift)
    u0, u1, u2, u3 = cubic_weights(2.0 - float(high) + shift)
    real = out.dtype.type  # single precision stays so, at twice the speed
    w0, w1, w2, w3 = real(w0), real(w1), real(w2), real(w3)
    u0, u1, u2, u3 = real(u0), real(u1), real(u2), real(u3)
    left, at_node, zero = real(left), real(path * (e0 - e2)), real(0.0)
    upstream, downstream = real(0.5 * path * (e1 + e2)), real(0.5 * path * (e2 - e1))
    undershot = False
    for q in range(np.uint64(source.shape[1] - 4)):
        i, k = q + low, q + high
        near = w0 * out[before, i] + w1 * out[before, i + one]
        brought = left * (near + (w2 * out[before, i + two] + w3 * out[before, i + three]))
        near = w0 * source[before, i] + w1 * source[before, i + one]
        past = near + (w2 * source[before, i + two] + w3 * source[before, i + three])
        near = u0 * source[behind, k] + u1 * source[behind, k + one]
        future = near + (u2 * source[behind, k + two] + u3 * source[behind, k + three])
        added = at_node * source[here, q + two] + (upstream * past + downstream * future)
        undershot |= (brought < zero) | (added < zero)
        out[here, q + two] = brought + added
    return undershot


@njit(cache=True, nogil=True)
def _node(
    source: Array,
    out: Array,
    p: int,
    q: int,
    step: int,
    done: int,
    ray: Ray,
) -> float:
    """Return the radiance at any node: beside walls, or where the smooth forms undershoot."""
    shift, left, path, e0, e1, e2 = ray[:6]
    n_lines, n_nodes = source.shape
    brought = _brought(out, p - step, q, ray)
    past, here = interpolate(source, p - step, q - shift), source[p, q]
    ahead, origin = q + shift, q - 2.0 * shift
    if done < n_lines - 1 and 0.0 <= ahead <= n_nodes - 1.0:
        future = interpolate(source, p + step, ahead)
        added = (e0 - e2) * here + 0.5 * (e1 + e2) * past + 0.5 * (e2 - e1) * future
    elif done > 1 and 0.0 <= origin <= n_nodes - 1.0:
        # At the walls the light leaves by, the parabola leans on the ray's past.
        earlier = interpolate(source, p - 2 * step, origin)
        added = (
            (e0 - 1.5 * e1 + 0.5 * e2) * here + (2.0 * e1 - e2) * past + 0.5 * (e2 - e1) * earlier
        )
    else:
        added = (e0 - e1) * here + e1 * past
    if brought < 0.0 or added < 0.0:
        neighbour = q - 1 if shift > 0.0 else q + 1
        share = abs(shift)
        brought = share * out[p - step, neighbour] + (1.0 - share) * out[p - step, q]
        past = share * source[p - step, neighbour] + (1.0 - share) * source[p - step, q]
        added = (e0 - e1) * here + e1 * past
    arriving: float = left * brought + path * added
    return arriving


@njit(cache=True, nogil=True)
def _brought(out: Array, line: int, q: int, ray: Ray) -> float:
    """Return the radiance of a line where the ray leaves it that arrives at node ``q``."""
    n_nodes = out.shape[1]
    shift = ray[0]
    inflow, inwards = (0, 1) if shift > 0.0 else (n_nodes - 1, -1)
    away = abs(q - inflow)
    if away > 2 or shift == 0.0:
        found: float = interpolate(out, line, q - shift)
        return found
    w1, w2, w3 = ray[6:9] if away == 1 else ray[9:12]
    near: float = w1 * out[line, inflow + inwards] + w2 * out[line, inflow + 2 * inwards]
    far: float = w3 * out[line, inflow + 3 * inwards]
    return near + far


@njit(cache=True, nogil=True)
def cubic_weights(position: float) -> tuple[float, float, float, float]:
    """Return the Lagrange weights of nodes 0, 1, 2, 3 for a point at ``position``."""
    a, b, c, d = position, position - 1.0, position - 2.0, position - 3.0
    return -b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0


@njit(cache=True, nogil=True)
def interpolate(field: Array, line: int, position: float) -> float:
    """Return the cubic through the nodes of a line of ``field`` at a fractional position."""
    first = min(max(math.floor(position) - 1, 0), field.shape[1] - 4)
    w0, w1, w2, w3 = cubic_weights(position - first)
    near: float = w0 * field[line, first] + w1 * field[line, first + 1]
    far: float = w2 * field[line, first + 2] + w3 * field[line, first + 3]
    return near + far


@njit(cache=True, nogil=True)
def exponential_moments(tau: float) -> tuple[float, float, float]:
    """Return the integrals of x^k exp(-tau x) over 0 .. 1 for k = 0, 1, 2."""
    if tau < 0.3:
        # The closed forms cancel here; the series reaches rounding in a dozen terms.
        e0, e1, e2, term = 0.0, 0.0, 0.0, 1.0
        for n in range(14):
            e0 += term / (n + 1)
            e1 += term / (n + 2)
            e2 += term / (n + 3)
            term *= -tau / (n + 1)
        return e0, e1, e2
    left = math.exp(-tau)
    e0 = (1.0 - left) / tau
    e1 = (e0 - left) / tau
    return e0, e1, (2.0 * e1 - left) / tau


@njit(cache=True, nogil=True)
def turn(field: Array, weight: float, index: Array, across: bool, out: Array) -> None:
    """Write weight * field (n, n_lines, n_nodes) into out[y, x, index[n]].

    ``across`` says that the lines of ``field`` are those of constant x.
    """
    n_angles, n_lines, n_nodes = field.shape
    factor = out.dtype.type(weight)
    # A few directions at a time: more streams than that outrun the tables of memory pages.
    for first in range(0, n_angles, 16):
        last = min(first + 16, n_angles)
        for p in range(n_lines):
            for q in range(n_nodes):
                for n in range(first, last):
                    if across:
                        out[q, p, index[n]] = factor * field[n, p, q]
                    else:
                        out[p, q, index[n]] = factor * field[n, p, q]


@njit(cache=True, nogil=True)
def add_turned(planes: Array, out: Array) -> None:
    """Add the transpose of each plane (r, n, m) to ``out`` (r, m, n)."""
    for r in range(planes.shape[0]):
        for first in range(0, planes.shape[1], 16):
            last = min(first + 16, planes.shape[1])
            for j in range(planes.shape[2]):
                for i in range(first, last):
                    out[r, j, i] += planes[r, i, j]


@njit(cache=True, nogil=True)
def write_turned(planes: Array, out: Array) -> None:
    """Write the transpose of each plane (r, n, m) to ``out`` (r, m, n)."""
    for r in range(planes.shape[0]):
        for first in range(0, planes.shape[1], 16):
            last = min(first + 16, planes.shape[1])
            for j in range(planes.shape[2]):
                for i in range(first, last):
                    out[r, j, i] = planes[r, i, j]
