"""Dynamics of an identified arm: its masses and drives replace the values from the tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import tau

import numpy as np

from ikservo.calibration.identified_file import IdentifiedArm, IdentifiedJoint
from ikservo.kinematics import Chain
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model.arm_model import Model
from ikservo.model.joint_drive import ArmParameters, JointDrive, nominal_parameters
from ikservo.model.servo_torque import GearFriction, find_servo_torque


def identified_parameters(
    model: Model, chain: Chain, identified: IdentifiedArm
) -> ArmParameters | None:
    """Return an arm's identified parameters; None if the arm has no masses.

    Joints that were not identified have drives from the tables. The chain has the arm's limits.
    """
    nominal = nominal_parameters(model, chain)
    if nominal is None:
        return None
    scales = [
        1.0 if (joint := identified.joint(name)) is None else joint.mass_scale
        for name in body_joints(model, nominal.dynamics)
    ]
    drives = [
        _identified_drive(model, name, drive, identified.joint(name))
        for name, drive in zip(chain.names, nominal.drives, strict=True)
    ]
    return ArmParameters(with_mass_scales(nominal.dynamics, scales), tuple(drives))


def body_joints(model: Model, dynamics: Dynamics) -> list[str]:
    """Return the name of the joint that carries each body."""
    carried = {joint.child: joint.name for joint in model.urdf.joints}
    return [carried[body] for body in dynamics.bodies]


def with_mass_scales(dynamics: Dynamics, scales: Sequence[float]) -> Dynamics:
    """Return the dynamics with the mass of each body scaled by its factor (bodies,)."""
    per_body = len(dynamics.parameters) // len(dynamics.bodies)
    return dynamics.with_parameters(dynamics.parameters * np.repeat(scales, per_body))


def _identified_drive(
    model: Model, name: str, nominal: JointDrive | None, found: IdentifiedJoint | None
) -> JointDrive | None:
    """Compute a joint's drive at the P gain of the nominal drive."""
    if nominal is None or found is None:
        return nominal
    joint = model.joint(name)
    per_horn_rad, servos = joint.travel_per_turn / tau, 1 + len(joint.shadows)
    force = servos / per_horn_rad
    table = find_servo_torque(joint.servo.model, model.supply_v)
    gain = table.p_gain / found.p_gain if table and found.p_gain else 1.0
    damping = found.back_emf_nm_s + found.viscous_nm_s
    return replace(
        nominal,
        stiffness_nm_rad=found.stiffness_nm_rad * gain * force / per_horn_rad,
        damping_nm_s=damping * force / per_horn_rad,
        friction=GearFriction(
            found.coulomb_nm * force,
            found.slow_nm * force,
            found.slow_rad_s * per_horn_rad,
            found.load,
            found.slow_load,
            nominal.friction.square_per_nm,
        ),
        startup_nm=nominal.startup_nm * found.full_duty_nm / table.full_duty_nm
        if table
        else nominal.startup_nm,
    )
