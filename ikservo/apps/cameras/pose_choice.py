"""Choose postures in which the board is visible and the next picture is most informative."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.board_detection import Intrinsics, lens_terms
from ikservo.apps.cameras.camera_and_arm_fit import BoardSample, CameraFit, picture_information
from ikservo.kinematics.arrays import Matrix

_MAX_TILT_RAD = math.radians(50.0)
_MARGIN = 0.04  # free margin around the board, as a fraction of the picture
_NEAREST = 2.5  # smallest distance, in board lengths
_MIN_SQUARE_PX = 18.0  # smallest foreshortened square: two pixels per bit of a marker


def is_visible(board: Board, intrinsics: Intrinsics, T_camera_board: Matrix) -> NDArray[np.bool_]:
    """Check which boards (n, 4, 4) are fully in the picture, large enough and not too tilted."""
    half = np.array([board.columns, board.rows, 0.0]) * board.square_m / 2.0
    corners = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]) * half
    points = T_camera_board[:, None, :3, :3] @ corners[:, :, None]
    points = points[..., 0] + T_camera_board[:, None, :3, 3]
    depth = np.maximum(points[..., 2:], 1e-3)
    projected = points / depth @ intrinsics.matrix.T
    size = np.array(intrinsics.size)
    inside = (projected[..., :2] > _MARGIN * size) & (projected[..., :2] < (1.0 - _MARGIN) * size)
    at = T_camera_board[:, :3, 3]
    distance = np.linalg.norm(at, axis=1)
    facing = np.sum(at * T_camera_board[:, :3, 2], axis=1) / np.maximum(distance, 1e-6)
    side = 2.0 * float(np.max(half))
    square_px = intrinsics.matrix[0, 0] * board.square_m * facing / np.maximum(distance, 1e-6)
    return (
        inside.all(axis=(1, 2))
        & (points[..., 2] > 0.0).all(axis=1)
        & (distance > _NEAREST * side)
        & (square_px > _MIN_SQUARE_PX)
        & (facing > math.cos(_MAX_TILT_RAD))
    )


def choose_postures(
    board: Board,
    fit: CameraFit,
    intrinsics: Intrinsics,
    candidates: Matrix,
    done: Matrix,
    count: int,
) -> list[int]:
    """Choose postures one by one; each adds the most information to those already chosen.

    The most informative posture increases the determinant of the information about camera, lens,
    board, zeros and compliances the most (D-optimality; Fedorov 1972). Postures are rows:
    candidates (n, dof), and existing pictures in ``done`` (m, dof).

    Returns:
        The indices of the chosen candidates.
    """
    corners_m = board.corners_m()
    samples = [
        [BoardSample(q, T, "", lens_terms(intrinsics, T, corners_m))
         for q, T in zip(some, fit.board_poses(some), strict=True)]
        for some in (done, candidates)
    ]  # fmt: skip
    known = picture_information(fit, samples[0])[0]
    rows = picture_information(fit, samples[1])[1]
    chosen: list[int] = []
    for _ in range(min(count, len(candidates))):
        inverse = np.linalg.inv(known)
        gain = np.linalg.slogdet(np.eye(12) + rows @ inverse @ rows.swapaxes(1, 2))[1]
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        known = known + rows[best].T @ rows[best]
    return chosen
