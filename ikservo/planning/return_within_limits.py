"""Plan the slow motion of joints that are a little outside their limits back inside."""

from __future__ import annotations

import math

import numpy as np

from ikservo.errors import CollisionError, RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.motion import JointMove, Trajectory
from ikservo.planning.context import ArmContext

# At the horn: a limp arm sinks so far past a limit, as end stops are 2° outside calibrated limits.
_MAX_RETURN_RAD = math.radians(5.0)
_HINT = "Nothing was sent. Move it back by hand, or request that motion: ikservo pose home."


def plan_return(context: ArmContext, start: Vector) -> Trajectory:
    """Plan and check a joint motion from measured joints (n,), rad or m, back inside the limits.

    Raises:
        RefusedError: A joint is more than 5° outside at its horn, or the arm would touch something
            on its path back.
    """
    goal = np.clip(start, *context.limits())
    trajectory = JointMove(start, goal, context.planner.motion_limits("slow"))
    turned_rad = np.abs(goal - start) / context.units_per_rad()
    outside = f"{context.servos.names[int(turned_rad.argmax())]} is outside its limits"
    if turned_rad.max() > _MAX_RETURN_RAD:
        far = f"{outside} by {math.degrees(turned_rad.max()):.0f}° at its servo"
        most = f"without a request, it moves back by at most {math.degrees(_MAX_RETURN_RAD):.0f}°"
        raise RefusedError(f"{far}; {most}.", _HINT)
    try:
        if turned_rad.max() > 0.0:
            context.check_streamed_path(trajectory, "slow")
    except CollisionError as error:
        raise RefusedError(f"{outside}, and on its path back {error.cause}.", _HINT) from None
    return trajectory
