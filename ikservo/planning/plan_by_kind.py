"""Selects the planner's function for each kind of motion of the tip or of joints."""

from __future__ import annotations

from ikservo.kinematics.arrays import Vector
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import Draw, LookAt, MoveJoints, MoveThrough, MoveTo, TipMotion
from ikservo.planning.planner import Planner


def plan_motion(
    planner: Planner, motion: TipMotion | MoveJoints | LookAt, start: Vector, speed: str
) -> MotionPlan:
    """Plan a motion from the joints ``start`` (n,) [rad or m]; collisions are not checked.

    Args:
        planner: The planner of the arm.
        motion: The motion.
        start: All joints.
        speed: The speed class, which may be slower than the motion's own.

    Raises:
        UnreachableError: A point is out of reach.
        OrientationError: The tool cannot have the requested orientation there.
        AimError: The tip cannot point at the point.
        BadValueError: Its path cannot be made from this start.
    """
    match motion:
        case MoveTo():
            return planner.plan_to_point(start, motion.position_m, speed, motion.stance)
        case MoveThrough(line=False):
            points_m, blend_m = list(motion.points_m), motion.blend_m
            return planner.plan_waypoints(start, points_m, speed, blend_m, motion.stance)
        case Draw():
            from ikservo.planning.strokes import plan_drawing  # noqa: PLC0415  # of few programs

            return plan_drawing(planner, motion, start, speed)
        case LookAt():
            return planner.plan_to_look(start, motion.point_m, speed)
        case MoveJoints():
            return planner.plan_to_joints(start, motion.positions, speed)
        case _:
            path = motion.path_from(planner.path_start(start))
            return planner.plan_path(start, path, speed, motion.stance, motion.tool_speed_m_s)
