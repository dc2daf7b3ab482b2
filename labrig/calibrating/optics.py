"""Makes the records of what looks and shines: geometry of the camera, light of the projector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from analysis.separation import separate_harmonic
from calibration.contrast import fit_contrast, fit_transfer, measure_transfer
from calibration.entry import locate_entry
from calibration.errors import CalibrationError
from calibration.geometry import Board, Lens, Plane, View, find_board, fit_lens, fit_plane
from calibration.grey_code import ProjectorMap, decode_grey
from calibration.projector import black_leak, fit_gamma
from calibration.record import NamedArray, Quantity, Record, array
from labrig.calibrating.camera import Source
from labrig.errors import AnalysisRefusedError
from labrig.models.plan import Shot
from labrig.steps.linearise import linearise
from labrig.steps.rectify import rectify

Array = NDArray[np.float64]
Found = tuple[dict[str, Quantity], dict[str, NamedArray], list[str]]

COARSEST_SHARE = 8  # periods that repeat fewer times on the projector are no stripes
MIN_CONTRAST_SHARE = 0.2  # of the brightest white less black, for pixels that measure contrast


def geometry_record(source: Source, board: Board) -> Record:
    """Return lens and tank plane from pictures of a board, the first of them lying in the plane.

    A white picture in the session also locates entry face and beam.
    """
    shots = source.needed("board", "photograph the board, first lying in the tank's plane.")
    views = []
    for shot in shots:
        try:
            views.append(find_board(source.read(shot), board))
        except CalibrationError as error:
            msg = f"shot {shot.id}: {error}"
            raise CalibrationError(msg) from error
    shape = source.read(shots[0]).shape
    lens = fit_lens(views, (shape[0], shape[1]))
    plane = fit_plane(views[0], lens, board.square_mm)
    used, notes = shots, []
    located: dict[str, Quantity] = {}
    settings: dict[str, object] = {"views": len(views), "shape": [int(n) for n in shape]}
    settings["board"] = asdict(board)
    if source.of("white"):
        more, located = _entry(source)
        used = (*shots, *more)
        settings["lit_side"] = source.setup.geometry.lit_side
    if len(views) < 8:
        notes.append(f"The lens rests on {len(views)} views; ten at different angles are better.")
    return source.record(
        "geometry",
        used,
        {**_view_quantities(lens, plane), **located},
        _view_arrays(views[0], lens, plane),
        settings=settings,
        notes=tuple(notes),
    )


def _view_quantities(lens: Lens, plane: Plane) -> dict[str, Quantity]:
    names = ("focal_x_px", "focal_y_px", "centre_x_px", "centre_y_px")
    places = ((0, 0), (1, 1), (0, 2), (1, 2))
    found = {
        name: Quantity(value=float(lens.matrix[place]), std=float(std), unit="px")
        for name, place, std in zip(names, places, lens.matrix_std, strict=True)
    }
    return found | {
        "reprojection_rms_px": Quantity(value=lens.rms_px, unit="px"),
        "plane_rms_mm": Quantity(value=plane.rms_mm, unit="mm"),
        "mm_per_px": Quantity(value=plane.mm_per_px, unit="mm/px"),
    }


def _view_arrays(view: View, lens: Lens, plane: Plane) -> dict[str, NamedArray]:
    corners, square = ("corner", "xy"), ("row3", "col3")
    left = plane.to_mm(lens.undistorted(view.image_px)) - view.board_mm
    return {
        "matrix": array(square, lens.matrix, "px", "camera matrix"),
        "distortion": array(("term",), lens.distortion, "1", "k1, k2, p1, p2, k3"),
        "homography": array(square, plane.homography, "mm", "undistorted px to mm"),
        "corner_px": array(corners, view.image_px, "px", "corners of the plane's view"),
        "corner_mm": array(corners, view.board_mm, "mm", "their places on the board"),
        "residual_mm": array(corners, left, "mm", "what is left"),
    }


def _entry(source: Source) -> tuple[tuple[Shot, ...], dict[str, Quantity]]:
    """Return where light enters the picture as it was captured, px."""
    shots = source.of("white", "black")
    whites = [source.read(s).astype(np.float64) for s in shots if s.role == "white"]
    blacks = [source.read(s).astype(np.float64) for s in shots if s.role == "black"]
    dark = np.mean(blacks, axis=0) if blacks else source.setup.camera.black_level_dn
    net = np.mean(whites, axis=0) - dark
    side = source.setup.geometry.lit_side
    turned = {"left": net, "right": net[:, ::-1], "top": net.T, "bottom": net[::-1].T}[side]
    found = locate_entry(np.asarray(turned), 1.0)
    return shots, {
        "face_px": Quantity(value=found.face_x, unit="px"),
        "axis_px": Quantity(value=found.axis_y, unit="px"),
        "beam_angle_deg": Quantity(value=found.angle_deg, std=found.angle_std_deg, unit="degree"),
    }


def projector_record(source: Source) -> Record:
    """Return what a session tells of the projector: map, contrast, gamma, leak, c1 against depth.

    Raises
    ------
    AnalysisRefusedError
        If it tells none of these.
    """
    quantities: dict[str, Quantity] = {}
    arrays: dict[str, NamedArray] = {}
    notes: list[str] = []
    for part in (_grey, _gamma, _leak, _depth_contrast):
        more_quantities, more_arrays, more_notes = part(source)
        quantities |= more_quantities
        arrays |= more_arrays
        notes += more_notes
    if not arrays:
        msg = (
            f"session {source.session.path.name} tells nothing of the projector: it needs a Grey "
            "code (role grey-code), a ramp (role ramp), white and black, or stripes on a white "
            "target."
        )
        raise AnalysisRefusedError(msg)
    roles = ("grey-code", "ramp", "white", "black", "ambient", "dark", "stripes")
    return source.record("projector", source.of(*roles), quantities, arrays, notes=tuple(notes))


def _grey(source: Source) -> Found:
    shots = source.of("grey-code")
    if not shots:
        return {}, {}, []
    white, black = source.mean("white"), source.mean("black")
    size = source.setup.projector
    if white is None or black is None or size is None:
        msg = (
            "a Grey code needs white, black, and `projector: {rows, cols}` in the session's setup."
        )
        raise AnalysisRefusedError(msg)
    quantities: dict[str, Quantity] = {}
    arrays: dict[str, NamedArray] = {}
    notes: list[str] = []
    for axis, n_px in (("x", size.cols), ("y", size.rows)):
        bits = sorted({shot.bit for shot in shots if shot.axis == axis and shot.bit is not None})
        if not bits:
            continue
        pairs = _pairs(source, axis, bits)
        found = decode_grey(
            [one for one, _ in pairs.values()],
            [two for _, two in pairs.values()],
            white,
            black,
            axis=axis,
            n_px=n_px,
        )
        arrays |= _map_arrays(found)
        quantities[f"map_{axis}_residual_px"] = Quantity(value=found.residual_px, unit="px")
        more = _transfer(source, pairs, found, white - black)
        quantities |= more[0]
        arrays |= more[1]
        notes += more[2]
    return quantities, arrays, notes


def _pairs(source: Source, axis: str, bits: list[int]) -> dict[int, tuple[Array, Array]]:
    """Return plain and inverse picture of every bit of a Grey code, coarsest first.

    Raises
    ------
    AnalysisRefusedError
        If one is not there.
    """
    found = {}
    for bit in reversed(bits):
        plain, inverse = (
            source.mean("grey-code", axis=axis, bit=bit, polarity=p) for p in ("plain", "inverse")
        )
        if plain is None or inverse is None:
            msg = f"bit {bit} of the Grey code along {axis} lacks plain or inverse; capture both."
            raise AnalysisRefusedError(msg)
        found[bit] = (plain, inverse)
    return found


def _map_arrays(found: ProjectorMap) -> dict[str, NamedArray]:
    picture = ("row", "col")
    return {
        f"map_{found.axis}": array(
            picture, found.position_px, "projector px", f"projector {found.axis}, from its edge"
        ),
        f"map_{found.axis}_valid": array(
            picture, found.valid.astype(np.uint8), "1", "1 where the pixel's own code is sure"
        ),
    }


def _transfer(
    source: Source,
    pairs: Mapping[int, tuple[Array, Array]],
    found: ProjectorMap,
    contrast: Array,
) -> Found:
    """Return the contrast of stripes against their period, from the bits of a Grey code."""
    camera = source.setup.camera.record()
    whole = np.asarray(source.mean("white")) < camera.saturation_dn
    sure = found.valid & whole & (contrast > MIN_CONTRAST_SHARE * np.percentile(contrast, 99.0))
    measured = {}
    for bit, (plain, inverse) in pairs.items():
        period = 4 * 2**bit  # of a Grey code's bit, whose stripes begin a quarter late
        if period * COARSEST_SHARE > found.n_px:
            continue
        measured[float(period)] = measure_transfer(
            (plain - inverse)[sure],
            contrast[sure],
            found.position_px[sure].astype(np.float64),
            period_px=period,
            offset_px=period / 4,
        )
    if len(measured) < 3:
        return {}, {}, [f"The Grey code along {found.axis} is too coarse to measure contrast."]
    fitted = fit_transfer(measured)
    axis = found.axis
    return (
        {
            f"contrast_{axis}_level": Quantity(value=fitted.level, unit="1"),
            f"contrast_{axis}_reach_px": Quantity(value=fitted.reach_px, unit="projector px"),
            f"contrast_{axis}_exponent": Quantity(value=fitted.exponent, unit="1"),
            f"contrast_{axis}_residual": Quantity(value=fitted.residual, unit="1"),
        },
        {
            f"period_{axis}": array(
                (f"period_{axis}",), fitted.periods_px, "projector px", "periods of the stripes"
            ),
            f"contrast_{axis}": array(
                (f"period_{axis}",),
                fitted.measured,
                "1",
                "contrast of the fundamental, one if sharp",
            ),
        },
        [],
    )


def _gamma(source: Source) -> Found:
    levels = sorted({shot.level for shot in source.of("ramp") if shot.level is not None})
    if not levels:
        return {}, {}, []
    pictures = [source.mean("ramp", level=level) for level in levels]
    brightest = np.asarray(pictures[-1]) - np.asarray(pictures[0])
    lit = brightest > 0.5 * np.percentile(brightest, 99.0)
    lost = float(
        np.mean(np.asarray(pictures[-1])[lit] >= source.setup.camera.record().saturation_dn)
    )
    if lost > 0.01:
        msg = (
            f"{100 * lost:.0f} % of the lit pixels of the ramp's white are saturated; expose less."
        )
        raise CalibrationError(msg)
    found = fit_gamma(levels, [float(np.asarray(p)[lit].mean()) for p in pictures])
    return (
        {
            "gamma": Quantity(value=found.exponent, unit="1"),
            "gamma_residual": Quantity(value=found.residual, unit="1"),
        },
        {
            "level": array(("level",), found.levels, "1", "grey levels, share of white"),
            "light": array(("level",), found.light, "1", "their light, share of white"),
        },
        [],
    )


def _leak(source: Source) -> Found:
    white, black = source.mean("white"), source.mean("black")
    if white is None or black is None:
        return {}, {}, []
    ambient = source.mean("ambient")
    offset = source.setup.camera.black_level_dn if ambient is None else ambient
    leak = black_leak(white - offset, black - offset)
    notes = []
    if ambient is None:
        notes.append("There is no ambient picture: ambient light counts as the projector's leak.")
    return (
        {"leak_median": Quantity(value=float(np.nanmedian(leak)), unit="1")},
        {"leak": array(("row", "col"), leak.astype(np.float32), "1", "light of black over white")},
        notes,
    )


def _depth_contrast(source: Source) -> Found:
    """Return c1 against depth, of a session whose stripes fall on a white target."""
    stripes = source.of("stripes")
    if not stripes or not source.of("white") or len({s.shift for s in stripes}) < 4:
        return {}, {}, []
    setup = source.setup
    pictures = rectify(linearise(source.session, setup), source.session, setup)
    if pictures.white is None or setup.stripes is None:
        return {}, {}, ["c1 against depth needs `stripes` in the setup of the session."]
    found = separate_harmonic(
        pictures.stripes, pictures.stripes_variance, contrast=1.0, duty=setup.stripes.duty
    )
    depth = np.arange(0.5, pictures.white.shape[1], dtype=np.float64) * pictures.pixel
    fit = fit_contrast(
        found.single, pictures.white, depth, unit=pictures.unit, period_px=setup.stripes.period_px
    )
    std = np.sqrt(np.diag(fit.covariance))
    return (
        {
            **{
                f"c1_a{k}": Quantity(value=a, std=float(s), unit="1")
                for k, (a, s) in enumerate(zip(fit.coefficients, std, strict=True))
            },
            "c1_from": Quantity(value=fit.depth_range[0], unit=fit.unit),
            "c1_to": Quantity(value=fit.depth_range[1], unit=fit.unit),
            "c1_period_px": Quantity(value=fit.period_px, unit="projector px"),
        },
        {
            "c1_depth": array(("c1_depth",), fit.depth, fit.unit, "depth of the columns"),
            "c1": array(("c1_depth",), fit.measured, "1", "amplitude of the stripes' fundamental"),
            "c1_fit": array(("c1_depth",), fit.at(fit.depth), "1", "ln c1 quadratic in depth"),
        },
        ["The sample was taken for a white target: what scatters inside is no target."],
    )
