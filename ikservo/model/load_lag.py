"""Lag of servos behind their goals while they lift or hold the arm in its heaviest posture."""

from __future__ import annotations

from dataclasses import dataclass
from math import tau

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.arm_model import Model
from ikservo.model.joint_drive import JointDrive, nominal_parameters
from ikservo.model.servo_torque import GearFriction, ServoTorque

_POSTURES = 64
# Margin: the heaviest posture may be between the sampled ones, servos differ by a tenth, their
# supply drops under load, and a joint must start to move within a fraction of a second.
_MARGIN = 1.35


@dataclass(frozen=True, slots=True)
class LoadLag:
    """Lag of a servo's horn behind its goal under the load of the arm.

    Attributes:
        lifting_rad: Lag while the servo lifts the arm, with a margin; at most its sustained lag.
        sag_rad: Lag while the servo holds the arm, from the weight alone, without friction.
    """

    lifting_rad: float = 0.0
    sag_rad: float = 0.0


def load_lags(model: Model, chain: Chain, payload_kg: float = 0.0) -> dict[str, LoadLag]:
    """Compute the servo lag of each joint of a chain in the arm's heaviest posture.

    A joint lifts when its motor torque sets it in motion against gravity and the friction of its
    loaded gears. The heaviest load counts, with or without the payload at the tip.

    Returns:
        Lags by joint, without joints whose servos are unknown; empty for an arm without masses.
    """
    parameters = nominal_parameters(model, chain)
    if parameters is None:
        return {}
    bodies = (parameters.dynamics, parameters.dynamics.with_payload(payload_kg))
    postures = spread_postures(chain)
    heaviest = np.max([np.abs(body.gravity_torques(postures)).max(axis=0) for body in bodies], 0)
    per_horn_rad = {joint.name: joint.travel_per_turn / tau for joint in model.joints}
    lags: dict[str, LoadLag] = {}
    for name, drive, load in zip(chain.names, parameters.drives, heaviest, strict=True):
        if drive is not None:
            load_nm = float(load)
            lifting = _MARGIN * lifting_torque_nm(drive.friction, load_nm) / drive.stiffness_nm_rad
            lifting = min(lifting, sustained_lag(drive))
            sag = load_nm / drive.stiffness_nm_rad
            lags[name] = LoadLag(lifting / per_horn_rad[name], sag / per_horn_rad[name])
    return lags


def sustained_lag(drive: JointDrive) -> float:
    """Compute the maximum lag of a joint, rad or m, that its servos can sustain."""
    return drive.sustained_nm / drive.stiffness_nm_rad


def can_lift(servo: ServoTorque, load_nm: float) -> bool:
    """Check whether a servo lifts a load with half of the torque that it can sustain."""
    return 2.0 * lifting_torque_nm(servo.friction, load_nm) <= servo.sustained_nm


def lifting_torque_nm(friction: GearFriction, load_nm: float) -> float:
    """Compute the motor torque that sets a joint in motion against a load.

    The gears carry motor torque and load together, and their friction grows with both.
    """
    return friction.static_load_nm(2.0 * load_nm) - load_nm


def spread_postures(chain: Chain) -> Matrix:
    """Compute postures (n, dof) spread evenly over the joints' ranges, the same in each call."""
    lower, upper = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    irrational: Vector = np.sqrt(np.arange(2.1, chain.dof + 2))
    fractions: Matrix = np.outer(np.arange(1.0, _POSTURES + 1), irrational) % 1.0
    return lower + fractions * (upper - lower)
