"""Limits of joints under load: goals lead their joints and must not pass a limit."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix
from ikservo.model.joint_drive import ArmParameters

# A goal that would be at most this far outside, rad or m, counts as a goal at the limit.
_TOLERANCE = 0.003
# Friction of a servo as a multiple of its model's, because servos of one model differ.
_STRONGEST_FRICTION = 1.5
# A joint that travels less along a path, rad or m, is at rest; less is rounding of the solver.
_REST_TRAVEL = 0.001


def limits_under_load(
    chain: Chain, parameters: ArmParameters, joints: Matrix, *, friction: bool = True
) -> Chain | None:
    """Return a chain with limits that leave room for the lead of goals along a path.

    Each limit is moved inwards by the largest lead among the goals that would pass it. Without
    ``friction``, there is room for weight only. Joints (k, dof) are in rad or m.

    Returns:
        The chain; None if no goal would pass a limit.
    """
    directions = np.zeros_like(joints)
    if friction and len(joints) > 1:
        moved = np.ptp(joints, axis=0) > _REST_TRAVEL
        along = np.sign(np.gradient(joints, axis=0))
        directions = np.where(moved, _STRONGEST_FRICTION * along, 0.0)
    leads = goal_leads(parameters, joints, directions)
    below = joints + leads < chain.lower_rad - _TOLERANCE
    above = joints + leads > chain.upper_rad + _TOLERANCE
    if not (below.any() or above.any()):
        return None
    lower = chain.lower_rad + np.where(below, -leads, 0.0).max(axis=0)
    upper = chain.upper_rad - np.where(above, leads, 0.0).max(axis=0)
    return chain.with_limits(lower, upper)


def goal_leads(parameters: ArmParameters, joints: Matrix, directions: Matrix) -> Matrix:
    """Compute the lead of goals over slow joints against gravity and friction, rad or m.

    Positions and directions are (k, dof); a direction is a multiple of the friction in the model:
    1, -1, or 0 for none.
    """
    torques = parameters.dynamics.gravity_torques(joints)
    leads = np.zeros_like(torques)
    for i, drive in enumerate(parameters.drives):
        if drive is None:
            continue
        friction_nm = np.array([drive.friction_torque(0.0, load_nm) for load_nm in torques[:, i]])
        needed_nm = torques[:, i] + directions[:, i] * friction_nm
        pressed_nm = np.maximum(np.abs(needed_nm) - drive.startup_nm, 0.0)
        leads[:, i] = np.sign(needed_nm) * pressed_nm / drive.stiffness_nm_rad
    return leads
