"""Compute the distance that joints travel after the last goal, divided by their speed.

The goal of a moving joint leads it, because a position servo produces torque only while its joint
lags. When the program is killed, the joint still moves to its last goal, and swings past it if it
has little damping. With inertia I, damping b, stiffness k, and ``w = sqrt(k / I)``, ``z = b / (2
sqrt(k I))``, a joint at the speed v continues by v times::

    delay + b / k + exp(-z (pi - acos z) / sqrt(1 - z^2)) / w        the last term if z < 1

This is the response of the linear system from its lag ``b v / k``. Gravity and friction of a moving
joint only shift its final position.
"""

from __future__ import annotations

from math import acos, exp, pi, sqrt

import numpy as np

from ikservo.kinematics import Chain
from ikservo.model.arm_model import Model
from ikservo.model.joint_drive import JointDrive, joint_drive, nominal_parameters
from ikservo.model.load_lag import spread_postures
from ikservo.model.servo_torque import GRIPPER_P_GAINS, find_servo_torque

# Margin: servos differ in torque and damping by a twentieth, and the joints of an arm push each
# other. With 1.05, a joint of a wx250s moved on by 63 ticks, not 60, after 2 of 24 kills.
_MARGIN = 1.15


def stopping_times_s(model: Model, chain: Chain) -> dict[str, float]:
    """Return the travel of each joint after its last goal, divided by its speed, seconds by joint.

    Joints whose servos are unknown are left out.
    """
    greatest: dict[str, float] = {}  # inertia that a joint moves with the payload, any posture
    parameters = nominal_parameters(model, chain)
    if parameters is not None:
        loaded = parameters.dynamics.with_payload(model.payload_kg)
        matrices = loaded.inertia_matrix(spread_postures(chain))
        most = np.diagonal(matrices, axis1=1, axis2=2).max(axis=0)
        greatest = dict(zip(chain.names, most.tolist(), strict=True))
    times_s: dict[str, float] = {}
    for joint in model.joints:
        drive, servo = joint_drive(joint, model.supply_v), joint.servo.model
        torque = find_servo_torque(servo, model.supply_v)
        if drive is not None and torque is not None and joint.role == "gripper":
            drive = drive.with_gain(GRIPPER_P_GAINS.get(servo, torque.p_gain) / torque.p_gain)
        if drive is not None:
            inertia_kg_m2 = drive.armature_kg_m2 + greatest.get(joint.name, 0.0)
            times_s[joint.name] = _MARGIN * _stopping_time_s(drive, inertia_kg_m2)
    return times_s


def _stopping_time_s(drive: JointDrive, inertia_kg_m2: float) -> float:
    stiffness, damping = drive.stiffness_nm_rad, drive.damping_nm_s
    lag_s = drive.delay_s + damping / stiffness
    share = 0.5 * damping / sqrt(stiffness * inertia_kg_m2)
    if share >= 1.0:
        return lag_s
    decay = exp(-share * (pi - acos(share)) / sqrt(1.0 - share**2))
    return lag_s + decay * sqrt(inertia_kg_m2 / stiffness)
