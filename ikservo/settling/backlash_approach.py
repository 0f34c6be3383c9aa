"""Goals from which joints with known backlash approach their final goals from below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import RefusedError
from ikservo.guard import DrivenJoint
from ikservo.kinematics.arrays import Vector
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan

# A joint this far below its goal has certainly crossed its backlash.
_MARGIN_TICKS = 3


def approach_goals(context: ArmContext, plan: MotionPlan) -> Vector | None:
    """Compute goals (n,) that are below the final goals, for joints with known backlash.

    The result is None for a line, which the tool must not leave, or if something is in the way.
    """
    goals, driven_joints = context.servos.goals(), context.servos.driven_joints
    backlash = np.array([context.model.joint(name).backlash for name in context.servos.names])
    low, high = context.servos.compensator.stuck_offsets(context.servos.reference())
    stuck = np.where(backlash > 0.0, backlash + high - low, 0.0)
    below = _goals_below(goals, plan.goal != plan.start, stuck, driven_joints)
    if below is None or plan.is_cartesian:
        return None
    try:
        reference = context.servos.reference()
        context.check_straight_path(reference, reference + below - goals)
    except RefusedError:
        return None
    return below


def _goals_below(
    goals: Vector, moved: NDArray[np.bool_], backlash: Vector, driven_joints: Sequence[DrivenJoint]
) -> Vector | None:
    """Compute goals (n,) from which each joint with known backlash approaches its goal from below.

    The flank of the backlash on which a joint comes to rest depends on its direction of approach
    and its braking, so positions with the same reading can be a backlash apart. Therefore, the
    joint first moves below its goal by its backlash, then up.

    Args:
        goals: The servos' goals at the end of a motion (n,), rad or m.
        moved: Whether each joint (n,) took part in the motion.
        backlash: The backlash of each joint (n,) and the friction that keeps it from its goal, in
            both directions together, rad or m; 0 if the backlash is unknown.
        driven_joints: The joints, in the same order.

    Returns:
        The goals, inside the limits; None if no joint with known backlash has moved.
    """
    chosen = moved & (backlash > 0.0)
    if not chosen.any():
        return None
    margin = np.array([_MARGIN_TICKS * driven.joint_map.unit_per_tick for driven in driven_joints])
    lowest = np.array([driven.position_range[0] for driven in driven_joints])
    below = np.maximum(goals - backlash - margin, np.minimum(lowest, goals))
    return np.where(chosen, below, goals)
