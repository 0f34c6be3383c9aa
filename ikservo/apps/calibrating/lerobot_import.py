"""Import a LeRobot calibration and check it against the servos."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.calibration.homing import TickRange
from ikservo.calibration.joint_map import encoder_of
from ikservo.calibration.lerobot import LerobotJoint
from ikservo.calibration.servo_config import ServoConfig
from ikservo.errors import CalibrationError
from ikservo.model import Model
from ikservo.registers import Family


def check_lerobot_joints(joints: Sequence[LerobotJoint], model: Model, loose: TorqueOffArm) -> None:
    """Check LeRobot's joints against the joints of the arm.

    Raises:
        CalibrationError: A joint is missing, or a servo has a different id or direction.
    """
    recorded = {joint.name: joint for joint in joints}
    for name in recorded.keys() ^ {joint.name for joint in model.joints}:
        where = "the arm file" if name in recorded else "LeRobot's file"
        raise CalibrationError(f"{where} has no joint {name!r}.", "Choose the arm with --arm.")
    for own in model.joints:
        row, facts = recorded[own.name], loose.facts[own.servo.id]
        if row.id != own.servo.id:
            raise CalibrationError(
                f"{own.name} has id {row.id} in LeRobot's file and {own.servo.id} in the arm file.",
                "The file may belong to another arm.",
            )
        if row.drive_mode != facts.registers.get("drive_mode", 0) & 1:
            raise CalibrationError(
                f"{own.name} counts in the opposite direction from LeRobot's file: drive_mode is "
                f"{facts.registers.get('drive_mode', 0)} in the servo "
                f"and {row.drive_mode} in the file.",
                "Calibrate it: ikservo calibrate",
            )


def lerobot_travels(joints: Sequence[LerobotJoint], loose: TorqueOffArm) -> dict[str, TickRange]:
    """Return the ranges that LeRobot recorded, as travels in raw ticks by joint."""
    travels: dict[str, TickRange] = {}
    for joint in joints:
        feetech = loose.facts[joint.id].table.family is Family.FEETECH_STS
        shift = joint.homing_offset if feetech else -joint.homing_offset
        if not joint.is_continuous:
            travels[joint.name] = TickRange(joint.range_min + shift, joint.range_max + shift)
    return travels


def with_lerobot_homing(
    joints: Sequence[LerobotJoint], facts: Mapping[int, ServoConfig]
) -> dict[int, ServoConfig]:
    """Return the servos' configuration with the homing offsets that LeRobot recorded."""
    changed = dict(facts)
    for joint in joints:
        held = {**facts[joint.id].registers, "homing_offset": joint.homing_offset}
        if "homing_offset" in facts[joint.id].registers:
            changed[joint.id] = replace(facts[joint.id], registers=held)
    return changed


def lerobot_mismatches(
    joints: Sequence[LerobotJoint], facts: Mapping[int, ServoConfig]
) -> Iterator[str]:
    """Yield a warning for each homing offset that differs from LeRobot's recording."""
    for joint in joints:
        held = facts[joint.id].registers.get("homing_offset", 0)
        encoder = encoder_of(facts[joint.id].table)
        if (held - joint.homing_offset) % encoder.ticks:
            yield (
                f"{joint.name} holds homing_offset {held}; LeRobot recorded "
                f"{joint.homing_offset}, which will be written."
            )
