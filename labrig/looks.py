"""What a picture itself says against its exposure or its pattern, where clocks cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.models.plan import Shot
from labrig.rig import OpenRig

RATIO_TOLERANCE = 0.03  # of brightness between two brackets of one pattern
SAMPLE = 20_000  # pixels at random places: a regular grid of them could fit the stripes' period
ENOUGH_PIXELS = 50
ALIKE, DIFFERENT = 2.0, 8.0  # chi^2 of two frames: one pattern gives 1, two that can be told more
FEWER = 4  # of the sample, where all shifts of a group are compared
MANY_GROUPS = 16  # brackets that alternate; of older groups all shifts have been seen
PILED, LEAST_NOISE_DN = 0.02, 1.5  # share of pixels at one value that such noise cannot explain


class Cause(StrEnum):
    """Why an attempt gave no frame; each has its own counter and its own remedy."""

    NOT_FIRED = "trigger-not-fired"
    NO_FRAME = "no-frame"
    EARLY = "early"
    DUPLICATE = "duplicate"
    CORRUPT = "corrupt"
    WRONG_EXPOSURE = "wrong-exposure"
    WRONG_PATTERN = "wrong-pattern"
    DEVICE_LOST = "device-lost"


class Looks:
    """Remembers accepted pictures, thinned, and holds new ones to them.

    ``lamp`` is the light of the last reference, as a share of the first.
    """

    def __init__(self, rig: OpenRig) -> None:
        self._rig = rig
        self._brackets: dict[tuple[str, str | None], tuple[float, float, NDArray[np.float64]]] = {}
        self._last: tuple[Shot, NDArray[np.float64]] | None = None
        self._visible: set[str] = set()
        self.lamp = 1.0
        self._at: tuple[int, NDArray[np.int64]] | None = None
        self._groups: dict[str, dict[int, NDArray[np.float64]]] = {}

    def doubt(
        self, shot: Shot, pixels: NDArray[np.uint16], details: dict[str, Any]
    ) -> tuple[Cause, str] | None:
        """Return what speaks against a picture; None if nothing does, and then remember it.

        Two ways: against the same pattern at the neighbour bracket, the brightness must follow
        the exposure; against the shot before, a new pattern must be seen to have come, in a set
        whose patterns have been told apart before.
        """
        thin = pixels.ravel()[self._places(pixels.size)].astype(np.float64)
        ratio = self._ratio(shot, thin)
        if ratio is not None:
            details["bracket_ratio"] = ratio
            if abs(ratio - 1.0) > RATIO_TOLERANCE:
                return Cause.WRONG_EXPOSURE, (
                    f"the frame is {ratio:.3f} times as bright as its neighbour bracket lets "
                    "expect; the exposure is not the one reported."
                )
        chi2 = self._chi2(shot, thin)
        if chi2 is not None:
            details["change_chi2"] = chi2
            if chi2 < ALIKE and shot.set in self._visible:
                return Cause.WRONG_PATTERN, (
                    f"the picture is that of shot {self._last[0].id if self._last else ''} (chi^2 "
                    f"{chi2:.2f}), though the pattern is another; the projector did not change."
                )
            if chi2 > DIFFERENT and self._last is not None and self._last[0].set == shot.set:
                self._visible.add(shot.set)
        self._brackets[shot.set, shot.pattern] = (shot.exposure_s, self.lamp, thin)
        self._last = (shot, thin)
        self._remember_shift(shot, thin)
        if (clipped_dn := self._clipped(thin)) is not None:
            details["clipped_at_dn"] = clipped_dn
        return None

    def group_residual(self, shot: Shot) -> tuple[float, str] | None:
        """Return by how much the shifts of a group contradict one another, once all are there.

        Stripes and the same moved by half a period together are white light, whatever the sample
        does with it. So all such pairs must sum to one picture, up to the lamp's brightness; a
        frame that saw another pattern, or two, or was exposed otherwise, spoils its pair's sum.

        Returns
        -------
        The rms residual of the worst pair as a share of the light, zero where noise explains it,
        and the pair in words. None if the group is incomplete, or has an odd number of shifts, or
        one pair alone.
        """
        n, seen = shot.shifts or 0, self._shifts_of(shot)
        if n % 2 or n < 4 or len(seen) < n:
            return None
        frames = np.array([seen[k] for k in range(n)])
        black, white = self._rig.black_level_dn, self._rig.camera_can.white_level_dn
        frames = frames[:, (frames < 0.95 * white).all(axis=0)]
        if frames.shape[1] < ENOUGH_PIXELS:
            return None
        variance = self._rig.variance_dn2(frames)
        pairs = frames[: n // 2] + frames[n // 2 :] - 2.0 * black
        noise = (variance[: n // 2] + variance[n // 2 :]).mean(axis=1) * (1.0 - 2.0 / n)
        common = pairs.mean(axis=0)
        power = float(np.mean(common**2))
        lamp = pairs @ common / (frames.shape[1] * power) if power else np.ones(n // 2)
        excess = np.mean((pairs - lamp[:, None] * common) ** 2, axis=1) - noise
        excess[excess < 5.0 * noise * np.sqrt(2.0 / frames.shape[1])] = 0.0
        worst = int(excess.argmax())
        share = float(np.sqrt(excess[worst] / power)) if power else 0.0
        return share, (
            f"shifts {worst} and {worst + n // 2} of group {shot.group} do not add up as the "
            f"others do, by {100.0 * share:.1f} % of the light; one of them saw another pattern, "
            "or two, or another exposure."
        )

    def _shifts_of(self, shot: Shot) -> dict[int, NDArray[np.float64]]:
        return self._groups.get(shot.group, {})

    def _remember_shift(self, shot: Shot, thin: NDArray[np.float64]) -> None:
        """Keep a stripe picture for its group; a first shift begins the group anew."""
        if shot.shift is None:
            return
        if shot.shift == 0:
            self._groups.pop(shot.group, None)
        self._groups.setdefault(shot.group, {})[shot.shift] = thin[::FEWER]
        while len(self._groups) > MANY_GROUPS:
            del self._groups[next(iter(self._groups))]

    def _clipped(self, thin: NDArray[np.float64]) -> float | None:
        """Return the counts at which the sensor clips below its white level; None if it does not.

        Noise spreads the brightest pixels; many of them at one value mean that it was cut there.
        """
        top = float(thin.max())
        white = self._rig.camera_can.white_level_dn
        noisy = float(self._rig.variance_dn2(np.array([top]))[0]) > LEAST_NOISE_DN**2
        piled = np.mean(thin == top) > PILED
        return top if noisy and piled and top < white else None

    def _places(self, size: int) -> NDArray[np.int64]:
        if self._at is None or self._at[0] != size:
            rng = np.random.default_rng(size)
            n = min(size, SAMPLE)
            self._at = (size, np.sort(rng.choice(size, n, replace=False, shuffle=False)))
        return self._at[1]

    def _ratio(self, shot: Shot, now: NDArray[np.float64]) -> float | None:
        """Return brightness over what the neighbour bracket lets expect; None if too dark."""
        unknown = (shot.exposure_s, self.lamp, now)
        before_s, lamp, before = self._brackets.get((shot.set, shot.pattern), unknown)
        if before_s == shot.exposure_s or shot.shutter == "covered":
            return None
        black, white = self._rig.black_level_dn, self._rig.camera_can.white_level_dn
        usable = (now < 0.95 * white) & (before < 0.95 * white)
        usable &= np.minimum(now, before) > black + 0.05 * (white - black)
        if usable.sum() < ENOUGH_PIXELS:
            return None
        brighter = (now[usable] - black).sum() / (before[usable] - black).sum()
        return float(brighter * before_s * lamp / (shot.exposure_s * self.lamp))

    def _chi2(self, shot: Shot, now: NDArray[np.float64]) -> float | None:
        """Return the squared difference to the frame before over noise; None if not comparable."""
        if self._last is None:
            return None
        last, before = self._last
        same_scene = last.exposure_s == shot.exposure_s and last.shutter == shot.shutter
        if last.pattern == shot.pattern or not same_scene or shot.shutter == "covered":
            return None
        variance = self._rig.variance_dn2(now) + self._rig.variance_dn2(before)
        return float(np.mean((now - before) ** 2 / variance))


def poor(details: Mapping[str, Any], white_level_dn: int, allowed: float | None) -> list[str]:
    """Return what makes a frame that counts a poor one, in words.

    Parameters
    ----------
    allowed : share of pixels that may be saturated; None for the long exposures of a bracket,
        which are meant to clip
    """
    told = []
    share = details["saturated_fraction"]
    if allowed is not None and share > allowed:
        told.append(f"{100.0 * share:.2g} % of the pixels are saturated.")
    if "clipped_at_dn" in details:
        told.append(
            f"pixels pile up at {details['clipped_at_dn']:.0f} DN, below the white level of "
            f"{white_level_dn} DN; correct white_level_dn."
        )
    return told
