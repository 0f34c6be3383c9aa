"""An arm in front of a camera with only one error: the zero of its last joint."""

import numpy as np

from ikservo.apps.cameras.camera_calibration import chain_maps, seen_board
from ikservo.calibration.calibration_file import load_calibration, save_calibration
from ikservo.calibration.records import shift_zeros
from tests.apps.cameras.hidden_arms import BOARD, hidden_arm
from tests.apps.cameras.saved_camera import calibrated_camera
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import SERIAL

ARM, JOINT, OFF_DEG = "open_manipulator_x", "joint4", 2.5


def mistaken_tip(monkeypatch, off_deg=OFF_DEG):
    """Return the arm, whose last joint measures too little by the given angle, and its camera.

    The calibration of the board agrees with that error: the board alone does not reveal it.
    """
    arm, camera = hidden_arm(monkeypatch, ARM, 5, zeros_deg=0.0, compliance=0.0)
    model, known = load_model(ARM), load_calibration(ARM, SERIAL)
    zeros = np.array([0.0, 0.0, 0.0, np.radians(off_deg)])
    q = np.array([arm.true_position(name) for name in model.chain.names])
    said, true = model.chain.forward(q - zeros), model.chain.forward(q)
    seen = calibrated_camera(camera, "0", tip_shows=JOINT)
    board = seen_board(BOARD.name, np.linalg.inv(said) @ true @ camera.T_tip_board, 1.0)
    cameras = {"": seen.model_copy(update={"board": board})}
    joints = shift_zeros(known.joints, chain_maps(model, known), -zeros)
    save_calibration(known.model_copy(update={"joints": joints}).with_cameras(cameras))
    return arm, camera


def tip_pixel(arm, camera):
    """Return where the tip is in the camera's picture."""
    positions = [joint.position for joint in arm.world.joints]
    return tuple(camera.pixel(arm.world.tip.position_m(positions)).tolist())
