"""Board to lens and plane on rendered views; resampling; where the beam enters."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.entry import locate_entry
from calibration.errors import CalibrationError
from calibration.geometry import Board, find_board, fit_lens, fit_plane, resampling

BOARD = Board()
SHAPE = (600, 800)
MATRIX = np.array([[1000.0, 0.0, 399.5], [0.0, 1000.0, 299.5], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.05, 5e-4, -4e-4, 0.0])
PX_PER_MM = 12.0


def render(rotation, translation, seed):
    """Return a noisy view of the board, four samples a pixel."""
    rng = np.random.default_rng(seed)
    turn, _ = cv2.Rodrigues(np.asarray(rotation, dtype=float))
    plane = MATRIX @ np.column_stack([turn[:, 0], turn[:, 1], translation])
    y, x = (np.mgrid[: 2 * SHAPE[0], : 2 * SHAPE[1]] + 0.5) / 2 - 0.5
    points = np.stack([x.ravel(), y.ravel()], axis=1).reshape(-1, 1, 2)
    seen = cv2.undistortPoints(points, MATRIX, DISTORTION, P=MATRIX).reshape(-1, 2)
    mm = np.column_stack([seen, np.ones(len(seen))]) @ np.linalg.inv(plane).T
    at = (mm[:, :2] / mm[:, 2:] * PX_PER_MM - 0.5).astype(np.float32)
    drawn = cv2.GaussianBlur(BOARD.draw(PX_PER_MM), (0, 0), 1.5)
    fine = cv2.remap(
        drawn, *np.moveaxis(at.reshape(*x.shape, 2), 2, 0), cv2.INTER_LINEAR, borderValue=210
    )
    light = fine.astype(float).reshape(SHAPE[0], 2, SHAPE[1], 2).mean(axis=(1, 3))
    counts = 400.0 + 12.0 * light + rng.normal(0.0, 25.0, SHAPE)
    return np.clip(np.rint(counts), 0, 4095).astype(np.uint16)


POSES = [
    ((0.0, 0.0, 0.05), (-45.0, -35.0, 135.0)),
    ((0.4, 0.1, 0.0), (-44.0, -33.0, 150.0)),
    ((-0.35, 0.15, 0.1), (-46.0, -36.0, 150.0)),
    ((0.1, 0.4, -0.2), (-42.0, -36.0, 155.0)),
    ((-0.1, -0.4, 0.2), (-45.0, -30.0, 155.0)),
    ((0.3, -0.3, 0.3), (-40.0, -38.0, 160.0)),
]


@pytest.fixture(scope="module")
def pictures():
    return [render(*pose, seed) for seed, pose in enumerate(POSES)]


@pytest.fixture(scope="module")
def views(pictures):
    return [find_board(picture, BOARD) for picture in pictures]


@pytest.fixture(scope="module")
def lens(views):
    return fit_lens(views, SHAPE)


def test_lens_of_rendered_views_is_recovered(lens):
    # measured 0.043 px
    assert lens.rms_px <= 0.06
    # measured -0.2 of 1000 px, and 0.06 px
    assert lens.matrix[0, 0] == pytest.approx(1000.0, abs=2.0)
    assert lens.matrix[0, 2] == pytest.approx(399.5, abs=3.0)


def test_plane_is_found_to_a_hundredth_of_a_square(views, lens):
    plane = fit_plane(views[0], lens, BOARD.square_mm)
    # measured 0.0003 squares
    assert plane.rms_mm <= 0.01 * BOARD.square_mm
    assert plane.mm_per_px == pytest.approx(0.135, rel=0.01)
    turn, _ = cv2.Rodrigues(np.asarray(POSES[0][0]))
    corners = np.array([[10.0, 10.0], [80.0, 10.0], [80.0, 60.0], [10.0, 60.0]])
    space = np.column_stack([corners, np.zeros(4)]) @ turn.T + POSES[0][1]
    true = (space / space[:, 2:])[:, :2] * 1000.0 + MATRIX[:2, 2]
    off = plane.to_mm(true) - corners
    # against the truth, not the fit's own residual; measured 0.0008 squares
    assert np.abs(off).max() <= 0.01 * BOARD.square_mm


def test_a_board_in_part_or_turned_round_is_placed_rightly(pictures, views, lens):
    whole = fit_plane(views[0], lens, BOARD.square_mm)
    part = pictures[0].copy()
    part[:, 420:] = 2000
    some = find_board(part, BOARD)
    assert 8 <= len(some.board_mm) < len(views[0].board_mm)
    off = whole.to_mm(lens.undistorted(some.image_px)) - some.board_mm
    assert np.abs(off).max() < 0.05  # measured 0.006 mm
    turned = find_board(pictures[0][::-1, ::-1], BOARD)
    back = np.array([SHAPE[1] - 1, SHAPE[0] - 1]) - turned.image_px
    off = whole.to_mm(lens.undistorted(back)) - turned.board_mm
    assert np.abs(off).max() < 0.05  # measured 0.006 mm


def test_a_board_that_cannot_be_trusted_is_refused_in_one_line(pictures, views):
    blurred = cv2.GaussianBlur(pictures[0], (0, 0), 12.0)
    mirrored = np.ascontiguousarray(pictures[0][:, ::-1])
    sliver = pictures[0].copy()
    sliver[:, 160:] = 2000
    for picture in (blurred, mirrored, sliver, np.zeros(SHAPE, np.uint16)):
        with pytest.raises(CalibrationError, match="corners") as caught:
            find_board(picture, BOARD)
        assert "\n" not in str(caught.value)
    with pytest.raises(CalibrationError, match="3 are needed"):
        fit_lens(views[:2], SHAPE)


def test_views_that_fit_no_lens_are_refused(views):
    import dataclasses  # noqa: PLC0415

    rng = np.random.default_rng(3)
    shaken = [
        dataclasses.replace(v, image_px=v.image_px + rng.normal(0, 4.0, v.image_px.shape))
        for v in views
    ]
    with pytest.raises(CalibrationError, match="miss the lens model"):
        fit_lens(shaken, SHAPE)


@pytest.mark.parametrize(
    "wrong", [{"squares_y": 6}, {"marker_mm": 12.0}, {"dictionary": "DICT_9"}, {"squares_x": 90}]
)
def test_boards_that_cannot_be_are_refused(wrong):
    with pytest.raises(CalibrationError):
        Board(**wrong)


def test_resampled_picture_is_the_board_and_carries_its_variance(pictures, views, lens):
    plane = fit_plane(views[0], lens, BOARD.square_mm)
    even = resampling(lens, plane, origin_mm=(0.0, 0.0), size_px=(350, 450), mm_per_px=0.2)
    flat = even.apply(pictures[0].astype(float))
    drawn = 400.0 + 12.0 * BOARD.draw(5.0).astype(float)
    same = np.corrcoef(flat[5:-5, 5:-5].ravel(), drawn[5:-5, 5:-5].ravel())[0, 1]
    assert same > 0.9  # measured 0.954: the camera's pixels are coarser than the drawing
    rng = np.random.default_rng(7)
    noise = np.stack([even.apply(rng.normal(0.0, 3.0, SHAPE)) for _ in range(60)])
    stated = even.apply_variance(np.full(SHAPE, 9.0))
    ratio = np.nanmean(noise.var(axis=0, ddof=1) / stated)
    # measured 1.000
    assert ratio == pytest.approx(1.0, abs=0.02)
    outside = resampling(lens, plane, origin_mm=(-90.0, 0.0), size_px=(10, 10), mm_per_px=1.0)
    assert np.isnan(outside.apply(pictures[0].astype(float))).all()


def test_entry_face_and_beam_axis_are_located():
    y, x = np.mgrid[:200, :300] + 0.5
    slope = np.tan(np.radians(4.0))
    beam = (np.abs(y - 90.0 - slope * (x - 40.3)) < 20.0) * np.exp(-x / 150.0)
    inside = np.clip(x - 40.3 + 0.5, 0.0, 1.0)
    rng = np.random.default_rng(2)
    found = locate_entry(1000.0 * beam * inside + rng.normal(0.0, 5.0, y.shape), 0.1)
    # measured off by -0.1 px, -0.01 px and 0.001 degrees
    assert found.face_x == pytest.approx(4.03, abs=0.05)
    assert found.axis_y == pytest.approx(9.0, abs=0.03)
    assert found.angle_deg == pytest.approx(4.0, abs=0.1)
    with pytest.raises(CalibrationError, match="no beam"):
        locate_entry(np.ones((50, 60)), 0.1)


def test_only_what_opencv_4_and_5_share_is_called():
    """Tried with 4.14.0.94 and 5.0.0.93: both have them all, and the tests of this file pass."""
    shared = {
        *("aruco", "aruco.CharucoBoard", "aruco.CharucoDetector"),
        *("aruco.getPredefinedDictionary", "calibrateCameraExtended", "error", "findHomography"),
        *("imencode", "projectPoints", "undistortPoints"),
        # the window's
        *("BORDER_CONSTANT", "COLORMAP_CIVIDIS", "CV_32F", "GaussianBlur", "INTER_AREA"),
        *("INTER_LINEAR", "LINE_AA", "copyMakeBorder"),
        *("Laplacian", "addWeighted", "applyColorMap", "convertScaleAbs", "fillPoly"),
        *("minMaxLoc", "polylines", "resize", "subtract"),
    }
    root = Path(__file__).resolve().parents[2]
    found = set()
    for room in ("analysis", "calibration", "drivers", "labrig"):
        for path in (root / room).rglob("*.py"):
            found |= set(re.findall(r"\bcv2\.((?:aruco\.)?[A-Za-z_0-9]+)", path.read_text("utf-8")))
    assert "calibrateCameraExtended" in found
    assert found <= shared
