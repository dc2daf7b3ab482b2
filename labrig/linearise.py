"""From a session's counts to linear pictures of the tank: merged, oriented, black subtracted."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.hdr import Radiance, merge
from calibration.model import CameraModel
from labrig.config import parse
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.models.setup import Setup
from labrig.session import Session

Array = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictures:
    """The tank as the camera saw it, rows along the lit face, columns into the depth.

    Attributes
    ----------
    stripes, stripes_variance : (n_shifts, rows, cols), counts/s, black subtracted
    white, white_variance : (rows, cols) likewise; None without white frames
    black, black_variance : (rows, cols), what was subtracted, above the dark level; None if
        nothing was. It is common to all shifts, so its variance is not in theirs
    captured : (rows, cols), the first stripe picture with nothing subtracted
    pixel : side of a pixel, in ``unit``
    unit : "mm", or "px" where the scale is unknown
    saturated_fraction : pixels without any unsaturated exposure
    notes : what was missing and what was done instead
    """

    stripes: Array
    stripes_variance: Array
    white: Array | None
    white_variance: Array | None
    black: Array | None
    black_variance: Array | None
    captured: Array
    pixel: float
    unit: str
    saturated_fraction: float
    notes: tuple[str, ...]


def linearise(session: Session, setup: Setup) -> Mapping[str, Radiance]:
    """Merge the bracket of every picture of a session, by role and shift: ``stripes-3``, ``white``.

    Dark frames of the same exposure give the offset, else the camera's declared black level.

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
    camera = setup.camera.record()
    by_picture: dict[str, list[Shot]] = defaultdict(list)
    for shot in _shots(session):
        by_picture[shot.role if shot.shift is None else f"{shot.role}-{shot.shift}"].append(shot)
    darks = _dark_levels(session, by_picture.pop("dark", []), camera)
    _shift_names(session)
    return {
        name: merge(
            [session.read(shot.id) for shot in shots],
            [shot.exposure_s for shot in shots],
            [darks.get(shot.exposure_s, camera.black_level_dn) for shot in shots],
            camera,
        )
        for name, shots in by_picture.items()
        if name != "flat"
    }


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


def rectify(radiances: Mapping[str, Radiance], session: Session, setup: Setup) -> Pictures:
    """Cut the region out, turn the lit side to the left, subtract black from the rest.

    Raises
    ------
    AnalysisRefusedError
        If a shift of the stripes is missing, or lengths are given in mm but no scale.
    """
    shifts = _shift_names(session)
    sizes = {radiance.value.shape for radiance in radiances.values()}
    if len(sizes) > 1:
        msg = (
            f"session {session.path.name} holds pictures of {sorted(sizes)} px; all must be equal."
        )
        raise AnalysisRefusedError(msg)
    notes = _notes(session, setup, radiances)
    unit, pixel = ("mm", setup.geometry.mm_per_px) if setup.geometry.mm_per_px else ("px", 1.0)
    if unit == "px" and (setup.tank or setup.beam or setup.projection):
        msg = "tank, beam and projection are in mm, but geometry.mm_per_px is not given; add it."
        raise AnalysisRefusedError(msg)
    dark_name = next((name for name in ("black", "ambient") if name in radiances), None)

    def values(name: str) -> Array:
        return _turned(radiances[name].value, setup).astype(np.float64)

    def variances(name: str) -> Array:
        return _turned(radiances[name].variance, setup).astype(np.float64)

    black = values(dark_name) if dark_name else None
    stripes = np.stack([values(name) for name in shifts])
    captured = stripes[0].copy()
    white = values("white") if "white" in radiances else None
    white_variance = variances("white") if "white" in radiances else None
    if black is not None and dark_name is not None:
        stripes -= black
        if white is not None and white_variance is not None:
            white, white_variance = white - black, white_variance + variances(dark_name)
    lost = [~_turned(radiances[name].valid, setup) for name in shifts]
    return Pictures(
        stripes=stripes,
        stripes_variance=np.stack([variances(name) for name in shifts]),
        white=white,
        white_variance=white_variance,
        black=black,
        black_variance=variances(dark_name) if dark_name else None,
        captured=captured,
        pixel=float(pixel or 1.0),
        unit=unit,
        saturated_fraction=float(np.mean(np.any(lost, axis=0))),
        notes=tuple(notes),
    )


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


def _shots(session: Session) -> list[Shot]:
    source = f"session {session.path.name}"
    return [parse(r, Shot, source=f"{source}: shot {r['id']!r}") for r in session.shots]


def _shift_names(session: Session) -> list[str]:
    stripes = [shot for shot in _shots(session) if shot.role == "stripes"]
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


def _turned(picture: NDArray[T], setup: Setup) -> NDArray[T]:
    """Return the region with the lit side left, cut to the tank where that is given."""
    geometry = setup.geometry
    x, y, width, height = geometry.region_px or (0, 0, picture.shape[1], picture.shape[0])
    if x + width > picture.shape[1] or y + height > picture.shape[0]:
        msg = (
            f"region_px {[x, y, width, height]} leaves the picture of "
            f"{picture.shape[1]} x {picture.shape[0]} px; mend it."
        )
        raise AnalysisRefusedError(msg)
    region = picture[y : y + height, x : x + width]
    if geometry.lit_side == "right":
        region = region[:, ::-1]
    elif geometry.lit_side == "top":
        region = region.T
    elif geometry.lit_side == "bottom":
        region = region[::-1].T
    if setup.tank is not None and geometry.mm_per_px is not None:
        rows = round(setup.tank.width_mm / geometry.mm_per_px)
        cols = round(setup.tank.depth_mm / geometry.mm_per_px)
        region = region[:rows, :cols]
    return region


def _notes(session: Session, setup: Setup, radiances: Mapping[str, Radiance]) -> list[str]:
    notes = []
    if not session.sealed:
        notes.append("The session was interrupted: it is not sealed.")
    if setup.camera.record().floor_variance_dn2 is None:
        notes.append(
            "Gain or read noise of the camera is unknown: no variance map, no detection limit; "
            "standard deviations come from the scatter of rows."
        )
    if setup.geometry.mm_per_px is None:
        notes.append("The scale of the picture is unknown: lengths are in px.")
    if "black" not in radiances:
        instead, remains = (
            ("the ambient picture", "the projector's leak remains")
            if "ambient" in radiances
            else ("nothing", "the projector's leak and ambient light remain")
        )
        notes.append(
            f"There is no black picture: {instead} was subtracted; {remains} in the multiple "
            "scattering."
        )
    if "white" not in radiances:
        notes.append("There is no white picture: no closure, and no fit without separation.")
    roles = {shot.role for shot in _shots(session)}
    if "dark" not in roles:
        notes.append("There are no dark frames: the declared black level is the offset.")
    if "flat" in roles:
        notes.append("Flat frames are kept in the session but not used by this version.")
    return notes
