"""Limits of joints that hold a load: their goals lead them, and may not pass a limit either."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix
from ikservo.model.joint_drive import ArmParameters, JointDrive

__all__ = ["limits_under_load", "static_leads"]

# A goal that would be this far outside, rad or m, is as good as one at the limit.
_TOLERANCE = 0.003


def limits_under_load(chain: Chain, parameters: ArmParameters, joints: Matrix) -> Chain | None:
    """Return a chain whose limits leave room for the goals that hold the arm along a path.

    A limit moves inwards by the greatest lead that is needed where the goal would pass it.

    Args:
        chain: The arm, inside the limits of its goals.
        parameters: Its masses and drives.
        joints: Along the path (k, dof), rad or m.

    Returns:
        None where no goal would pass a limit.
    """
    leads = static_leads(parameters, joints)
    below = joints + leads < chain.lower_rad - _TOLERANCE
    above = joints + leads > chain.upper_rad + _TOLERANCE
    if not (below.any() or above.any()):
        return None
    lower = chain.lower_rad + np.where(below, -leads, 0.0).max(axis=0)
    upper = chain.upper_rad - np.where(above, leads, 0.0).max(axis=0)
    return chain.with_limits(lower, upper)


def static_leads(parameters: ArmParameters, joints: Matrix) -> Matrix:
    """Return by how much goals lead resting joints (k, dof) against gravity, rad or m."""
    torques = parameters.dynamics.gravity_torques(joints)
    leads = [_lead(torques[:, i], drive) for i, drive in enumerate(parameters.drives)]
    return np.column_stack(leads)


def _lead(torques_nm: Matrix, drive: JointDrive | None) -> Matrix:
    if drive is None:
        return np.zeros_like(torques_nm)
    pressed_nm = np.maximum(np.abs(torques_nm) - drive.startup_nm, 0.0)
    return np.sign(torques_nm) * pressed_nm / drive.stiffness_nm_rad
