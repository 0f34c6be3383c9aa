"""How far behind its goal a servo must be to lift the arm in its heaviest posture."""

from __future__ import annotations

from math import tau

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.joint_drive import JointDrive, nominal_parameters
from ikservo.model.model import Model

__all__ = ["lifting_lags", "spread_postures"]

_POSTURES = 64
# The heaviest posture may be between those that are tried, servos differ by a tenth, their supply
# sags under load, and a joint is to be set in motion in a fraction of a second.
_MARGIN = 1.35


def lifting_lags(model: Model, chain: Chain, payload_kg: float = 0.0) -> dict[str, float]:
    """Return for each joint of a chain the lag at which it lifts the arm in any posture.

    That is the torque which sets the joint in motion against gravity and the friction of its loaded
    gears, divided by the stiffness of its servos.

    Args:
        model: The masses and servos.
        chain: The joints, base to tip.
        payload_kg: The heaviest mass at the tip; each joint lifts the arm with and without it.

    Returns:
        Lags of the horn, rad, by joint; without joints whose servos are not known, and empty for an
        arm without masses.
    """
    parameters = nominal_parameters(model, chain)
    if parameters is None:
        return {}
    bodies = (parameters.dynamics, parameters.dynamics.with_payload(payload_kg))
    postures = spread_postures(chain)
    heaviest = np.max([np.abs(body.gravity_torques(postures)).max(axis=0) for body in bodies], 0)
    per_horn_rad = {joint.name: joint.travel_per_turn / tau for joint in model.joints}
    return {
        name: _MARGIN * _lifting_torque(drive, float(load)) / drive.stiffness_nm_rad
        / per_horn_rad[name]
        for name, drive, load in zip(chain.names, parameters.drives, heaviest, strict=True)
        if drive is not None
    }  # fmt: skip


def _lifting_torque(drive: JointDrive, load_nm: float) -> float:
    """Return the motor torque that sets a joint in motion against a load, N m.

    The gears carry motor torque and load together, and their friction grows with both.
    """
    return drive.friction.static_load_nm(2.0 * load_nm) - load_nm


def spread_postures(chain: Chain) -> Matrix:
    """Return postures (n, dof) spread evenly over the joints' ranges, the same in each call."""
    lower, upper = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    irrational: Vector = np.sqrt(np.arange(2.1, chain.dof + 2))
    fractions: Matrix = np.outer(np.arange(1.0, _POSTURES + 1), irrational) % 1.0
    return lower + fractions * (upper - lower)
