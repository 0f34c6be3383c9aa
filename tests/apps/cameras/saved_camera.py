"""The camera of a simulated arm, saved as if calibrated without any error."""

from datetime import UTC, datetime

import numpy as np

from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.camera_calibration import seen_board
from ikservo.apps.cameras.camera_file import SIMULATED, CameraFile, save_camera
from ikservo.calibration.records import CalibratedCamera
from ikservo.cli.camera_options import DEFAULT_BOARD
from ikservo.kinematics.se3 import log_so3
from servosim.camera import SimulatedCamera, SimulatedView
from tests.arm.simulated import line_of

BOARD = Board.named(DEFAULT_BOARD)
SEEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


def save_simulated_camera(arm, source="sim"):
    """Save the camera of a simulated arm without errors; return it."""
    camera = SimulatedCamera(line_of(arm).world, BOARD.opencv())
    known = CameraFile(calibrated=SEEN, camera=calibrated_camera(camera, source))
    save_camera(arm.model.name, SIMULATED, known)
    return camera


def calibrated_camera(camera, source, tip_shows=None):
    """Return the calibration of the simulator's own camera, without any error."""
    view, T = SimulatedView(), camera.T_base_camera
    width, height = view.size
    return CalibratedCamera(
        source=source,
        seen=SEEN,
        pictures=24,
        left_out=0,
        before_mm=1.0,
        after_mm=0.2,
        size_px=view.size,
        lens_px=(view.focal_px, view.focal_px, width / 2, height / 2),
        distortion=(*view.distortion, 0.0, 0.0, 0.0),
        at_mm=tuple((1000 * T[:3, 3]).tolist()),
        turned_deg=tuple(np.degrees(log_so3(T[:3, :3])).tolist()),
        board=seen_board(BOARD.name, camera.T_tip_board, 1.0),
        tip_shows=tip_shows,
    )
