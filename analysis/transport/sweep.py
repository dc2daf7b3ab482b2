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

Weights = tuple[float, float, float, float]
Reach = tuple[int, Weights, Weights, int, int, Weights, float]
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
    inflow, inwards = (0, 1) if ray[0] > 0.0 else (n_nodes - 1, -1)
    outflow = n_nodes - 1 - inflow
    edge = (inflow + inwards, inflow + 2 * inwards, outflow - inwards, outflow)
    usual = (
        _reach(edge[0], n_nodes, 2, False, ray),
        _reach(edge[1], n_nodes, 2, False, ray),
        _reach(edge[2], n_nodes, 2, False, ray),
        _reach(edge[3], n_nodes, 2, False, ray),
    )
    p, step = (0, 1) if forward else (n_lines - 1, -1)
    out[p] = 0.0
    for done in range(1, n_lines):
        p += step
        last = done == n_lines - 1
        if _fill_line(source, p, step, last, ray, out):
            for q in range(2, n_nodes - 2):
                reach = _reach(q, n_nodes, done, last, ray)
                out[p, q] = _node(source, out, p, q, step, reach, ray)
        out[p, inflow] = 0.0
        for k in range(4):
            # Where light leaves, the first line differs too.
            odd = last or (done == 1 and k == 3)
            reach = _reach(edge[k], n_nodes, done, last, ray) if odd else usual[k]
            out[p, edge[k]] = _node(source, out, p, edge[k], step, reach, ray)


@njit(cache=True, nogil=True)
def _fill_line(
    source: Array,
    line: int,
    step: int,
    last: bool,
    ray: Ray,
    out: Array,
) -> bool:
    """Fill all but the two outermost nodes of either end; return whether any undershot.

    The indices are unsigned: a test for negative ones would keep the loop off the vector unit.
    """
    shift, left = ray[:2]
    low, high = (np.uint64(0), np.uint64(1)) if shift > 0.0 else (np.uint64(1), np.uint64(0))
    third, start, away = line + step, high, shift
    if last:
        third, start, away = line - 2 * step, low, -2.0 * shift
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    before, here, beyond = np.uint64(line - step), np.uint64(line), np.uint64(third)
    w0, w1, w2, w3 = cubic_weights(2.0 - float(low) - shift)
    u0, u1, u2, u3 = cubic_weights(2.0 - float(start) + away)
    at_node, upstream, leaning = _parabola(-2 if last else 1, ray)
    real = out.dtype.type  # single precision stays so, at twice the speed
    w0, w1, w2, w3 = real(w0), real(w1), real(w2), real(w3)
    u0, u1, u2, u3 = real(u0), real(u1), real(u2), real(u3)
    left, at_node, zero = real(left), real(at_node), real(0.0)
    upstream, leaning = real(upstream), real(leaning)
    undershot = False
    for q in range(np.uint64(source.shape[1] - 4)):
        i, k = q + low, q + start
        near = w0 * out[before, i] + w1 * out[before, i + one]
        brought = left * (near + (w2 * out[before, i + two] + w3 * out[before, i + three]))
        near = w0 * source[before, i] + w1 * source[before, i + one]
        past = near + (w2 * source[before, i + two] + w3 * source[before, i + three])
        near = u0 * source[beyond, k] + u1 * source[beyond, k + one]
        other = near + (u2 * source[beyond, k + two] + u3 * source[beyond, k + three])
        added = at_node * source[here, q + two] + (upstream * past + leaning * other)
        undershot |= (brought < zero) | (added < zero)
        out[here, q + two] = brought + added
    return undershot


@njit(cache=True, nogil=True)
def _parabola(lines: int, ray: Ray) -> tuple[float, float, float]:
    """Return what the source at a node, a line before and so many lines off weighs, mm.

    The third line is the next (1), or at the walls the light leaves by that before the one before
    (-2); without any (0) the source is linear.
    """
    path, e0, e1, e2 = ray[2:6]
    if lines == 1:
        return path * (e0 - e2), 0.5 * path * (e1 + e2), 0.5 * path * (e2 - e1)
    if lines == -2:
        here = path * (e0 - 1.5 * e1 + 0.5 * e2)
        return here, path * (2.0 * e1 - e2), 0.5 * path * (e2 - e1)
    return path * (e0 - e1), path * e1, 0.0


