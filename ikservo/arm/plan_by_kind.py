"""Which function of the planner plans which motion of the tip or of joints."""

from __future__ import annotations

from typing import Any, cast

from ikservo.arm.drawing import plan_drawing
from ikservo.arm.motion_plan import MotionPlan
from ikservo.arm.motions import (
    Draw,
    LookAt,
    MoveArc,
    MoveJoints,
    MoveLine,
    MoveThrough,
    MoveTo,
    TipMotion,
)
from ikservo.arm.planner import Planner
from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Vector
from ikservo.motion import arc_about_axis, arc_through_points

__all__ = ["plan_motion"]


def plan_motion(
    planner: Planner, motion: TipMotion | MoveJoints | LookAt, start: Vector, speed: str
) -> MotionPlan:
    """Plan a motion from the joints ``start`` (n,) [rad or m], collisions not looked at.

    Args:
        planner: Of the arm.
        motion: The motion.
        start: All joints.
        speed: The speed class, which may be slower than the motion's own.

    Raises:
        UnreachableError: A point is out of reach.
        OrientationError: The tool cannot have the requested orientation there.
        AimError: The tip cannot point at the point.
        BadValueError: Its path cannot be made from there.
    """
    match motion:
        case MoveTo():
            return planner.plan_to_point(start, motion.position_m, speed, motion.stance)
        case MoveLine():
            points, tool_speed_m_s = [motion.position_m], motion.tool_speed_m_s
            return planner.plan_linear(
                start, points, speed, stance=motion.stance, tool_speed_m_s=tool_speed_m_s
            )
        case MoveThrough():
            passed = (start, list(motion.points_m), speed, motion.blend_m, motion.stance)
            if motion.line:
                return planner.plan_linear(*passed, motion.tool_speed_m_s)
            return planner.plan_waypoints(*passed)
        case MoveArc():
            return _plan_arc(planner, motion, start, speed)
        case Draw():
            return plan_drawing(planner, motion, start, speed)
        case LookAt():
            return planner.plan_to_look(start, motion.point_m, speed)
        case MoveJoints():
            return planner.plan_to_joints(start, motion.positions, speed)
        case _:
            raise BadValueError("The motion to plan", str(motion), "one that has a planner here")


def _plan_arc(planner: Planner, arc: MoveArc, start: Vector, speed: str) -> MotionPlan:
    tip_m = planner.path_start(start)
    if arc.center_m is not None:
        path = arc_about_axis(tip_m, arc.center_m, arc.normal, arc.angle_rad)
    else:
        via_m, end_m = cast("Any", arc.via_m), cast("Any", arc.end_m)
        path = arc_through_points(tip_m, via_m, end_m, full_circle=arc.full_circle)
    return planner.plan_path(start, path, speed, arc.stance, arc.tool_speed_m_s)
