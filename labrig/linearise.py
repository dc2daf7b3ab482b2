"""From a session's counts to linear pictures of the tank: merged, oriented, black subtracted."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Lens, Plane, Resampling, resampling
from calibration.hdr import Offset, Radiance, merge
from calibration.model import CameraModel
from labrig.config import parse
from labrig.corrections import Corrections
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.models.setup import Setup, StripesConfig
from labrig.picture_notes import notes_of
from labrig.session import Session

Array = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)

LIGHT = frozenset({"stripes", "white", "black", "ambient"})  # roles that are merged and separated


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """One series of shifted stripes.

    Attributes
    ----------
    net, variance : (n_shifts, rows, cols) float32, counts/s, black subtracted
    duty, low, high : lit share of the period; light of dark and lit stripes, shares of white
    square : whether the stripes are lit and dark, not a sinusoid
    contrast : c1 against depth, if it was measured
    """

    net: NDArray[np.float32]
    variance: NDArray[np.float32]
    duty: float = 0.5
    low: float = 0.0
    high: float = 1.0
    square: bool = True
    contrast: Callable[[Array], Array] | None = None

    @classmethod
    def main(cls, pictures: Pictures, setup: Setup) -> Series:
        """Return the series that is separated."""
        stripes = setup.stripes or StripesConfig()
        return cls(
            net=pictures.stripes,
            variance=pictures.stripes_variance,
            duty=stripes.duty,
            low=stripes.low,
            high=stripes.high,
            square=stripes.profile == "square",
            contrast=pictures.contrast,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictures:
    """The tank as the camera saw it, rows along the lit face, columns into the depth.

    Attributes
    ----------
    stripes, stripes_variance : (n_shifts, rows, cols) float32, counts/s, black subtracted
    white, white_variance : (rows, cols) likewise; None without white frames
    black, black_variance : (rows, cols), what was subtracted, above the dark level; None if
        nothing was. It is common to all shifts, so its variance is not in theirs
    leak : (rows, cols), the projector's part of black: ambient taken off where it is known; None
        without a black picture
    position_px : (rows, cols), projector px along the stripes' axis, from a projector record
    captured : (rows, cols), the first stripe picture with nothing subtracted
    pixel : side of a pixel, in ``unit``
    unit : "mm", or "px" where the scale is unknown
    saturated_fraction : pixels without any unsaturated exposure
    notes : what was missing and what was done instead
    contrast : c1 of ``stripes`` against depth, if a record knows it
    more : series of stripes of other periods
    """

    stripes: NDArray[np.float32]
    stripes_variance: NDArray[np.float32]
    white: Array | None
    white_variance: Array | None
    black: Array | None
    black_variance: Array | None
    leak: Array | None
    position_px: Array | None
    captured: Array
    pixel: float
    unit: str
    saturated_fraction: float
    notes: tuple[str, ...]
    contrast: Callable[[Array], Array] | None = None
    more: tuple[Series, ...] = ()


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
    for shot in _shots(session):
        by_picture[shot.role if shot.shift is None else f"{shot.role}-{shot.shift}"].append(shot)
    darks = _dark_levels(session, by_picture.pop("dark", []), camera)
    _shift_names(session)

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


def rectify(
    radiances: Mapping[str, Radiance],
    session: Session,
    setup: Setup,
    known: Corrections | None = None,
) -> Pictures:
    """Cut the region out, turn the lit side to the left, subtract black from the rest.

    With a geometry record the region is first resampled to even millimetres of the tank's plane.

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
    known = known or Corrections(camera=setup.camera.record())
    notes = notes_of(session, _shots(session), setup, frozenset(radiances), known)
    position = _position(setup, known)
    if known.view is not None:
        even, setup = _even(known.view, setup, next(iter(sizes)))
        radiances = {name: _resampled(radiance, even) for name, radiance in radiances.items()}
        position = None if position is None else even.apply(position)
    unit, pixel = ("mm", setup.geometry.mm_per_px) if setup.geometry.mm_per_px else ("px", 1.0)
    if unit == "px" and (setup.tank or setup.beam or setup.projection):
        msg = "tank, beam and projection are in mm, but geometry.mm_per_px is not given; add it."
        raise AnalysisRefusedError(msg)
    dark_name = next((name for name in ("black", "ambient") if name in radiances), None)

    def values(name: str) -> Array:
        return turned(radiances[name].value, setup).astype(np.float64)

    def variances(name: str) -> Array:
        return turned(radiances[name].variance, setup).astype(np.float64)

    black = values(dark_name) if dark_name else None
    stripes = np.stack([turned(radiances[name].value, setup) for name in shifts])
    captured = stripes[0].astype(np.float64)
    white = values("white") if "white" in radiances else None
    white_variance = variances("white") if "white" in radiances else None
    if black is not None and dark_name is not None:
        stripes -= black.astype(np.float32)
        if white is not None and white_variance is not None:
            white, white_variance = white - black, white_variance + variances(dark_name)
    lost = [~turned(radiances[name].valid, setup) for name in shifts]
    leak = values("black") if "black" in radiances else None
    if leak is not None and "ambient" in radiances:
        leak = leak - values("ambient")
    return Pictures(
        stripes=stripes,
        stripes_variance=np.stack([turned(radiances[name].variance, setup) for name in shifts]),
        white=white,
        white_variance=white_variance,
        black=black,
        black_variance=variances(dark_name) if dark_name else None,
        leak=leak,
        position_px=None if position is None else turned(position, setup),
        captured=captured,
        pixel=float(pixel or 1.0),
        unit=unit,
        saturated_fraction=float(np.mean(np.any(lost, axis=0))),
        notes=tuple(notes),
        contrast=None
        if known.projected is None or known.projected.contrast is None
        else known.projected.contrast.at,
    )


