"""A plan is carried out from where the arm is now, if that is still where it was planned from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.arm.planning.plan import Plan
from ikservo.errors import RefusedError
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course, JointMove, Pace, Sequel

__all__ = ["begun", "has_moved"]

# What a joint goes through in this time at its full pace: a tick or two, which the guard passes
# as one step; and what an arm may have sagged by between planning and moving.
_STEP_S, _SAGGED_S = 0.005, 0.2


def begun(plan: Plan, goals: Vector, paces: Sequence[Pace], names: Sequence[str]) -> Course:
    """Return the plan's course, begun at the goals (n,) that the servos hold.

    They are where it was planned from but for a tick, or a little inside where a limp joint stood
    outside its limits. A motion of joints then begins there; a line is led in to.

    Raises:
        RefusedError: The arm has been moved since it was planned, or it is a plan of another.
    """
    if plan.names != tuple(names):
        raise RefusedError(
            f"The plan moves {', '.join(plan.names)}, this arm has {', '.join(names)}.",
            "Nothing was sent. Plan it with this arm.",
        )
    apart_s = _apart_s(plan, goals, paces)
    if apart_s.max() > _SAGGED_S:
        raise RefusedError(
            f"{names[int(apart_s.argmax())]} is not at the start of the plan.",
            "Nothing was sent. Plan again from the present position.",
        )
    if not has_moved(plan, goals, paces):
        return plan.course
    if isinstance(plan.course, JointMove):
        return JointMove(goals, plan.goal, paces)
    return Sequel(JointMove(goals, plan.start, paces), plan.course)


def has_moved(plan: Plan, goals: Vector, paces: Sequence[Pace]) -> bool:
    """Return whether the goals (n,) are further than a tick or two from where a plan begins."""
    return bool(_apart_s(plan, goals, paces).max() > _STEP_S)


def _apart_s(plan: Plan, goals: Vector, paces: Sequence[Pace]) -> Vector:
    return np.abs(goals - plan.start) / np.array([pace.speed_rad_s for pace in paces])
