"""From linear pictures to the tank: even millimetres, entry face left, black subtracted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import Lens, Plane, Resampling, resampling
from calibration.hdr import Radiance
from labrig.errors import AnalysisRefusedError
from labrig.models.setup import Setup, StripesConfig
from labrig.session import Session
from labrig.steps.corrections import Corrections
from labrig.steps.linearise import ShiftSeries, series_of, shots_of
from labrig.steps.picture_notes import notes_of

Array = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)


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
    beam_angle_deg : of the beam in the picture, from a geometry record; None if there is none
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
    beam_angle_deg: float | None
    pixel: float
    unit: str
    saturated_fraction: float
    notes: tuple[str, ...]
    contrast: Callable[[Array], Array] | None = None
    more: tuple[Series, ...] = ()


def rectify(
    radiances: Mapping[str, Radiance],
    session: Session,
    setup: Setup,
    known: Corrections | None = None,
) -> Pictures:
    """Cut the region out, turn the lit side to the left, subtract black from the rest.

    With a geometry record the region is first resampled to even millimetres of the tank's plane;
    where no region is given, it begins at the entry face of that record.

    Raises
    ------
    AnalysisRefusedError
        If a shift of the stripes is missing, or lengths are given in mm but no scale.
    """
    main, *others = series_of(session)
    shifts = main.names
    shape = _common_shape(radiances, session)
    known = known or Corrections(camera=setup.camera.record())
    notes = notes_of(session, shots_of(session), setup, frozenset(radiances), known)
    position, angle = _position(setup, known), None
    setup = _from_face(setup, known, shape)
    if known.view is not None:
        even, aligned, setup = _even(known.view, setup, shape)
        radiances = {name: _resampled(radiance, even) for name, radiance in radiances.items()}
        position = None if position is None else even.apply(position)
        angle = _beam_angle(known, aligned, shape)
    unit, pixel = ("mm", setup.geometry.mm_per_px) if setup.geometry.mm_per_px else ("px", 1.0)
    if unit == "px" and (setup.tank or setup.beam or setup.projection):
        msg = "tank, beam and projection are in mm, but geometry.mm_per_px is not given; add it."
        raise AnalysisRefusedError(msg)
    pictures = {name: _turned_radiance(radiance, setup) for name, radiance in radiances.items()}
    lost = [~pictures[name].valid for name in shifts]
    return Pictures(
        stripes_variance=np.stack([pictures[name].variance for name in shifts]),
        position_px=None if position is None else turned(position, setup),
        captured=pictures[shifts[0]].value.astype(np.float64),
        beam_angle_deg=angle,
        pixel=float(pixel or 1.0),
        unit=unit,
        saturated_fraction=float(np.mean(np.any(lost, axis=0))),
        notes=tuple(notes),
        contrast=None
        if known.projected is None or known.projected.contrast is None
        else known.projected.contrast.at,
        more=tuple(_series(pictures, one) for one in others),
        **_without_black(pictures, shifts),
    )


def _series(turned: Mapping[str, Radiance], shifts: ShiftSeries) -> Series:
    """Return stripes of another period, black subtracted."""
    return Series(
        net=_without_black(turned, shifts.names)["stripes"],
        variance=np.stack([turned[name].variance for name in shifts.names]),
        low=shifts.low,
        high=shifts.high,
    )


class _Light(TypedDict):
    """Pictures with black subtracted, and what was."""

    stripes: NDArray[np.float32]
    white: Array | None
    white_variance: Array | None
    black: Array | None
    black_variance: Array | None
    leak: Array | None


def _without_black(turned: Mapping[str, Radiance], shifts: Sequence[str]) -> _Light:
    """Subtract black, or else the ambient picture, from stripes and white."""

    def of(name: str | None, what: str) -> Array | None:
        found = None if name is None else turned.get(name)
        return None if found is None else getattr(found, what).astype(np.float64)

    dark = next((name for name in ("black", "ambient") if name in turned), None)
    black, black_variance = of(dark, "value"), of(dark, "variance")
    white, white_variance = of("white", "value"), of("white", "variance")
    stripes = np.stack([turned[name].value for name in shifts])
    if black is not None and black_variance is not None:
        stripes -= black.astype(np.float32)
        if white is not None and white_variance is not None:
            white, white_variance = white - black, white_variance + black_variance
    leak, ambient = of("black", "value"), of("ambient", "value")
    if leak is not None and ambient is not None:
        leak = leak - ambient
    return {
        "stripes": stripes,
        "white": white,
        "white_variance": white_variance,
        "black": black,
        "black_variance": black_variance,
        "leak": leak,
    }


def _common_shape(radiances: Mapping[str, Radiance], session: Session) -> tuple[int, int]:
    sizes = {radiance.value.shape for radiance in radiances.values()}
    if len(sizes) > 1:
        msg = (
            f"session {session.path.name} holds pictures of {sorted(sizes)} px; all must be equal."
        )
        raise AnalysisRefusedError(msg)
    rows, cols = next(iter(sizes))
    return rows, cols


def _from_face(setup: Setup, known: Corrections, shape: tuple[int, int]) -> Setup:
    """Return the setup with a region that begins at the entry face, if a record knows that."""
    if known.entry is None or setup.geometry.region_px is not None:
        return setup
    side, entry = known.entry
    if side != setup.geometry.lit_side:
        msg = (
            f"the geometry record found the entry face on the {side}, the session's lit_side is "
            f"{setup.geometry.lit_side}; mend one of them, or give region_px."
        )
        raise AnalysisRefusedError(msg)
    (rows, cols), face = shape, round(entry.face_x)
    region = {
        "left": (face, 0, cols - face, rows),
        "right": (0, 0, cols - face, rows),
        "top": (0, face, cols, rows - face),
        "bottom": (0, 0, cols, rows - face),
    }[side]
    geometry = setup.geometry.model_copy(update={"region_px": region})
    return setup.model_copy(update={"geometry": geometry})


def _beam_angle(known: Corrections, plane: Plane, shape: tuple[int, int]) -> float | None:
    """Return the angle of a record's beam axis in the tank's plane, degree."""
    if known.entry is None or known.view is None:
        return None
    (side, entry), (rows, cols) = known.entry, shape
    turn = np.radians(entry.angle_deg)
    reach = 0.5 * min(shape) * np.array([0.0, 1.0])
    depth, along = entry.face_x + reach * np.cos(turn), entry.axis_y + reach * np.sin(turn)
    x, y = {
        "left": (depth, along),
        "right": (cols - depth, along),
        "top": (along, depth),
        "bottom": (along, rows - depth),
    }[side]
    begin, end = plane.to_mm(known.view[0].undistorted(np.column_stack([x, y]) - 0.5))
    dx, dy = end - begin
    deep, across = {"left": (dx, dy), "right": (-dx, dy), "top": (dy, dx), "bottom": (-dy, dx)}[
        side
    ]
    return float(np.degrees(np.arctan2(across, deep)))


def _position(setup: Setup, known: Corrections) -> Array | None:
    """Return the projector's position in the camera's picture, along the stripes, if known."""
    axis = setup.stripes.axis if setup.stripes is not None else "x"
    if known.projected is None or axis not in known.projected.position_px:
        return None
    return np.asarray(known.projected.position_px[axis], dtype=np.float64)


def _even(
    view: tuple[Lens, Plane], setup: Setup, shape: tuple[int, int]
) -> tuple[Resampling, Plane, Setup]:
    """Return how to resample the region to even mm, the plane in the picture's axes, the setup."""
    lens, plane = view
    if lens.shape != shape:
        msg = f"pictures of {shape} px and a geometry record of {lens.shape}: calibrate anew."
        raise AnalysisRefusedError(msg)
    x, y, width, height = setup.geometry.region_px or (0, 0, shape[1], shape[0])
    # its axes are taken across the middle, where the board was and the lens is known best
    ends = np.array([[0.25, 0.5], [0.75, 0.5]]) * (width, height)
    origin, left, right = plane.to_mm(
        lens.undistorted(np.array([x, y]) + np.vstack([np.zeros(2), ends]) - 0.5)
    )
    along = right - left
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
    return even, aligned, setup.model_copy(update={"geometry": geometry})


def _resampled(radiance: Radiance, even: Resampling) -> Radiance:
    value = even.apply(radiance.value).astype(np.float32)
    variance = even.apply_variance(radiance.variance).astype(np.float32)
    return Radiance(value=value, variance=variance, valid=np.isfinite(value))


def _turned_radiance(radiance: Radiance, setup: Setup) -> Radiance:
    return Radiance(
        value=turned(radiance.value, setup),
        variance=turned(radiance.variance, setup),
        valid=turned(radiance.valid, setup),
    )


def turned(picture: NDArray[T], setup: Setup) -> NDArray[T]:
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
