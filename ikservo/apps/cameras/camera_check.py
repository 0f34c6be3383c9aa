"""Check with a board at a known place whether a calibrated camera has moved."""

from __future__ import annotations

import math
from datetime import datetime

import numpy as np

from ikservo.apps.cameras.arm_camera import camera_key, camera_model, known_camera, size_error
from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import BoardView, PictureSource, board_pose, find_board
from ikservo.apps.cameras.camera_calibration import measured_joints, seen_board
from ikservo.apps.cameras.camera_file import CameraCheck, CameraFile, save_camera
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.arm.arm import Arm
from ikservo.calibration.records import CalibratedCamera, SeenBoard
from ikservo.errors import CalibrationError, PictureError
from ikservo.kinematics.arrays import Matrix
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose

_OFF_MM, _OFF_DEG = 3.0, 1.5  # more than the noise in a picture
_ON_GRIPPER_MM, _ON_GRIPPER_DEG = 30.0, 10.0  # a board that is closer than this has not been moved
_GRIPPER_DEG = 1.0  # additional tilt of a board on the gripper from joint errors
_LOOKS = 5


class BoardPlace:
    """The stored place of the board for a check: on the table, or on the gripper.

    Raises:
        CalibrationError: The calibration does not say where the board was.
    """

    def __init__(self, camera: CalibratedCamera, known: CameraFile) -> None:
        self._camera = camera
        self.on_table = known.board is not None
        stored = known.board or camera.board
        if stored is None:
            raise CalibrationError(
                "The calibration of the camera does not say where the board was.",
                "Calibrate it again, or remember a board on the table: --remember",
            )
        self._stored, self.board = stored, Board.named(stored.name)

    def pose(self, T_base_tip: Matrix) -> Matrix:
        """Return T_base_board (4, 4)."""
        T = stored_pose(self._stored)
        return T if self.on_table else T_base_tip @ T

    @property
    def scale(self) -> float:
        """The board's size relative to the size in its name."""
        return self._stored.scale

    def limits(self, within_mm: float | None) -> tuple[float, float]:
        """Return the maximum apparent motion [mm, degrees] of a camera that counts as unmoved."""
        if self.on_table:
            return within_mm or _OFF_MM, _OFF_DEG
        return within_mm or _OFF_MM + 2.0 * self._camera.after_mm, _OFF_DEG + _GRIPPER_DEG


def check_camera(
    arm: Arm, source: PictureSource, now: datetime, within_mm: float | None = None, name: str = ""
) -> tuple[CameraCheck, BoardPlace]:
    """Measure the pose of the board, and save whether the camera has moved; the arm stays still.

    ``within_mm`` is the maximum accepted shift; None: the error of the calibration.

    Raises:
        UnknownNameError: The arm has no camera of that name.
        CalibrationError: The arm has no calibrated camera.
        PictureError: The board is not seen.
        FileWriteError: The result cannot be saved.
    """
    camera, known, name = known_camera(arm.context, name)
    place = BoardPlace(camera, known)
    view = _look(source, place.board)
    check = compare_place(camera_model(camera), place, _tip_pose(arm), view, now, within_mm)
    known = known.model_copy(update={"check": check})
    save_camera(arm.model.name, camera_key(arm.context), known, name)
    return check, place


def remember_board(arm: Arm, source: PictureSource, board: Board, name: str = "") -> SeenBoard:
    """Save the place of a board on the table, for later checks of the named camera.

    Raises:
        CalibrationError: The arm has no calibrated camera, or it has moved.
        PictureError: The board is not seen, or it is still on the gripper.
        FileWriteError: The place cannot be saved.
    """
    camera, known, name = known_camera(arm.context, name)
    model, view = arm.camera.named(name).model(), _look(source, board)
    if camera.board is not None and camera.board.name == board.name:
        gripper = BoardPlace(camera, CameraFile(calibrated=known.calibrated))
        check = compare_place(model, gripper, _tip_pose(arm), view, known.calibrated)
        if check.off_mm < _ON_GRIPPER_MM and check.turned_deg < _ON_GRIPPER_DEG:
            raise PictureError(
                "The board is still on the gripper, where it would move with the arm.",
                "Take it off, and lay it on the table in front of the camera.",
            )
    T = model.T_base_camera @ _seen(model, board, view)
    stored = seen_board(board.name, T, 1.0)
    known = known.model_copy(update={"board": stored})
    save_camera(arm.model.name, camera_key(arm.context), known, name)
    return stored


def compare_place(
    model: CameraModel,
    place: BoardPlace,
    T_base_tip: Matrix,
    view: BoardView,
    now: datetime,
    within_mm: float | None = None,
) -> CameraCheck:
    """Compare the observed place of a board with its stored place, given the tip pose (4, 4).

    See ``check_camera`` for ``within_mm``.

    Raises:
        CalibrationError: The board cannot be measured, or the picture has a different size.
    """
    T_base_board = place.pose(T_base_tip)
    T_seen = _seen(model, place.board, view)
    corners = place.scale * place.board.corners_m()[view.ids]
    px, depth_m = model.project(corners @ T_base_board[:3, :3].T + T_base_board[:3, 3])
    away_px = float(np.linalg.norm(px - view.pixels)) / math.sqrt(len(view.ids))
    away_m = float(np.mean(np.abs(depth_m)))  # a moved camera may expect the board behind itself
    off_mm = 1000.0 * away_px * away_m / float(model.lens.matrix[0, 0])
    T_seen = make_pose(place.scale * T_seen[:3, 3], T_seen[:3, :3])
    T_base_camera = T_base_board @ np.linalg.inv(T_seen)
    before = model.T_base_camera
    turned_deg = math.degrees(
        float(np.linalg.norm(log_so3(before[:3, :3].T @ T_base_camera[:3, :3])))
    )
    most_mm, most_deg = place.limits(within_mm)
    return CameraCheck(
        seen=now,
        off_mm=off_mm,
        moved_mm=1000.0 * float(np.linalg.norm(T_base_camera[:3, 3] - before[:3, 3])),
        turned_deg=turned_deg,
        has_moved=off_mm > most_mm or turned_deg > most_deg,
    )


def _look(source: PictureSource, board: Board) -> BoardView:
    """Find a board in the first of several pictures that shows it."""
    for _ in range(_LOOKS - 1):
        try:
            return find_board(board, source.take())
        except CalibrationError:
            continue
    return find_board(board, source.take())


def _seen(model: CameraModel, board: Board, view: BoardView) -> Matrix:
    if view.size != model.lens.size:
        raise size_error(view.size, model.lens.size)
    return board_pose(board, view, model.lens)


def _tip_pose(arm: Arm) -> Matrix:
    return arm.chain.forward(measured_joints(arm.chain, arm.where()))


def stored_pose(stored: SeenBoard) -> Matrix:
    """Return the stored pose (4, 4) of a board."""
    return make_pose(np.array(stored.at_mm) / 1000.0, exp_so3(np.radians(stored.turned_deg)))