@njit(cache=True, nogil=True)
def _node(
    source: Array,
    out: Array,
    p: int,
    q: int,
    step: int,
    reach: Reach,
    ray: Ray,
) -> float:
    """Return the radiance at any node: beside walls, or where the smooth forms undershoot."""
    first, before, past, lines, start, other, here = reach
    line, low = np.uint64(p - step), np.uint64(first)
    brought = _weighted(out, line, low, before)
    added = here * source[p, q] + _weighted(source, line, low, past)
    added += _weighted(source, np.uint64(p + lines * step), np.uint64(start), other)
    light: float = brought + added
    if brought < 0.0 or added < 0.0:
        light = _linear(source, out, p, q, step, ray)
    return light


@njit(cache=True, nogil=True)
def _linear(source: Array, out: Array, p: int, q: int, step: int, ray: Ray) -> float:
    """Return the radiance at a node by linear forms. Apart, it leaves its caller fast."""
    shift, left, path, e0, e1 = ray[:5]
    line, neighbour = p - step, q - 1 if shift > 0.0 else q + 1
    share = abs(shift)
    brought: float = share * out[line, neighbour] + (1.0 - share) * out[line, q]
    past: float = share * source[line, neighbour] + (1.0 - share) * source[line, q]
    here: float = source[p, q]
    return left * brought + path * ((e0 - e1) * here + e1 * past)


@njit(cache=True, nogil=True)
def _reach(q: int, n_nodes: int, done: int, last: bool, ray: Ray) -> Reach:
    """Return what a node's radiance is the sum of, by smooth forms.

    The first of four nodes a line before, what their radiance weighs and what their sources do;
    how many lines off the third point of the parabola lies, its first node and weights; and the
    weight of the source at the node itself.
    """
    shift, left = ray[:2]
    first, past = _around(q - shift, n_nodes)
    before = past
    away = q if shift > 0.0 else n_nodes - 1 - q
    if away <= 2 and shift != 0.0:
        w1, w2, w3 = ray[6:9] if away == 1 else ray[9:12]
        before = (0.0, w1, w2, w3) if shift > 0.0 else (w3, w2, w1, 0.0)
    ahead, origin = q + shift, q - 2.0 * shift
    lines, start, other = 0, first, past
    if not last and 0.0 <= ahead <= n_nodes - 1.0:
        lines, (start, other) = 1, _around(ahead, n_nodes)
    elif done > 1 and 0.0 <= origin <= n_nodes - 1.0:
        lines, (start, other) = -2, _around(origin, n_nodes)
    at_node, upstream, leaning = _parabola(lines, ray)
    return (
        first,
        _times(left, before),
        _times(upstream, past),
        lines,
        start,
        _times(leaning, other),
        at_node,
    )


@njit(cache=True, nogil=True)
def _around(position: float, n_nodes: int) -> tuple[int, Weights]:
    """Return the first of the four nodes around a position, and their cubic weights."""
    first = min(max(math.floor(position) - 1, 0), n_nodes - 4)
    return first, cubic_weights(position - first)


@njit(cache=True, nogil=True)
def _times(factor: float, weights: Weights) -> Weights:
    w0, w1, w2, w3 = weights
    return factor * w0, factor * w1, factor * w2, factor * w3


@njit(cache=True, nogil=True)
def _weighted(field: Array, line: int, first: int, weights: Weights) -> float:
    """Return the sum of four nodes of a line. Unsigned indices spare the test for negative ones."""
    w0, w1, w2, w3 = weights
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    near: float = w0 * field[line, first] + w1 * field[line, first + one]
    far: float = w2 * field[line, first + two] + w3 * field[line, first + three]
    return near + far


@njit(cache=True, nogil=True)
def cubic_weights(position: float) -> Weights:
    """Return the Lagrange weights of nodes 0, 1, 2, 3 for a point at ``position``."""
    a, b, c, d = position, position - 1.0, position - 2.0, position - 3.0
    sixth = 1.0 / 6.0
    return -b * c * d * sixth, 0.5 * a * c * d, -0.5 * a * b * d, a * b * c * sixth


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
