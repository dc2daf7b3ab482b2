"""From a session's counts to linear light: the bracket of every picture merged."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.hdr import Offset, Radiance, merge
from calibration.model import CameraModel
from labrig.config import parse
from labrig.corrections import Corrections
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import Session

Array = NDArray[np.float64]

LIGHT = frozenset({"stripes", "white", "black", "ambient"})  # roles that are merged and separated


def linearise(
    session: Session, setup: Setup, known: Corrections | None = None
) -> Mapping[str, Radiance]:
    """Merge the bracket of every picture of a session, by role and shift: ``stripes-3``, ``white``.

    A dark record gives the offset of every pixel; else dark frames of the same exposure give one
    for all, else the camera's declared black level. Hot pixels of a record are masked.

    Raises
    ------
    AnalysisRefusedError
        If a shot of the plan is missing, or there are no stripes.
    SessionError, CalibrationError
        If a frame is damaged, or a bracket saturated throughout.
    """
    if session.missing:
        msg = (
            f"session {session.path.name}: {len(session.missing)} of {len(session.shots)} shots "
            f"are missing ({session.missing[0]} first); capture it anew."
        )
        raise AnalysisRefusedError(msg)
    _refuse_mixed_segments(session)
    known = known or Corrections(camera=setup.camera.record())
    camera = known.camera
    by_picture: dict[str, list[Shot]] = defaultdict(list)
    for shot in shots_of(session):
        by_picture[shot.role if shot.shift is None else f"{shot.role}-{shot.shift}"].append(shot)
    darks = _dark_levels(session, by_picture.pop("dark", []), camera)
    shift_names(session)
    _refuse_mixed_patterns(session, by_picture)

    def offset(exposure_s: float) -> Offset:
        if known.dark is not None:
            return known.dark.at(exposure_s)
        return darks.get(exposure_s, camera.black_level_dn)

    return {
        name: _without_hot(
            merge(
                (session.read(shot.id) for shot in shots),
                [shot.exposure_s for shot in shots],
                [offset(shot.exposure_s) for shot in shots],
                camera,
                known.flat,
            ),
            known,
        )
        for name, shots in by_picture.items()
        if shots[0].role in LIGHT
    }


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


def shift_names(session: Session) -> list[str]:
    """Return the names of the stripe pictures, in order of their shift.

    Raises
    ------
    AnalysisRefusedError
        If shifts of a period are missing, or there are none or several series.
    """
    stripes = [shot for shot in shots_of(session) if shot.role == "stripes"]
    series = {shot.shifts for shot in stripes if shot.shifts is not None}
    if not stripes:
        msg = f"session {session.path.name} holds no stripe pictures; nothing can be separated."
        raise AnalysisRefusedError(msg)
    if len(series) != 1:
        msg = (
            f"session {session.path.name} holds {len(series)} series of stripes; one whose shifts "
            "cover a period is needed to separate."
        )
        raise AnalysisRefusedError(msg)
    n = series.pop()
    have = {shot.shift for shot in stripes}
    absent = sorted(set(range(n)) - have)
    if absent:
        msg = (
            f"shift {absent[0]} of {n} is missing ({len(have)} are there): a separation needs all "
            "shifts of a period."
        )
        raise AnalysisRefusedError(msg)
    return [f"stripes-{k}" for k in range(n)]
