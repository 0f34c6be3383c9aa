"""The zero of the last joint by one click: where the tip is in the picture of a known camera.

A board on the gripper does not tell that zero from how it was fixed; the tip itself does. The zero
moves the tip along an arc in the picture, of which the point nearest to the click is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ikservo.arm.arm import Arm
from ikservo.arm.camera import known_camera
from ikservo.calibration.calibration_file import save_calibration
from ikservo.calibration.records import CalibratedCamera, Calibration
from ikservo.errors import CalibrationError
from ikservo.eyes.camera_model import CameraModel
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.chain import Chain
from ikservo.maintenance.camera_calibration import (
    ArmBefore,
    chain_maps,
    measured_joints,
    seen_board,
)
from ikservo.maintenance.camera_check import stored_pose
from ikservo.maintenance.touch_off import shift_zeros

__all__ = ["TipZero", "find_tip_zero", "save_tip_zero"]

_MOST_RAD, _STEP_RAD = math.radians(10.0), math.radians(0.05)  # of zeros that are set by eye
_LEAST_PX, _GOOD_PX = 1.0, 2.0  # by which a degree has to move the tip in the picture
_OFF_MM = 3.0  # by which a good click is beside the arc, besides what the camera is wrong
_POSTURES = 37  # of each joint, among which a better one is looked for
_REST_S, _REST_RAD = 0.3, math.radians(0.1)
_SAME_TICK = 0.01


@dataclass(frozen=True, slots=True)
class TipZero:
    """What a click on the tip says.

    Attributes:
        joint: The last one.
        shift_rad: By how much it is further than it measured.
        off_m: How far the click is from the tip then, across the line of sight.
        px_per_deg: By how many pixels a degree of the joint moves the tip.
        before: The calibration by which it was found.
        calibration: The same with that zero.
    """

    joint: str
    shift_rad: float
    off_m: float
    px_per_deg: float
    before: Calibration
    calibration: Calibration

    def __str__(self) -> str:
        return (
            f"{self.joint} is {math.degrees(self.shift_rad):+.2f}° from where it measured; the tip "
            f"is then {1000.0 * self.off_m:.1f} mm beside the click."
        )


def find_tip_zero(
    arm: Arm,
    pixel: tuple[float, float],
    written: datetime,
    name: str = "",
    q: Vector | None = None,
) -> TipZero:
    """Find the zero of the last joint with which the tip is at a pixel; nothing is saved.

    Args:
        arm: The arm before the camera, at rest.
        pixel: Where the tip was clicked (u, v).
        written: The time of the calibration with that zero.
        name: Of the camera; see ``known_camera``.
        q: The joints (dof,) of the resting arm; measured if None.

    Raises:
        BadValueError: The pixel is not in the picture.
        CalibrationError: The arm has no such calibrated camera, it has moved, the calibration has
            determined that zero or has changed since the arm was opened, the picture shows too
            little of it, the arm moves, or no plausible zero explains the click.
    """
    camera, _, name = known_camera(arm.context, name)
    model, joint = arm.camera.named(name).model(), arm.chain.names[-1]
    ray = model.ray(*pixel)
    calibration = ArmBefore.of(arm).calibration
    if calibration is None:
        raise CalibrationError("A simulated arm's zeros are right; none is set by a click.")
    if camera.tip_shows != joint:
        raise CalibrationError(
            f"The zero of {joint} is not left to a click on the tip.",
            "The pictures of the board have shown it, or it hardly moves the tip.",
        )
    _require_same(arm, calibration)
    q = _resting_joints(arm) if q is None else q
    steps = np.arange(-_MOST_RAD, _MOST_RAD, _STEP_RAD)
    tried = q + steps[:, None] * np.eye(arm.chain.dof)[-1]
    away_m = np.cross(arm.chain.forward(tried)[:, :3, 3] - ray.origin_m, ray.direction)
    off_m = np.linalg.norm(away_m, axis=1)
    best = int(np.argmin(off_m))
    hint = "Click where the tip is, between the fingertips, in a picture of the arm as it stands."
    beside_mm = 1000.0 * float(off_m[best])
    if beside_mm > _OFF_MM + 2.0 * camera.after_mm:
        raise CalibrationError(
            f"The click is {beside_mm:.0f} mm from every place where the tip can be.", hint
        )
    px_per_deg = float(_px_per_deg(model, arm.chain, tried[best : best + 1])[0])
    if px_per_deg < _LEAST_PX:
        raise CalibrationError(
            f"Each degree of {joint} moves the tip by {px_per_deg:.1f} pixels in this picture: "
            "too little.",
            _better_posture(model, arm.chain, q),
        )
    if best in (0, len(steps) - 1):
        most_deg = math.degrees(_MOST_RAD)
        raise CalibrationError(
            f"By this click the zero of {joint} would be off by {most_deg:.0f}° or more.", hint
        )
    changed = _with_last_zero(arm, calibration, q, tried[best], written)
    return TipZero(joint, float(steps[best]), beside_mm / 1000.0, px_per_deg, calibration, changed)


def save_tip_zero(arm: Arm, found: TipZero) -> Path:
    """Save a zero, and return the file; ``undo_calibration`` takes it back.

    Raises:
        CalibrationError: The calibration has changed since the click.
        FileWriteError: It cannot be saved.
    """
    if ArmBefore.of(arm).calibration != found.before:
        raise CalibrationError(
            "The calibration has changed since the click.", "Open the arm again, and click."
        )
    return save_calibration(found.calibration)


def _resting_joints(arm: Arm) -> Vector:
    """Return the measured joints (dof,) of a chain at rest.

    Raises:
        CalibrationError: It moves.
    """
    before, clock = measured_joints(arm.chain, arm.where()), arm.clock
    clock.sleep_until(clock.now_s() + _REST_S)
    after = measured_joints(arm.chain, arm.where())
    if np.abs(after - before).max() > _REST_RAD:
        raise CalibrationError("The arm moves.", "Click once it rests.")
    return after


def _require_same(arm: Arm, calibration: Calibration) -> None:
    """Check that the arm's joints are measured with the zeros of a calibration.

    Raises:
        CalibrationError: They are not.
    """
    present = {each.joint: each.joint_map for each in arm.context.servos.driven_joints}
    for own in chain_maps(arm.model, calibration):
        turn_ticks = math.tau / own.horn_rad_per_tick
        apart = math.remainder(own.zero_tick - present[own.joint].zero_tick, turn_ticks)
        if abs(apart) > _SAME_TICK:
            raise CalibrationError(
                "The calibration has changed since the arm was opened.", "Open the arm again."
            )


def _px_per_deg(model: CameraModel, chain: Chain, q: Matrix) -> Vector:
    """Compute by how many pixels (n,) a degree of the last joint moves the tip at joints (n, dof).

    Where the tip is not before the camera or beside the picture, that is 0.
    """
    (px, depth_m), (then, _) = (
        model.project(chain.forward(each)[:, :3, 3])
        for each in (q, q + math.radians(1.0) * np.eye(chain.dof)[-1])
    )
    is_seen = (depth_m > 0.0) & (px > 0.0).all(axis=1) & (px < model.lens.size).all(axis=1)
    return np.where(is_seen, np.linalg.norm(then - px, axis=1), 0.0)


def _better_posture(model: CameraModel, chain: Chain, q: Vector) -> str:
    """Return which joint to move, the least far, so that the picture shows enough."""
    tried = np.tile(q, (chain.dof, _POSTURES, 1))
    for i, (low, high) in enumerate(zip(chain.lower_rad, chain.upper_rad, strict=True)):
        tried[i, :, i] = np.linspace(max(low, -math.pi), min(high, math.pi), _POSTURES)
    tried = tried.reshape(-1, chain.dof)
    shown = tried[_px_per_deg(model, chain, tried) > _GOOD_PX]
    if not len(shown):
        return "Calibrate with a camera that sees the arm from its side."
    nearest = shown[np.argmin(np.abs(shown - q).max(axis=1))]
    i = int(np.argmax(np.abs(nearest - q)))
    return f"Move {chain.names[i]} to {math.degrees(nearest[i]):.0f}° first, and click again."


def _with_last_zero(
    arm: Arm, calibration: Calibration, q: Vector, moved: Vector, written: datetime
) -> Calibration:
    """Return a calibration with which joints (dof,) measure moved, and what is on the tip stays."""
    joints = shift_zeros(calibration.joints, chain_maps(arm.model, calibration), moved - q)
    T_moved_tip = np.linalg.inv(arm.chain.forward(moved)) @ arm.chain.forward(q)
    cameras: dict[str, CalibratedCamera] = {}
    for name, camera in calibration.cameras_by_name.items():
        board = camera.board
        if board is not None:
            board = seen_board(board.name, T_moved_tip @ stored_pose(board), board.scale)
        cameras[name] = camera.model_copy(update={"board": board})
    changed = calibration.model_copy(update={"joints": joints, "written": written})
    return changed.with_cameras(cameras)
