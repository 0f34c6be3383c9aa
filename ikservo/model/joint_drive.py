"""Drives of an arm's joints: stiffness, damping, friction and inertia of their servos."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, inf, tau

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model.arm_model import Model, ModelJoint, ModelServo, link_masses
from ikservo.model.servo_torque import GearFriction, find_servo_torque

# Time to send a goal, and until the servo's next loop reads it.
_DELAY_S = 0.0025
_FEETECH_GAIN = 32  # default P gain


@dataclass(frozen=True, slots=True)
class JointDrive:
    """All servos of a joint as one drive, in the joint's coordinate.

    Units are rad and N m, or m and N for a prismatic joint. Each value can be replaced by an
    identified value (`dataclasses.replace`).

    Attributes:
        stiffness_nm_rad: Torque per rad between goal and joint, at the present P gain.
        damping_nm_s: Torque of back-EMF and viscous friction per rad/s.
        armature_kg_m2: Inertia of rotors and gears.
        friction: Dry friction of the gears.
        startup_nm: Torque that the firmware adds in the direction of an error.
        delay_s: Mean time from a goal's packet until the servo's loop acts on it.
        sustained_nm: Torque that blocked motors may produce for a long time; infinite if unknown.
    """

    stiffness_nm_rad: float
    damping_nm_s: float
    armature_kg_m2: float
    friction: GearFriction
    startup_nm: float = 0.0
    delay_s: float = 0.0
    sustained_nm: float = inf

    def with_gain(self, share: float) -> JointDrive:
        """Compute the drive at a different P gain, given as a fraction of the present gain."""
        return replace(self, stiffness_nm_rad=self.stiffness_nm_rad * share)

    def friction_torque(self, speed_rad_s: float, load_nm: float) -> float:
        """Compute the dry friction of the moving joint, N m.

        The load is the torque on the gears: motor torque minus external torque.
        """
        gears = self.friction
        slow = exp(-abs(speed_rad_s) / gears.slow_rad_s)
        load = abs(load_nm)
        steady_nm = gears.coulomb_nm + (gears.load + gears.square_per_nm * load) * load
        return steady_nm + slow * (gears.slow_nm + gears.slow_load * load)


@dataclass(frozen=True, slots=True, eq=False)
class ArmParameters:
    """The dynamics of one arm: torques required by its motion and provided by its servos.

    Attributes:
        dynamics: The bodies that the chain's joints move, including a payload.
        drives: The drive of each joint of the chain (dof,); None if the motor of its servo is not
            known.
    """

    dynamics: Dynamics
    drives: tuple[JointDrive | None, ...]


def nominal_parameters(model: Model, chain: Chain) -> ArmParameters | None:
    """Return the parameters from the arm file's masses, if any, and the tables for its servos."""
    masses = link_masses(model, chain)
    if not masses:
        return None
    joints = {joint.name: joint for joint in model.joints}
    drives = [
        joint_drive(joints[name], model.supply_v) if name in joints else None
        for name in chain.names
    ]
    return ArmParameters(Dynamics.from_masses(chain, masses), tuple(drives))


def joint_drive(joint: ModelJoint, supply_v: float | None) -> JointDrive | None:
    """Compute the drive of a joint from its servos' tables; None if a servo is unknown."""
    servos = (joint.servo, *joint.shadows)
    torques = [find_servo_torque(servo.model, supply_v) for servo in servos]
    known = [torque for torque in torques if torque is not None]
    if len(known) < len(servos):
        return None
    per_horn_rad, first = joint.travel_per_turn / tau, known[0]  # all servos are of one kind
    force, gears = len(known) / per_horn_rad, first.friction
    return JointDrive(
        stiffness_nm_rad=sum(each.stiffness_nm_rad for each in known) / per_horn_rad**2,
        damping_nm_s=sum(each.damping_nm_s for each in known) / per_horn_rad**2,
        armature_kg_m2=sum(each.armature_kg_m2 for each in known) / per_horn_rad**2,
        friction=GearFriction(
            gears.coulomb_nm * force,
            gears.slow_nm * force,
            gears.slow_rad_s * per_horn_rad,
            gears.load,
            gears.slow_load,
            gears.square_per_nm / force,
        ),
        startup_nm=force * first.startup_duty * first.full_duty_nm,
        delay_s=_DELAY_S,
        sustained_nm=force * first.sustained_nm,
    )


def joint_compliances(model: Model, chain: Chain) -> Vector:
    """Compute the compliance of each joint (dof,) of a chain, rad per N m (m per N).

    The compliance of a joint is 0 if the stiffness of its servos is unknown. The chain goes from
    base to tip, and may end with the gripper's joint.
    """
    joints = {joint.name: joint for joint in model.joints}
    compliances = np.zeros(len(chain.names))
    for i, name in enumerate(chain.names):
        joint = joints.get(name)
        stiffness_nm_rad = 0.0
        for servo in (joint.servo, *joint.shadows) if joint else ():
            torque = find_servo_torque(servo.model, model.supply_v)
            if torque:
                stiffness_nm_rad += torque.stiffness_nm_rad * _gain_share(servo)
        if joint and stiffness_nm_rad:
            compliances[i] = (joint.travel_per_turn / tau) ** 2 / stiffness_nm_rad
    return compliances


def stall_error(joint: ModelJoint, supply_v: float | None) -> float:
    """Compute the distance from the goal at which friction holds an unloaded joint, rad or m.

    Servos that drive the joint together add equally to its friction and its stiffness.
    """
    torque = find_servo_torque(joint.servo.model, supply_v)
    per_horn_rad = joint.travel_per_turn / tau
    gain = _gain_share(joint.servo)
    return per_horn_rad * torque.friction_rad / gain if torque and gain else 0.0


def _gain_share(servo: ModelServo) -> float:
    """Compute a servo's P gain as a fraction of the default."""
    return servo.eeprom.get("p_gain", _FEETECH_GAIN) / _FEETECH_GAIN
