"""What the shifts of stripes say against one another: together they are even light.

Stripes and the same moved by half a period are white and black together, whatever the sample does
with them; so is twice the mean over an odd number of shifts, but for its own harmonics. A frame
that saw another pattern, or two, or was exposed otherwise, spoils its sum; a camera whose response
is bent spoils them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrig.acquisition.thinned import Array, Mask, Thinned, typical

ENOUGH_PIXELS = 50
UNEVEN = 0.02  # standard deviation of a brightness that says too little
SURE = 5.0  # standard deviations of noise that a contradiction must exceed


@dataclass(frozen=True, slots=True, kw_only=True)
class Sums:
    """How far shifts are from even light.

    Attributes
    ----------
    residual : rms of what does not add up as a share of the light, zero where noise explains it
    stripes : share of one picture's stripes found in the mean of an odd number of shifts, zero
        where noise explains it: how wrong one picture is, however little of the light stripes are
    worst : which shifts, in words
    brightness : of the shifts over what white and black let expect; None without these
    """

    residual: float
    stripes: float
    worst: str
    brightness: float | None


def add_up(shifts: Sequence[Thinned], lit: tuple[Thinned, Thinned] | None) -> Sums | None:
    """Return how far the shifts of a group are from adding up; None if nothing can be said.

    Parameters
    ----------
    shifts : N pictures, moved by k/N of a period, of one exposure
    lit : white and black of the same sample, at any exposure; without them two shifts, or an odd
        number, have nothing to be compared with
    """
    n = len(shifts)
    usable = ~np.any([shift.clipped for shift in shifts], axis=0)
    if lit is not None:
        usable &= ~lit[0].clipped & ~lit[1].clipped
    if usable.sum() < ENOUGH_PIXELS:
        return None
    light = np.array([shift.light[usable] for shift in shifts])
    variance = np.array([shift.variance[usable] for shift in shifts])
    half = None if lit is None else _half(lit, shifts[-1], usable)
    if n % 2 == 0:
        return _of_pairs(light, variance, half)
    return None if half is None else _of_odd(light, variance, half)


def _half(lit: tuple[Thinned, Thinned], like: Thinned, usable: Mask) -> tuple[Array, Array]:
    """Return half of white and black with its variance, at another picture's exposure."""
    (white, white_var), (black, black_var) = (f.at(like.exposure_s, like.lamp) for f in lit)
    return 0.5 * (white + black)[usable], 0.25 * (white_var + black_var)[usable]


def _of_pairs(light: Array, variance: Array, half: tuple[Array, Array] | None) -> Sums | None:
    """Hold the mean of each pair, and half of white and black, to the mean of all of these."""
    n = len(light) // 2
    rows = 0.5 * (light[:n] + light[n:])
    noise = 0.25 * (variance[:n] + variance[n:]).mean(axis=1)
    if half is not None:
        rows, noise = np.vstack([rows, half[0]]), np.append(noise, half[1].mean())
    if len(rows) < 2:
        return None
    weight = 1.0 / noise / np.sum(1.0 / noise)
    common = weight @ rows
    power = float(np.mean(common**2))
    if power <= 0.0:
        return None
    lamp = rows @ common / (common.size * power)
    apart = (rows - lamp[:, None] * common) / (1.0 - weight[:, None])  # from the mean of the others
    expected = noise / (1.0 - weight)
    excess = _above_noise(typical(apart**2), expected, common.size)
    worst = int(excess[:n].argmax())
    return Sums(
        residual=float(np.sqrt(excess[:n].max() / power)),
        stripes=0.0,
        worst=f"shifts {worst} and {worst + n} do not add up as the others do"
        if n > 1
        else "shifts 0 and 1 do not add up to white and black",
        brightness=None if half is None else float(lamp[:n].mean() / lamp[n]),
    )


def _of_odd(light: Array, variance: Array, half: tuple[Array, Array]) -> Sums | None:
    """Seek the stripes themselves in the mean over the shifts: from there they must be gone.

    The mean over N shifts holds harmonics N, 2N, .. of the stripes and nothing of the first, so
    that it does not move with their phase, which is seen at every pixel.
    """
    n = len(light)
    turn = np.exp(-2j * np.pi * np.arange(n) / n)
    stripes = 2.0 / n * np.tensordot(turn, light, axes=1)
    mean, even = light.mean(axis=0), half[0]
    power = float(np.mean(even**2) - np.mean(half[1]))
    seen = float(np.mean(np.abs(stripes) ** 2) - 4.0 / n * np.mean(variance))
    if power <= 0.0 or seen <= 0.0:
        return None
    brightness = float(mean @ even) / even.size / power
    rest = mean - brightness * even
    left = rest * stripes.conj()
    unsure = np.sqrt(np.mean(np.abs(left) ** 2) / even.size) / seen
    found = float(abs(left.mean())) / seen
    # one frame's fault is spread over the mean of N; told as large as in the sum of a pair
    wrong = 0.5 * n * found if found > SURE * unsure else 0.0
    # harmonics that the mean keeps make it uneven, and few pixels may not average that out
    uneven = np.sqrt(np.mean((rest * even) ** 2) / even.size) / power
    return Sums(
        residual=wrong * float(np.sqrt(0.5 * seen / power)) / brightness,
        stripes=wrong,
        worst=f"the mean of the {n} shifts still has their stripes",
        brightness=brightness if uneven < UNEVEN else None,
    )


def _above_noise(squares: Array, noise: Array, n_pixels: int) -> NDArray[np.float64]:
    excess = squares - noise
    excess[excess < SURE * noise * np.sqrt(2.0 / n_pixels)] = 0.0
    return excess
