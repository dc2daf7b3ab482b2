"""From a session's counts to linear light: the bracket of every picture merged."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.hdr import Offset, Radiance, merge
from calibration.model import CameraModel
from labrig.config import parse
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import Session
from labrig.steps.corrections import Corrections
from labrig.steps.lost_shift import HALF, from_the_others, lost_pictures, refuse_unless_replaceable

Array = NDArray[np.float64]

WORKERS = 2  # pictures merged side by side; each holds its sums, so that more would cost memory
LIGHT = frozenset({"stripes", "white", "black", "ambient"})  # roles that are merged and separated


def linearise(
    session: Session, setup: Setup, known: Corrections | None = None
) -> Mapping[str, Radiance]:
    """Merge the bracket of every picture of a session, by role and shift: ``stripes-3``, ``white``.

    A picture of stripes that was lost is what its opposite leaves of their constant sum: each half
    period's shift lights what the other left dark.

    A dark record gives the offset of every pixel; else dark frames of the same exposure give one
    for all, else the camera's declared black level. Hot pixels of a record are masked.

    Raises
    ------
    AnalysisRefusedError
        If more shots of the plan are missing than a shift of stripes, or there are no stripes.
    SessionError, CalibrationError
        If a frame is damaged, or a bracket saturated throughout.
    """
    _refuse_mixed_segments(session)
    known = known or Corrections(camera=setup.camera.record())
    camera = known.camera
    by_picture: dict[str, list[Shot]] = defaultdict(list)
    for shot in shots_of(session):
        by_picture[_picture_of(shot)].append(shot)
    series = series_of(session)
    lost = lost_pictures(session, {n: [s.id for s in shots] for n, shots in by_picture.items()})
    duty = setup.stripes.duty if setup.stripes is not None else HALF
    refuse_unless_replaceable(session, lost, [(one.names, duty) for one in series])
    by_picture = {name: shots for name, shots in by_picture.items() if name not in lost}
    darks = _dark_levels(session, by_picture.pop("dark", []), camera)
    _refuse_mixed_patterns(session, by_picture)

    def offset(exposure_s: float) -> Offset:
        if known.dark is not None:
            return known.dark.at(exposure_s)
        return darks.get(exposure_s, camera.black_level_dn)

    def merged(shots: list[Shot]) -> Radiance:
        frames = (session.read(shot.id) for shot in shots)
        times_s = [shot.exposure_s for shot in shots]
        offsets = [offset(time_s) for time_s in times_s]
        return _without_hot(merge(frames, times_s, offsets, camera, known.flat), known)

    lit = {name: shots for name, shots in by_picture.items() if shots[0].role in LIGHT}
    with ThreadPoolExecutor(WORKERS) as pool:
        found = dict(zip(lit, pool.map(merged, lit.values()), strict=True))
    for one in series:
        for name in set(one.names) & set(lost):
            found[name] = from_the_others(one.names, name, found)
    return found


def _refuse_mixed_patterns(session: Session, by_picture: Mapping[str, list[Shot]]) -> None:
    """Pictures of one name are merged; those of other stripes must not be among them."""
    for name, shots in by_picture.items():
        patterns = {shot.pattern for shot in shots if shot.pattern is not None}
        if len(patterns) > 1:
            msg = (
                f"session {session.path.name}: {name} was taken with {len(patterns)} patterns; "
                "only stripes of one period can be analysed together."
            )
            raise AnalysisRefusedError(msg)


def _refuse_mixed_segments(session: Session) -> None:
    """Light may differ between segments; the shifts of one group must have the same."""
    segments: dict[str, set[object]] = defaultdict(set)
    for shot in session.shots:
        group = str(shot.get("group", shot["id"]))
        if shot["id"] in session.frames:
            segments[group].add(session.frames[shot["id"]].details.get("segment"))
    mixed = sorted(group for group, found in segments.items() if len(found) > 1)
    if mixed:
        msg = (
            f"session {session.path.name}: group {mixed[0]} was taken in several segments, between "
            "which the light may differ; capture it anew."
        )
        raise AnalysisRefusedError(msg)


def _without_hot(radiance: Radiance, known: Corrections) -> Radiance:
    """Return a picture without the pixels that a dark record calls hot; nothing is put there."""
    if known.dark is None or not known.dark.hot.any():
        return radiance
    value = np.where(known.dark.hot, np.float32(np.nan), radiance.value)
    return replace(radiance, value=value, valid=radiance.valid & ~known.dark.hot)


def _dark_levels(session: Session, darks: list[Shot], camera: CameraModel) -> dict[float, float]:
    """Return the mean of the dark frames of each exposure, DN.

    Raises
    ------
    AnalysisRefusedError
        If a dark frame is bright: the cap was off.
    """
    levels: dict[float, list[float]] = defaultdict(list)
    for shot in darks:
        level = float(session.read(shot.id).mean())
        if level > camera.black_level_dn + 0.25 * (camera.white_level_dn - camera.black_level_dn):
            msg = (
                f"dark frame {shot.id} has a mean of {level:.0f} DN, the black level is "
                f"{camera.black_level_dn:g}: was the lens capped?"
            )
            raise AnalysisRefusedError(msg)
        levels[shot.exposure_s].append(level)
    return {exposure_s: float(np.mean(found)) for exposure_s, found in levels.items()}


def shots_of(session: Session) -> list[Shot]:
    """Return the shots that a session names."""
    source = f"session {session.path.name}"
    return [parse(r, Shot, source=f"{source}: shot {r['id']!r}") for r in session.shots]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftSeries:
    """The pictures of one series of stripes, in order of their shift; lengths in projector px."""

    names: tuple[str, ...]
    period_px: float | None = None
    low: float = 0.0
    high: float = 1.0


def series_of(session: Session) -> tuple[ShiftSeries, ...]:
    """Return every series of stripes, the one to be separated (the finest) first.

    Raises
    ------
    AnalysisRefusedError
        If shifts of a period are missing, or there are no stripes.
    """
    found: dict[str, list[Shot]] = defaultdict(list)
    for shot in shots_of(session):
        if shot.role == "stripes":
            found[shot.set].append(shot)
    if not found:
        msg = f"session {session.path.name} holds no stripe pictures; nothing can be separated."
        raise AnalysisRefusedError(msg)
    sets = {s["id"]: s["pattern"] for s in (session.header.get("plan") or {}).get("sets", ())}
    every = []
    for name, shots in found.items():
        pattern = sets.get(name, {})
        every.append(
            ShiftSeries(
                names=_whole_period(session, shots),
                period_px=pattern.get("period_px"),
                low=pattern.get("low", 0) / 255.0,
                high=pattern.get("high", 255) / 255.0,
            )
        )
    return tuple(sorted(every, key=lambda one: one.period_px or 0.0))


def _picture_of(shot: Shot) -> str:
    """Return the name of the picture that a shot is an exposure of."""
    if shot.shift is None:
        return shot.role
    return f"{shot.role}-{shot.shift}" if shot.set == shot.role else f"{shot.set}-{shot.shift}"


def _whole_period(session: Session, shots: list[Shot]) -> tuple[str, ...]:
    counts = {shot.shifts for shot in shots if shot.shifts is not None}
    if len(counts) != 1:
        msg = (
            f"session {session.path.name} holds stripes of {len(counts)} numbers of shifts in one "
            "series; one whose shifts cover a period is needed to separate."
        )
        raise AnalysisRefusedError(msg)
    n = counts.pop()
    by_shift = {shot.shift: _picture_of(shot) for shot in shots}
    absent = sorted(set(range(n)) - set(by_shift))
    if absent:
        msg = (
            f"shift {absent[0]} of {n} is missing ({len(by_shift)} are there): a separation needs "
            "all shifts of a period."
        )
        raise AnalysisRefusedError(msg)
    return tuple(by_shift[k] for k in range(n))
