"""Convert LeRobot's joint values, whose zeros are the middle of each swept range, to positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.calibration.lerobot import LerobotJoint
from ikservo.calibration.records import Calibration
from ikservo.errors import CalibrationError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.registers import MODELS, Family

_DEGREES_PER_TICK = 360.0 / 4095.0  # LeRobot's scale


def positions_of_lerobot(
    values: Matrix,
    names: Sequence[str],
    joints: Sequence[LerobotJoint],
    calibration: Calibration,
    model: Model,
    *,
    percent: bool = False,
) -> Matrix:
    """Compute positions (k, n), rad or m, from values (k, m) of a LeRobot robot.

    Values are degrees from the middle of the swept range or, in ``percent``, -100 to 100 %; gripper
    values are 0 to 100 %. ``names`` are the columns of the values; the joints of ``model``
    are the columns of the result. ``joints`` are LeRobot's calibration at the time of the values,
    ``calibration`` has the zeros of the geometry.

    Raises:
        CalibrationError: A joint is missing from a calibration, or has a different servo.
    """
    recorded = {joint.name: joint for joint in joints}
    columns: list[Vector] = []
    for joint in model.joints:
        theirs, own = recorded.get(joint.name), calibration.joint(joint.name)
        if theirs is None or own is None or joint.name not in names or theirs.id != own.servo.id:
            raise CalibrationError(
                f"The data set and the two calibrations give different servos for {joint.name}.",
                "Choose the arm with --arm and LeRobot's calibration of it with --calibration.",
            )
        column = values[:, list(names).index(joint.name)]
        low, high = theirs.range_min, theirs.range_max
        is_gripper = joint.role == "gripper"
        if percent or is_gripper:
            share = column / 100.0 if is_gripper else (column + 100.0) / 200.0
            if theirs.drive_mode:
                share = 1.0 - share
            ticks = low + share * (high - low)
        else:
            ticks = (low + high) / 2.0 + column / _DEGREES_PER_TICK
        # The servo's offset may have changed since the recording.
        feetech = MODELS[own.servo.model].family is Family.FEETECH_STS
        shift = theirs.homing_offset - own.servo.holds.get("homing_offset", 0)
        reported = ticks + (shift if feetech else -shift)
        joint_map = own.joint_map(joint.joint_map)
        columns.append(np.array([joint_map.position(float(tick)) for tick in reported]))
    return np.stack(columns, axis=1)