def _position(setup: Setup, known: Corrections) -> Array | None:
    """Return the projector's position in the camera's picture, along the stripes, if known."""
    axis = setup.stripes.axis if setup.stripes is not None else "x"
    if known.projected is None or axis not in known.projected.position_px:
        return None
    return np.asarray(known.projected.position_px[axis], dtype=np.float64)


def _even(
    view: tuple[Lens, Plane], setup: Setup, shape: tuple[int, ...]
) -> tuple[Resampling, Setup]:
    """Return how to resample the region to even mm, axes as in the picture, and the setup then."""
    lens, plane = view
    if lens.shape != shape:
        msg = f"pictures of {shape} px and a geometry record of {lens.shape}: calibrate anew."
        raise AnalysisRefusedError(msg)
    x, y, width, height = setup.geometry.region_px or (0, 0, shape[1], shape[0])
    corners = np.array([[x, y], [x + width, y], [x, y + height]], dtype=np.float64) - 0.5
    origin, right, _ = plane.to_mm(lens.undistorted(corners))
    along = right - origin
    angle = float(np.arctan2(along[1], along[0]))
    # the board may lie at any angle: its axes are turned into the picture's
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    lifted = np.eye(3)
    lifted[:2, :2], lifted[:2, 2] = turn, -turn @ origin
    aligned = replace(plane, homography=lifted @ plane.homography)
    scale = setup.geometry.mm_per_px or plane.mm_per_px
    far = aligned.to_mm(lens.undistorted(np.array([[x + width, y + height]]) - 0.5))[0]
    size = (round(float(far[1]) / scale), round(float(far[0]) / scale))
    if min(size) < 2:
        msg = "the board is mirrored in the picture: it cannot have been photographed so."
        raise AnalysisRefusedError(msg)
    even = resampling(lens, aligned, origin_mm=(0.0, 0.0), size_px=size, mm_per_px=scale)
    geometry = setup.geometry.model_copy(update={"mm_per_px": scale, "region_px": None})
    return even, setup.model_copy(update={"geometry": geometry})


def _resampled(radiance: Radiance, even: Resampling) -> Radiance:
    value = even.apply(radiance.value).astype(np.float32)
    variance = even.apply_variance(radiance.variance).astype(np.float32)
    return Radiance(value=value, variance=variance, valid=np.isfinite(value))


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


def turned(picture: NDArray[T], setup: Setup) -> NDArray[T]:
    """Return the region with the lit side left, cut to the tank where that is given.

    Raises
    ------
    AnalysisRefusedError
        If the region leaves the picture.
    """
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
