"""The state of servos as plain data: for the table on the screen and the control socket."""

from __future__ import annotations

import math
from typing import Any

from servosim.joint import Joint
from servosim.servo import Servo

__all__ = ["joint_state", "servo_state"]


def servo_state(joint: Joint, servo: Servo) -> dict[str, Any]:
    """Return what a servo's memory and motor say; positions in ticks of its registers."""
    motor = servo.motor
    return {
        "id": servo.id,
        "model": servo.table.model,
        "joint": joint.name,
        "position": servo.read("present_position"),
        "goal": servo.read("goal_position"),
        "torque": servo.drive.torque_on,
        "moving": motor.moving,
        "load": motor.torque_nm / motor.parameters.stall_torque_nm,
        "current_a": motor.current_a,
        "temperature_c": motor.temperature_c,
        "voltage_v": servo.supply_v,
        "alarm": servo.alarm,
        "powered": servo.powered,
        "baud": servo.baud,
    }


def joint_state(joint: Joint) -> dict[str, Any]:
    """Return the truth about a joint: degrees of a revolute one, metres of a prismatic one."""
    if joint.slides:
        return {"position_m": joint.position, "velocity_m_s": joint.velocity}
    return {
        "position_deg": math.degrees(joint.position),
        "velocity_deg_s": math.degrees(joint.velocity),
    }
