"""Patterns of a session that were shown beside their inverses, with white and black."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from labrig.calibrating.camera import Source
from labrig.models.plan import Shot

Array = NDArray[np.float64]
Shots = tuple[Shot, ...]
Seen = tuple[list[tuple[Array, Array]], Array, Array]

MAX_PIXELS = 60_000  # of a half of the picture
BRIGHT_SHARE = 0.2  # of the brightest white less black, for pixels that are heard
MIN_PIXELS = 1000


@dataclass(frozen=True, slots=True)
class Pairs:
    """Shots of patterns and inverses, white and black, all of one exposure.

    Attributes
    ----------
    periods_px : (n_pairs,), projector px
    sides : for each pair the shots of the pattern, and of its inverse
    """

    periods_px: Array
    sides: tuple[tuple[Shots, Shots], ...]
    white: Shots
    black: Shots

    @classmethod
    def of(cls, source: Source) -> Pairs | None:
        """Return the pairs of Grey-code bits and of stripes half a period apart; None without any.

        Of several exposures the longest that does not saturate half of what is lit.
        """
        for exposure_s in sorted({s.exposure_s for s in source.of("white")}, reverse=True):
            shots = [s for s in source.shots if s.exposure_s == exposure_s]
            pairs = [*_of_grey_code(shots), *_of_stripes(source, shots)]
            white, black = (tuple(s for s in shots if s.role == r) for r in ("white", "black"))
            if pairs and black:
                periods = np.array([period for period, _ in pairs])
                found = cls(periods, tuple(sides for _, sides in pairs), white, black)
                if found._whole(source)[0] > 0.5:
                    return found
        return None

    @property
    def shots(self) -> Shots:
        """Every shot, once."""
        return (
            *self.white,
            *self.black,
            *(s for pair in self.sides for side in pair for s in side),
        )

    def seen(self, source: Source, black_level_dn: float, half: Literal["left", "right"]) -> Seen:
        """Return pairs, white and black of bright pixels of half the picture, counts above black.

        Raises
        ------
        CalibrationError
            If too few pixels are bright and not saturated.
        """
        _, whole = self._whole(source)
        middle = whole.shape[1] // 2
        whole[:, middle:] &= half == "right"
        whole[:, :middle] &= half == "left"
        at = np.flatnonzero(whole)
        if at.size < MIN_PIXELS:
            msg = f"{at.size} pixels of the {half} half are lit and not saturated; light it evenly."
            raise CalibrationError(msg)
        at = np.random.default_rng(1).permutation(at)[:MAX_PIXELS]

        def mean(shots: Shots) -> Array:
            frames = [source.read(shot).reshape(-1)[at] for shot in shots]
            return np.asarray(np.mean(frames, axis=0, dtype=np.float64) - black_level_dn)

        pairs = [(mean(plain), mean(inverse)) for plain, inverse in self.sides]
        return pairs, mean(self.white), mean(self.black)

    def _whole(self, source: Source) -> tuple[float, NDArray[np.bool_]]:
        """Return which pixels are lit and not saturated in white, and their share of the lit."""
        white, black = (source.read(s[0]).astype(np.float64) for s in (self.white, self.black))
        contrast = white - black
        lit = contrast > BRIGHT_SHARE * np.percentile(contrast, 99.0)
        whole = lit & (white < source.setup.camera.record().saturation_dn)
        return float(whole.sum() / max(lit.sum(), 1)), whole


def _of_grey_code(shots: list[Shot]) -> list[tuple[float, tuple[Shots, Shots]]]:
    found: dict[tuple[str, int], dict[str, list[Shot]]] = defaultdict(lambda: defaultdict(list))
    for shot in shots:
        if shot.axis is not None and shot.bit is not None and shot.polarity is not None:
            found[shot.axis, shot.bit][shot.polarity].append(shot)
    return [
        (4.0 * 2**bit, (tuple(sides["plain"]), tuple(sides["inverse"])))
        for (_, bit), sides in sorted(found.items())
        if len(sides) == 2
    ]


def _of_stripes(source: Source, shots: list[Shot]) -> list[tuple[float, tuple[Shots, Shots]]]:
    told = source.setup.stripes
    taken = [s for s in shots if s.role == "stripes"]
    # the setup tells of one period; only full stripes of equal widths have an inverse
    full = told is not None and (told.duty, told.low, told.high) == (0.5, 0.0, 1.0)
    if told is None or not full or len({s.set for s in taken}) != 1:
        return []
    n = taken[0].shifts or 0
    found = []
    for k in range(n // 2 if n % 2 == 0 else 0):
        plain, inverse = (tuple(s for s in taken if s.shift == j) for j in (k, k + n // 2))
        if plain and inverse:
            found.append((told.period_px, (plain, inverse)))
    return found
