"""Plan drawings: strokes of the tip at a constant speed, and the lifted paths between strokes."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import UnreachableError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import BlendedPath, ConcatenatedTrajectory
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import Draw
from ikservo.planning.planner import Planner
from ikservo.planning.tool_speed import ToolSpeed

# Largest rounding of a corner of a stroke.
_CORNER_M = 2e-4
# Distance of a blend from its corner per unit of change of slope, as a fraction of its length.
_PASSED = 0.1875
_SAME_POINT_M = 1e-6  # a point nearer to the previous point of its stroke is left out


def plan_drawing(planner: Planner, drawing: Draw, start: Vector, speed: str) -> MotionPlan:
    """Plan a whole drawing from the joints ``start`` (n,).

    A joint motion brings the tip above the first point; the tip then moves down, along the stroke,
    up, to a point above the next stroke, and so on; it ends above the last point.

    Raises:
        UnreachableError: A point is out of reach; the error names the first one and its stroke.
        OrientationError: The tool cannot have the requested orientation there.
    """
    strokes: list[Matrix] = []
    for points in drawing.strokes_m:
        stroke = np.array(points)
        lengths = np.linalg.norm(np.diff(stroke, axis=0), axis=1)
        strokes.append(stroke[np.concatenate([[True], lengths > _SAME_POINT_M])])
    stance, up = drawing.stance, np.array([0.0, 0.0, drawing.lift_m])
    above = replace(stance, keep=False)  # the orientation above the paper is kept
    with _at("stroke 1"):
        plans = [planner.plan_to_point(start, strokes[0][0] + up, speed, above)]
    at = plans[0].goal
    for number, points in enumerate(drawing.strokes_m):  # check all points before making paths
        for k, point_m in enumerate(cast("Sequence[ArrayLike]", points)):
            with _at(f"point {k + 1} of stroke {number + 1}"):
                at = planner.reach(at, point_m)
    blend_m = max(0.4 * drawing.lift_m, 1e-3)
    for number, stroke in enumerate(strokes):
        way = [stroke[0]]
        if number:
            way = [strokes[number - 1][-1] + up, stroke[0] + up, stroke[0]]
        with _at(f"stroke {number + 1}"):
            plans.append(planner.plan_linear(plans[-1].goal, way, speed, blend_m, stance))
            if len(stroke) > 1:
                path, at = _stroke_path(stroke), plans[-1].goal
                plans.append(planner.plan_path(at, path, speed, stance, drawing.tool_speed_m_s))
    with _at(f"stroke {len(strokes)}"):
        last = [strokes[-1][-1] + up]
        plans.append(planner.plan_linear(plans[-1].goal, last, speed, blend_m, stance))
    return _join(plans)


@contextmanager
def _at(place: str) -> Generator[None]:
    """Add to the message of an error the place in the drawing where the error occurred."""
    try:
        yield
    except UnreachableError as error:
        error.command_message = f"The drawing, {place}: {error.command_message}"
        error.command_hint = "Nothing moved. Move the drawing or make it smaller."
        raise


def _stroke_path(stroke: Matrix) -> BlendedPath:
    """Compute lines through the points (k, 3), with each corner rounded by at most 0.2 mm."""
    steps = np.diff(stroke, axis=0)
    slopes = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    turns = [float(np.linalg.norm(b - a)) for a, b in pairwise(slopes)]
    return BlendedPath(stroke, [_CORNER_M / max(_PASSED * turn, 1e-6) for turn in turns])


def _join(plans: Sequence[MotionPlan]) -> MotionPlan:
    """Join plans into one plan; each starts where the previous plan ends."""
    trajectory = plans[0].trajectory
    for plan in plans[1:]:
        trajectory = ConcatenatedTrajectory(trajectory, plan.trajectory)
    near = {(each.joint, each.side): each for plan in plans for each in plan.near_limits}
    speeds = [plan.tool_speed for plan in plans if plan.tool_speed is not None]
    tool_speed: ToolSpeed | None = None
    if speeds:
        slower = [speed for speed in speeds if not speed.is_constant]
        why = dict.fromkeys(text for speed in slower for text in speed.limited_by)
        count = f"{len(slower)} of {len(speeds)} strokes are slower"
        tool_speed = ToolSpeed(
            speeds[0].requested_m_s,
            max(speed.top_m_s for speed in speeds),
            min(speed.slowest_m_s for speed in speeds),
            (count, *why) if slower else (),
        )
    joints = [text for plan in plans for text in plan.time_limiting_joints]
    return replace(
        plans[-1],
        start=plans[0].start,
        trajectory=trajectory,
        path_m=sum(plan.path_m for plan in plans),
        duration_s=sum(plan.duration_s for plan in plans),
        cartesian_s=sum(plan.cartesian_s for plan in plans),
        time_limiting_joints=tuple(dict.fromkeys(joints)),
        near_limits=tuple(near.values()),
        tool_speed=tool_speed,
        orientation_error_rad=max(plan.orientation_error_rad for plan in plans),
    )
