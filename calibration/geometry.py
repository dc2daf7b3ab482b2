"""Pixels into tank millimetres: a ChArUco board to lens model and plane, and what they resample.

Only those calls of OpenCV are used that 4.14 and 5 share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError

Array = NDArray[np.float64]

MIN_CORNERS = 8  # of a view, over two rows and columns at least
MIN_VIEWS = 3
MAX_REPROJECTION_PX = 1.0
MAX_PLANE_SQUARES = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A ChArUco board; odd rows, for the layout of even ones changed between OpenCV's versions.

    Raises
    ------
    CalibrationError
        If the sizes make no board.
    """

    squares_x: int = 9
    squares_y: int = 7
    square_mm: float = 10.0
    marker_mm: float = 7.0
    dictionary: str = "DICT_5X5_100"

    def __post_init__(self) -> None:
        n_markers = self.squares_x * self.squares_y // 2
        known = getattr(cv2.aruco, self.dictionary, None)
        if known is None:
            msg = f"there is no marker dictionary {self.dictionary!r}; use DICT_5X5_100."
            raise CalibrationError(msg)
        if min(self.squares_x, self.squares_y) < 3 or self.squares_y % 2 == 0:
            msg = (
                f"a board of {self.squares_x} x {self.squares_y} squares: 3 or more each way and "
                "an odd number of rows are needed."
            )
            raise CalibrationError(msg)
        if not 0.0 < self.marker_mm < self.square_mm:
            msg = (
                f"markers of {self.marker_mm:g} mm in squares of {self.square_mm:g} mm: the marker "
                "must be smaller."
            )
            raise CalibrationError(msg)
        if n_markers > len(cv2.aruco.getPredefinedDictionary(known).bytesList):
            msg = f"{self.dictionary} has too few markers for {n_markers}; choose a larger one."
            raise CalibrationError(msg)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height, mm."""
        return self.squares_x * self.square_mm, self.squares_y * self.square_mm

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's board, in mm."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard(
            (self.squares_x, self.squares_y), self.square_mm, self.marker_mm, dictionary
        )

    def draw(self, px_per_mm: float) -> NDArray[np.uint8]:
        """Return the board as a picture (rows, cols), black and white, without a margin."""
        width, height = (round(mm * px_per_mm) for mm in self.size_mm)
        image = self.opencv().generateImage((width, height), marginSize=0, borderBits=1)
        return np.asarray(image, dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Corners of the board found in one picture.

    Attributes
    ----------
    board_mm : (n, 2), places on the board
    image_px : (n, 2), x and y in the picture
    """

    board_mm: Array
    image_px: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Pinhole and distortion, in OpenCV's five terms, with the residual it leaves."""

    matrix: Array
    distortion: Array
    matrix_std: Array
    rms_px: float
    shape: tuple[int, int]
    n_views: int

    def undistorted(self, points_px: Array) -> Array:
        """Return where a lens without distortion would show points (n, 2), px."""
        found = cv2.undistortPoints(
            points_px.reshape(-1, 1, 2), self.matrix, self.distortion, P=self.matrix
        )
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def distorted(self, points_px: Array) -> Array:
        """Return where the lens shows points (n, 2) of an undistorted picture, px."""
        rays = (points_px - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]
        space = np.column_stack([rays, np.ones(len(rays))])
        found, _ = cv2.projectPoints(space, np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """The plane of the board in the picture: undistorted px to mm on the board.

    Attributes
    ----------
    homography : (3, 3), from undistorted px (x, y, 1) to mm
    rms_mm : residual of the corners on the board
    mm_per_px : in the middle of the corners
    """

    homography: Array
    rms_mm: float
    mm_per_px: float
    n_corners: int

    def to_mm(self, points_px: Array) -> Array:
        """Return undistorted points (n, 2) in px as mm on the plane."""
        return _project(self.homography, points_px)

    def to_px(self, points_mm: Array) -> Array:
        """Return points (n, 2) in mm as undistorted px."""
        back: Array = np.linalg.inv(self.homography).astype(np.float64)
        return _project(back, points_mm)


def find_board(picture: NDArray[np.integer], board: Board) -> View:
    """Find the corners of a board in a picture (rows, cols) of any depth.

    Corners are named by the markers beside them, so a board seen in part or turned round is found
    rightly; a mirrored one has no known marker.

    Raises
    ------
    CalibrationError
        If fewer than eight corners are found, or all lie in one row.
    """
    low, high = np.percentile(picture, [1.0, 99.0])
    scaled = np.clip((picture - low) * (255.0 / max(high - low, 1.0)), 0.0, 255.0)
    detector = cv2.aruco.CharucoDetector(board.opencv())
    corners, ids, _, _ = detector.detectBoard(np.rint(scaled).astype(np.uint8))
    n = 0 if ids is None else len(ids)
    if n < MIN_CORNERS:
        msg = (
            f"{n} corners of the board were found, {MIN_CORNERS} are needed: is it sharp, evenly "
            "lit, not mirrored, and the board that was named?"
        )
        raise CalibrationError(msg)
    object_mm, image_px = board.opencv().matchImagePoints(corners, ids)
    board_mm = np.asarray(object_mm, dtype=np.float64).reshape(-1, 3)[:, :2]
    if np.linalg.matrix_rank(board_mm - board_mm.mean(axis=0), tol=0.1 * board.square_mm) < 2:
        msg = f"the {n} corners found lie in one row of the board; show more of it."
        raise CalibrationError(msg)
    return View(board_mm=board_mm, image_px=np.asarray(image_px, dtype=np.float64).reshape(-1, 2))


def fit_lens(views: Sequence[View], shape: tuple[int, int]) -> Lens:
    """Fit the lens to views of a board held at several angles (Zhang 2000).

    Raises
    ------
    CalibrationError
        If there are fewer than three views, or they do not fit one lens within a pixel.
    """
    if len(views) < MIN_VIEWS:
        msg = (
            f"{len(views)} views of the board, {MIN_VIEWS} are needed, at different angles; "
            "ten are better."
        )
        raise CalibrationError(msg)
    objects = [np.column_stack([v.board_mm, np.zeros(len(v.board_mm))]) for v in views]
    rows, cols = shape
    try:
        found = cv2.calibrateCameraExtended(
            [o.astype(np.float32) for o in objects],
            [v.image_px.astype(np.float32) for v in views],
            (cols, rows),
            np.eye(3),
            np.zeros(5),
        )
    except cv2.error as error:
        msg = "the views determine no lens; hold the board at different angles."
        raise CalibrationError(msg) from error
    rms, matrix, distortion, _, _, std, *_ = found
    if not rms <= MAX_REPROJECTION_PX:
        msg = (
            f"the corners miss the lens model by {rms:.2f} px rms (limit "
            f"{MAX_REPROJECTION_PX:g} px): is the board flat and its size right?"
        )
        raise CalibrationError(msg)
    return Lens(
        matrix=np.asarray(matrix, dtype=np.float64),
        distortion=np.asarray(distortion, dtype=np.float64).reshape(-1)[:5],
        matrix_std=np.asarray(std, dtype=np.float64).reshape(-1)[:4],
        rms_px=float(rms),
        shape=shape,
        n_views=len(views),
    )


def fit_plane(view: View, lens: Lens, square_mm: float) -> Plane:
    """Fit the homography from the undistorted picture to the board that lies in the tank's plane.

    Raises
    ------
    CalibrationError
        If the corners leave more than a twentieth of a square.
    """
    undistorted = lens.undistorted(view.image_px)
    homography, _ = cv2.findHomography(undistorted, view.board_mm, 0)
    if homography is None:
        msg = "the corners determine no plane; show more of the board."
        raise CalibrationError(msg)
    off = _project(homography, undistorted) - view.board_mm
    rms = float(np.sqrt(np.mean((off**2).sum(axis=1))))
    if rms > MAX_PLANE_SQUARES * square_mm:
        msg = (
            f"the corners miss their plane by {rms:.3g} mm rms (limit "
            f"{MAX_PLANE_SQUARES * square_mm:.3g} mm): is the board flat?"
        )
        raise CalibrationError(msg)
    steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    step = _project(homography, undistorted.mean(axis=0) + steps)
    area = abs(float(np.linalg.det(step[1:] - step[0])))
    return Plane(
        homography=np.asarray(homography, dtype=np.float64),
        rms_mm=rms,
        mm_per_px=float(np.sqrt(area)),
        n_corners=len(view.board_mm),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Resampling:
    """Where the pixels of a picture in mm lie in the camera's picture.

    Attributes
    ----------
    x_px, y_px : (rows, cols), in the captured picture
    """

    x_px: Array
    y_px: Array

    def apply(self, picture: NDArray[np.floating]) -> Array:
        """Return a picture (rows, cols) resampled, linear between pixels; NaN outside."""
        return self._weighted(picture, squared=False)

    def apply_variance(self, variance: NDArray[np.floating]) -> Array:
        """Return the variance of the resampled picture: its weights squared.

        Neighbours then share noise, which this does not say.
        """
        return self._weighted(variance, squared=True)

    def _weighted(self, picture: NDArray[np.floating], *, squared: bool) -> Array:
        rows, cols = picture.shape
        x0, y0 = np.floor(self.x_px), np.floor(self.y_px)
        inside = (x0 >= 0) & (y0 >= 0) & (x0 < cols - 1) & (y0 < rows - 1)
        i, j = (np.where(inside, v, 0).astype(np.intp) for v in (x0, y0))
        fx, fy = self.x_px - x0, self.y_px - y0
        total = np.zeros(self.x_px.shape)
        for dy, wy in ((0, 1.0 - fy), (1, fy)):
            for dx, wx in ((0, 1.0 - fx), (1, fx)):
                weight = wx * wy
                total += (weight**2 if squared else weight) * picture[j + dy, i + dx]
        return np.where(inside, total, np.nan)


def resampling(
    lens: Lens,
    plane: Plane,
    *,
    origin_mm: tuple[float, float],
    size_px: tuple[int, int],
    mm_per_px: float,
) -> Resampling:
    """Return where the pixels of a picture of the plane lie in the camera's.

    Parameters
    ----------
    origin_mm : x and y on the board of the corner of the first pixel
    size_px : rows, cols of the picture to make
    """
    rows, cols = size_px
    x = origin_mm[0] + (np.arange(cols) + 0.5) * mm_per_px
    y = origin_mm[1] + (np.arange(rows) + 0.5) * mm_per_px
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    seen = lens.distorted(plane.to_px(grid))
    return Resampling(x_px=seen[:, 0].reshape(rows, cols), y_px=seen[:, 1].reshape(rows, cols))


def _project(homography: Array, points: Array) -> Array:
    turned = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(turned[:, :2] / turned[:, 2:])
