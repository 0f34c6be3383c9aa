"""Plans drawings: strokes of the tip at a constant speed, and the way above them in between."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ikservo.arm.plan import MotionPlan
from ikservo.arm.planner import Planner
from ikservo.arm.tool_orientation import ToolOrientation
from ikservo.arm.tool_speed import ToolSpeed
from ikservo.errors import BadValueError, UnreachableError
from ikservo.kinematics.arrays import Matrix, Vector, finite_vectors
from ikservo.motion import BlendedPath, ConcatenatedTrajectory, ToolPath, straight_lines

__all__ = ["DrawingPlanner", "drawing_strokes"]

# By how much a corner of a stroke may be rounded.
_CORNER_M = 2e-4
# A blend passes its corner at this fraction of its length, for each unit that the slope changes.
_PASSED = 0.1875
_SAME_POINT_M = 1e-6


def drawing_strokes(strokes_m: Sequence[object]) -> list[Matrix]:
    """Return the strokes of a drawing, each (k, 3) [m], k at least 1.

    Raises:
        BadValueError: There is none, or one has no points, another shape or no finite numbers.
    """
    strokes = [finite_vectors(stroke, 3, "A stroke of the drawing") for stroke in strokes_m]  # pyright: ignore[reportArgumentType]
    strokes = [stroke.reshape(-1, 3) for stroke in strokes]
    if not strokes or not all(len(stroke) for stroke in strokes):
        raise BadValueError("The drawing", "empty", "at least one stroke with a point")
    return strokes


@dataclass(frozen=True, slots=True, eq=False)
class DrawingPlanner:
    """Plans the strokes of one drawing.

    The joints move to above the first point; the tip goes down, along each stroke, up, and above
    the next one, and ends above the last point.

    Args:
        planner: Plans the motions of the arm.
        strokes_m: The points (k, 3) of each stroke, metres, base frame.
        lift_m: How far above a stroke the tip goes between two; 0 for not at all.
        stance: The orientation of the tool.
        tool_speed_m_s: The speed of the tip along a stroke; None for the fastest.

    Raises:
        BadValueError: The lift is negative.
    """

    planner: Planner
    strokes_m: Sequence[Matrix]
    lift_m: float
    stance: ToolOrientation
    tool_speed_m_s: float | None

    def __post_init__(self) -> None:
        if not 0.0 <= self.lift_m < math.inf:
            raise BadValueError("The lift of the tool", f"{self.lift_m:g} m", "0 m or more")

    def plan(self, start: Vector, speed: str) -> MotionPlan:
        """Plan the whole drawing from the joints ``start`` (n,).

        Raises:
            UnreachableError: A point is out of reach; names the first one and its stroke.
            OrientationError: The tool cannot have the requested orientation there.
        """
        up = np.array([0.0, 0.0, self.lift_m])
        with _at("stroke 1"):
            plans = [self._plan_first(start, up, speed)]
        self._check_reach(plans[0].goal)
        for number, path_from, tool_speed_m_s in self._paths(up):
            with _at(f"stroke {number + 1}"):
                plans.append(
                    self.planner.plan_path(
                        plans[-1].goal, path_from, speed, self.stance, tool_speed_m_s
                    )
                )
        return _join(plans)

    def _plan_first(self, start: Vector, up: Vector, speed: str) -> MotionPlan:
        stance = replace(self.stance, keep=False)  # the orientation above the paper is kept
        return self.planner.plan_to_point(start, self.strokes_m[0][0] + up, speed, stance)

    def _paths(
        self, up: Vector
    ) -> Iterator[tuple[int, Callable[[Vector], ToolPath], float | None]]:
        """Yield the stroke's number, the path from where the tip is, and its tool speed."""
        ends = [stroke[-1] for stroke in self.strokes_m]
        blend_m = max(0.4 * self.lift_m, 1e-3)
        for number, stroke in enumerate(self.strokes_m):
            way = [stroke[0]]
            if number:
                way = [ends[number - 1] + up, stroke[0] + up, stroke[0]]
            yield number, lambda tip_m, way=way: straight_lines(tip_m, way, blend_m), None
            if len(stroke) > 1:
                yield number, lambda _, stroke=stroke: _stroke_path(stroke), self.tool_speed_m_s
        last = [ends[-1] + up]
        yield len(ends) - 1, lambda tip_m: straight_lines(tip_m, last, blend_m), None

    def _check_reach(self, at: Vector) -> None:
        """Raise for the first point of all strokes that is out of reach, before paths are made."""
        for number, stroke in enumerate(self.strokes_m):
            for k, point_m in enumerate(stroke):
                with _at(f"point {k + 1} of stroke {number + 1}"):
                    at = self.planner.reach(at, point_m)


@contextmanager
def _at(place: str) -> Generator[None]:
    """Say in an error at which place of the drawing it is."""
    try:
        yield
    except UnreachableError as error:
        error.command_message = f"The drawing, {place}: {error.command_message}"
        error.command_hint = "Nothing moved. Move the drawing or make it smaller."
        raise


def _stroke_path(stroke: Matrix) -> BlendedPath:
    """Return lines through the points (k, 3), each corner rounded by 0.2 mm at most."""
    steps = np.diff(stroke, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    kept = np.concatenate([[True], lengths > _SAME_POINT_M])
    stroke, slopes = stroke[kept], steps[kept[1:]] / lengths[kept[1:], None]
    turns = [float(np.linalg.norm(b - a)) for a, b in pairwise(slopes)]
    return BlendedPath(stroke, [_CORNER_M / max(_PASSED * turn, 1e-6) for turn in turns])


def _join(plans: Sequence[MotionPlan]) -> MotionPlan:
    """Return one plan of several, each of which starts where the one before ends."""
    trajectory = plans[0].trajectory
    for plan in plans[1:]:
        trajectory = ConcatenatedTrajectory(trajectory, plan.trajectory)
    near = {(each.joint, each.side): each for plan in plans for each in plan.near_limits}
    speeds = [plan.tool_speed for plan in plans if plan.tool_speed is not None]
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
        tool_speed=_slowest(speeds) if speeds else None,
        orientation_error_rad=max(plan.orientation_error_rad for plan in plans),
    )


def _slowest(speeds: Sequence[ToolSpeed]) -> ToolSpeed:
    """Return the speeds of all strokes as one, with how many of them are slower than requested."""
    slower = [speed for speed in speeds if not speed.is_constant]
    why = dict.fromkeys(text for speed in slower for text in speed.limited_by)
    count = f"{len(slower)} of {len(speeds)} strokes are slower"
    return ToolSpeed(
        speeds[0].requested_m_s,
        max(speed.top_m_s for speed in speeds),
        min(speed.slowest_m_s for speed in speeds),
        (count, *why) if slower else (),
    )
