"""Take pictures with a camera, and detect the board in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.cameras.board import Board, require_opencv
from ikservo.apps.cameras.camera_and_arm_fit import BoardSample, LensTerms
from ikservo.apps.cameras.capture import open_capture
from ikservo.errors import CalibrationError, InputError, PictureError
from ikservo.files.public_source import public_source
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, make_pose, skew

Picture = NDArray[np.uint8]
"""A picture: grey (h, w) or colour (h, w, 3)."""

_MIN_CORNERS = 8
# Variance of the Laplacian over the variance of the grey level; below this, a picture is blurred.
_MIN_SHARPNESS = 0.004
_MAX_REPROJECTION_PX, _MAX_FIRST_PX = 2.0, 10.0  # for a known lens, and for the initial guess
_LEAST_NOISE_PX = 0.05
_STALE_PICTURES = 5  # number of old pictures that a driver may hold in its queue
_READABLE = "a picture or video that OpenCV can read"

SAME_PICTURE = (
    "The camera delivers the same picture again and again.",
    "Unplug the camera and plug it in again.",
)
"""Message and hint for a camera that no longer delivers new pictures."""


class PictureSource(Protocol):
    """Source of pictures.

    Attributes:
        hint: A hint for the person who views the pictures; empty if there is none.
    """

    hint: str

    def take(self) -> Picture:
        """Take a current picture.

        Raises:
            PictureError: The camera delivers no picture.
        """
        ...


class LiveCamera:
    """A real camera, given by its number, device or address.

    Raises:
        InputError: OpenCV is not installed, or there is no such camera.
    """

    def __init__(self, source: str) -> None:
        require_opencv()
        self.hint = ""
        self._name, self._capture = public_source(source), open_capture(source)
        is_file = "://" not in source and Path(source).is_file()
        self._file = source if is_file else ""
        if not self._capture.isOpened():
            if self._file:
                raise InputError(f"{self._file} is not {_READABLE}.")
            hint = "Is it plugged in, and not used by another program?"
            raise InputError(f"There is no camera {self._name}.", hint)

    def take(self) -> Picture:
        """Take a picture; discard pictures that waited in the driver's queue.

        Raises:
            PictureError: The file is damaged, or the camera no longer delivers pictures.
        """
        stale = 0 if self._file else _STALE_PICTURES
        all(self._capture.grab() for _ in range(stale))  # each failure may last a time-out
        taken, picture = self._capture.read()
        if self._file and not taken:  # a file with one picture, or the end of a video: start again
            self._capture = open_capture(self._file)
            taken, picture = self._capture.read()
        if not taken:
            if self._file:
                raise PictureError(f"{self._file} is not {_READABLE}.")
            raise PictureError(
                f"Camera {self._name} no longer delivers pictures.", "Is it still plugged in?"
            )
        return np.asarray(picture, dtype=np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics(FrozenArrays):
    """The projection of a camera's lens.

    Attributes:
        matrix: fx, fy, cx, cy as the matrix (3, 3), pixels.
        distortion: k1, k2, p1, p2, k3 (5,), as in OpenCV.
        size: Width and height of the pictures, pixels.
    """

    matrix: Matrix
    distortion: Vector
    size: tuple[int, int]

    @classmethod
    def of_numbers(cls, numbers: Vector, size: tuple[int, int]) -> Intrinsics:
        """Return the intrinsics with the six numbers of ``LensTerms``."""
        width, height = size
        focal, ratio, right, down, k1, k2 = numbers.tolist()
        fx = (1.0 + focal) * width
        matrix = np.array([
            [fx, 0.0, width * (0.5 + right)],
            [0.0, fx * (1.0 + ratio), 0.5 * height + width * down],
            [0.0, 0.0, 1.0],
        ])  # fmt: skip
        return cls(matrix, np.array([k1, k2, 0.0, 0.0, 0.0]), size)

    @property
    def numbers(self) -> Vector:
        """The six numbers (6,) of ``LensTerms``."""
        width, height = self.size
        (fx, _, cx), (_, fy, cy) = self.matrix[:2].tolist()
        k1, k2 = self.distortion[:2].tolist()
        return np.array(
            [fx / width - 1.0, fy / fx - 1.0, cx / width - 0.5, (cy - 0.5 * height) / width, k1, k2]
        )


@dataclass(frozen=True, slots=True, eq=False)
class BoardView(FrozenArrays):
    """Corners of a board in a picture.

    Attributes:
        ids: The numbers (k,) of the corners.
        pixels: The pixels (k, 2) of the corners.
        size: Width and height of the picture.
    """

    ids: NDArray[np.int64]
    pixels: Matrix
    size: tuple[int, int]


def is_mirrored(board: Board, picture: Picture) -> bool:
    """Check whether the board is found in the mirror image of a picture."""
    return len(_detect(board, np.ascontiguousarray(picture[:, ::-1]))[1]) >= _MIN_CORNERS


def find_board(board: Board, picture: Picture) -> BoardView:
    """Find a board in a picture.

    Raises:
        PictureError: The board is missing, incomplete, blurred, mirrored or of another kind; the
            message says which.
    """
    import cv2  # noqa: PLC0415  # from the extra `camera`

    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    corners, ids, markers = _detect(board, grey)
    if len(ids) >= _MIN_CORNERS:
        return BoardView(ids, corners, (grey.shape[1], grey.shape[0]))
    if is_mirrored(board, grey):
        raise PictureError("The picture is mirrored.", "Switch mirroring off in the camera.")
    if markers and not len(ids):
        text = f"The picture shows too little of the board, or a board other than {board.name}."
        raise PictureError(text, "Give the name of the board that you printed.")
    contrast = float(grey.std())
    sharpness = float(cv2.Laplacian(grey, cv2.CV_64F).var()) / max(contrast**2, 1.0)
    if contrast > 5.0 and sharpness < _MIN_SHARPNESS:
        raise PictureError("The picture is blurred.", "Focus the camera, or add light.")
    raise PictureError(f"The board {board.name} is not in the picture.",
                       "Hold the board flat and well lit where the camera sees it.")  # fmt: skip


def guess_intrinsics(board: Board, views: Sequence[BoardView]) -> Intrinsics:
    """Estimate only the focal length from views of a board, to start the full estimate.

    Raises:
        CalibrationError: The views do not suffice.
    """
    import cv2  # noqa: PLC0415  # from the extra `camera`

    cv = cast("Any", cv2)  # the type stubs are incomplete
    if not views:
        raise CalibrationError(
            f"No picture shows the board {board.name}.", "Take pictures that show the board."
        )
    points = [board.corners_m()[view.ids].astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    size = views[0].size
    start = Intrinsics.of_numbers(np.zeros(6), size).matrix.copy()
    flags = (
        cv.CALIB_USE_INTRINSIC_GUESS
        | cv.CALIB_FIX_PRINCIPAL_POINT
        | cv.CALIB_FIX_ASPECT_RATIO
        | cv.CALIB_ZERO_TANGENT_DIST
        | cv.CALIB_FIX_K1
        | cv.CALIB_FIX_K2
        | cv.CALIB_FIX_K3
    )
    try:
        rms, matrix, _, _, _ = cv.calibrateCamera(
            points, pixels, size, start, np.zeros(5), flags=flags
        )
    except cv2.error:
        rms, matrix = np.inf, start
    if not rms < _MAX_FIRST_PX or not 0.2 < matrix[0, 0] / size[0] < 10.0:
        hint = "Show the board near and far, tilted, and all over the picture."
        raise CalibrationError("The pictures do not determine the lens of the camera.", hint)
    return Intrinsics(np.asarray(matrix), np.zeros(5), size)


def board_sample(
    board: Board, view: BoardView, intrinsics: Intrinsics, q: Vector, name: str
) -> BoardSample:
    """Return the sample of a view of the board at measured joints (dof,), with its lens terms.

    Raises:
        CalibrationError: No pose fits the corners.
    """
    T = board_pose(board, view, intrinsics)
    return BoardSample(q, T, name, lens_terms(intrinsics, T, board.corners_m()[view.ids], view))


def lens_terms(
    intrinsics: Intrinsics, T: Matrix, corners_m: Matrix, view: BoardView | None = None
) -> LensTerms:
    """Compute the lens terms from the corners (k, 3) of a board at a pose (4, 4).

    The corners are in the board frame, the pose is in the camera frame. Without a view, the corners
    are exactly at their expected places.
    """
    import cv2  # noqa: PLC0415  # from the extra `camera`

    from_origin = corners_m @ T[:3, :3].T
    project = cast("Any", cv2).projectPoints  # missing from its stubs
    projected, slopes = project(
        from_origin + T[:3, 3], np.zeros(3), np.zeros(3), intrinsics.matrix, intrinsics.distortion
    )
    projected, slopes = np.asarray(projected, float), np.asarray(slopes, float)
    width, (fx, fy) = intrinsics.size[0], np.diag(intrinsics.matrix)[:2]
    by_point = slopes[:, 3:6].reshape(-1, 2, 3)
    by_pose = np.concatenate(
        [by_point, -by_point @ np.array([skew(point) for point in from_origin])], axis=2
    ).reshape(-1, 6)
    by_fx, by_fy, by_cx, by_cy, by_k1, by_k2 = slopes[:, 6:12].T
    by_lens = np.stack(
        [width * (by_fx + fy / fx * by_fy), fx * by_fy, width * by_cx, width * by_cy, by_k1, by_k2],
        axis=1,
    )
    moved = -np.linalg.lstsq(by_pose, by_lens, rcond=None)[0]
    error = (projected[:, 0] - (projected[:, 0] if view is None else view.pixels)).ravel()
    spread = max(float(error @ error) / (len(error) - 6), _LEAST_NOISE_PX**2)
    left = by_lens + by_pose @ moved
    noise = spread * np.linalg.inv(by_pose.T @ by_pose)
    slope, information = left.T @ error / spread, left.T @ left / spread
    return LensTerms(intrinsics.numbers, moved, slope, information, noise)


def board_pose(board: Board, view: BoardView, intrinsics: Intrinsics) -> Matrix:
    """Compute the pose (4, 4) of the board in the camera.

    A flat board may have two poses; the pose with the smaller error is returned.

    Raises:
        PictureError: No pose fits the corners.
    """
    import cv2  # noqa: PLC0415  # from the extra `camera`

    points = board.corners_m()[view.ids]
    count, turns, places, errors = cv2.solvePnPGeneric(
        points, view.pixels, intrinsics.matrix, intrinsics.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not count or not float(np.ravel(errors)[0]) < _MAX_REPROJECTION_PX:
        raise PictureError("The board is bent or hard to see.", "Glue the board on something flat.")
    turn, at = cv2.solvePnPRefineLM(
        points, view.pixels, intrinsics.matrix, intrinsics.distortion, turns[0], places[0]
    )
    return make_pose(np.ravel(at), exp_so3(np.ravel(turn)))


def _detect(board: Board, grey: Picture) -> tuple[Matrix, NDArray[np.int64], int]:
    """Return the corners (k, 2), their ids (k,), and the number of markers seen."""
    import cv2  # noqa: PLC0415  # from the extra `camera`

    corners, ids, _, markers = cv2.aruco.CharucoDetector(board.opencv()).detectBoard(grey)
    seen = 0 if markers is None else len(markers)
    if ids is None or corners is None:
        return np.zeros((0, 2)), np.zeros(0, dtype=np.int64), seen
    found = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    return found, np.asarray(ids, dtype=np.int64).ravel(), seen
