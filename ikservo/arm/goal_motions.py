"""Motions to a goal: methods of ``Arm`` that move the tip along a path, or joints to positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, Unpack, overload

from numpy.typing import ArrayLike

from ikservo.arm import execution
from ikservo.arm.arguments import parse_all_positions, parse_points
from ikservo.arm.arm_parts import ArmParts
from ikservo.arm.background_motion import Motion
from ikservo.arm.motion_options import (
    ArcOptions,
    DrawOptions,
    JointOptions,
    LineOptions,
    MotionSettings,
    PointOptions,
    ThroughOptions,
    parse_options,
)
from ikservo.arm.plan import MotionPlan, PoseWithinLimits
from ikservo.arm.reports import JointMoveResult, MoveResult

__all__ = [
    "Points",
    "Positions",
    "draw",
    "move_arc",
    "move_joints",
    "move_line",
    "move_through",
    "move_to",
    "pose",
]

Positions = Mapping[str, float] | ArrayLike
"""Positions by joint, or of all joints (n,), rad or m."""

Points = Sequence[ArrayLike]
"""Points (k, 3) [m], base frame."""


@overload
def move_to(
    arm: ArmParts,
    position_m: ArrayLike,
    *,
    wait: Literal[True] = True,
    **options: Unpack[PointOptions],
) -> MoveResult: ...


@overload
def move_to(
    arm: ArmParts, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[PointOptions]
) -> Motion[MoveResult]: ...


def move_to(
    arm: ArmParts, position_m: ArrayLike, *, wait: bool = True, **options: Unpack[PointOptions]
) -> MoveResult | Motion[MoveResult]:
    """Move the tip to a point (3,) [m].

    Options: speed, stance, orientation, on_progress; see ``PointOptions``.

    Raises:
        UnreachableError: No joint positions within the limits reach it; nothing has moved.
        OrientationError: The tool cannot have the orientation there; nothing has moved.
        IkservoError: Those of every motion; see ``Arm``.
    """
    tip = parse_options("move_to", PointOptions, options)
    return _move_tip(arm, lambda: arm.preflight.plan_to(position_m, tip), tip, wait=wait)


@overload
def move_line(
    arm: ArmParts,
    position_m: ArrayLike,
    *,
    wait: Literal[True] = True,
    **options: Unpack[LineOptions],
) -> MoveResult: ...


@overload
def move_line(
    arm: ArmParts, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[LineOptions]
) -> Motion[MoveResult]: ...


def move_line(
    arm: ArmParts, position_m: ArrayLike, *, wait: bool = True, **options: Unpack[LineOptions]
) -> MoveResult | Motion[MoveResult]:
    """Move the tip to a point (3,) [m] on a straight line; the tool turns evenly along it.

    Options: speed, tool_speed_m_s, stance, orientation, on_progress; see ``LineOptions``.

    Raises:
        UnreachableError: A point on the line is out of reach; nothing has moved. Others as for
            ``move_to``.
    """
    tip = parse_options("move_line", LineOptions, options)
    return _move_tip(arm, lambda: arm.preflight.plan_line(position_m, tip), tip, wait=wait)


@overload
def move_arc(
    arm: ArmParts,
    via_m: ArrayLike | None = None,
    end_m: ArrayLike | None = None,
    *,
    wait: Literal[True] = True,
    **options: Unpack[ArcOptions],
) -> MoveResult: ...


@overload
def move_arc(
    arm: ArmParts,
    via_m: ArrayLike | None = None,
    end_m: ArrayLike | None = None,
    *,
    wait: Literal[False],
    **options: Unpack[ArcOptions],
) -> Motion[MoveResult]: ...


def move_arc(
    arm: ArmParts,
    via_m: ArrayLike | None = None,
    end_m: ArrayLike | None = None,
    *,
    wait: bool = True,
    **options: Unpack[ArcOptions],
) -> MoveResult | Motion[MoveResult]:
    """Move the tip on an arc through a point (3,) [m] to an end (3,), or on a circle.

    Options: full_circle, center_m, normal, angle_rad, speed, tool_speed_m_s, stance,
    orientation, on_progress; see ``ArcOptions``. The arc begins where the tip is.

    Raises:
        BadValueError: The points are on one line, or the radius is zero; nothing has moved.
        UnreachableError: A point of the arc is out of reach; nothing has moved. Others as for
            ``move_to``.
    """
    tip = parse_options("move_arc", ArcOptions, options)
    return _move_tip(arm, lambda: arm.preflight.plan_arc(via_m, end_m, tip), tip, wait=wait)


@overload
def draw(
    arm: ArmParts,
    strokes_m: Sequence[ArrayLike],
    *,
    wait: Literal[True] = True,
    **options: Unpack[DrawOptions],
) -> MoveResult: ...


@overload
def draw(
    arm: ArmParts,
    strokes_m: Sequence[ArrayLike],
    *,
    wait: Literal[False],
    **options: Unpack[DrawOptions],
) -> Motion[MoveResult]: ...


def draw(
    arm: ArmParts,
    strokes_m: Sequence[ArrayLike],
    *,
    wait: bool = True,
    **options: Unpack[DrawOptions],
) -> MoveResult | Motion[MoveResult]:
    """Move the tip along strokes, points (k, 3) [m] each, lifted between them.

    Options: lift_m, speed, tool_speed_m_s, stance, orientation, on_progress; see
    ``DrawOptions``. ``ikservo.read_drawing`` reads strokes from SVG and CSV files.

    Raises:
        UnreachableError: A point is out of reach; names the first one. Nothing has moved.
            Others as for ``move_to``.
    """
    tip = parse_options("draw", DrawOptions, options)
    strokes = parse_points(strokes_m)
    return _move_tip(arm, lambda: arm.preflight.plan_drawing(strokes, tip), tip, wait=wait)


@overload
def move_through(
    arm: ArmParts,
    points_m: Points,
    *,
    wait: Literal[True] = True,
    **options: Unpack[ThroughOptions],
) -> MoveResult: ...


@overload
def move_through(
    arm: ArmParts, points_m: Points, *, wait: Literal[False], **options: Unpack[ThroughOptions]
) -> Motion[MoveResult]: ...


def move_through(
    arm: ArmParts, points_m: Points, *, wait: bool = True, **options: Unpack[ThroughOptions]
) -> MoveResult | Motion[MoveResult]:
    """Move the tip through points (k, 3) [m] without a stop, to rest at the last.

    Options: blend_m, line, speed, tool_speed_m_s, stance, orientation, on_progress; see
    ``ThroughOptions``.

    Raises:
        UnreachableError: A point, or a line to it, is out of reach; nothing has moved. Others
            as for ``move_to``.
    """
    tip = parse_options("move_through", ThroughOptions, options)
    points = parse_points(points_m)
    return _move_tip(arm, lambda: arm.preflight.plan_through(points, tip), tip, wait=wait)


@overload
def move_joints(
    arm: ArmParts,
    positions: Positions,
    *,
    wait: Literal[True] = True,
    **options: Unpack[JointOptions],
) -> JointMoveResult: ...


@overload
def move_joints(
    arm: ArmParts, positions: Positions, *, wait: Literal[False], **options: Unpack[JointOptions]
) -> Motion[JointMoveResult]: ...


def move_joints(
    arm: ArmParts, positions: Positions, *, wait: bool = True, **options: Unpack[JointOptions]
) -> JointMoveResult | Motion[JointMoveResult]:
    """Move some joints, given by name [rad or m]; the others stay. Or all of them (n,).

    Options: speed, on_progress; see ``JointOptions``.

    Raises:
        UnknownNameError: No such joint.
        RefusedError: A position is outside the limits; nothing has moved. Others as for
            ``move_to``.
    """
    chosen = parse_options("move_joints", JointOptions, options)
    goal = parse_all_positions(positions, arm.context.servos.names)
    return arm.background.run(lambda: _move_joints(arm, goal, chosen), wait=wait)


@overload
def pose(
    arm: ArmParts, name: str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
) -> JointMoveResult: ...


@overload
def pose(
    arm: ArmParts, name: str, *, wait: Literal[False], **options: Unpack[JointOptions]
) -> Motion[JointMoveResult]: ...


def pose(
    arm: ArmParts, name: str, *, wait: bool = True, **options: Unpack[JointOptions]
) -> JointMoveResult | Motion[JointMoveResult]:
    """Move to a pose of the arm file, or to a taught one, clamped to the limits.

    Options: speed, on_progress; see ``JointOptions``.

    Returns:
        The result; ``binding`` names the joints that were clamped.

    Raises:
        UnknownNameError: No such pose; suggests the closest.
        RefusedError: It is outside this arm's limits, or something is in the way.
    """
    chosen = parse_options("pose", JointOptions, options)
    arm.context.model.speed(chosen.speed)
    inside = arm.preflight.pose_within_limits(name)
    return arm.background.run(lambda: _move_pose(arm, inside, chosen), wait=wait)


def _move_tip(
    arm: ArmParts, planning: Callable[[], MotionPlan], chosen: MotionSettings, *, wait: bool
) -> MoveResult | Motion[MoveResult]:
    def run() -> MoveResult:
        plan = arm.preflight.plan_from_held(planning)
        return execution.move_tip(arm.context, arm.runner, plan, chosen.on_progress)

    return arm.background.run(run, wait=wait)


def _move_joints(
    arm: ArmParts, goal: Mapping[str, float], chosen: MotionSettings
) -> JointMoveResult:
    plan = arm.preflight.plan_from_held(lambda: arm.preflight.plan_joints(goal, chosen.speed))
    return execution.move_joints(arm.context, arm.runner, goal, plan, chosen.on_progress)


def _move_pose(arm: ArmParts, inside: PoseWithinLimits, chosen: MotionSettings) -> JointMoveResult:
    report = _move_joints(arm, inside.positions, chosen)
    return replace(report, binding=inside.changed + report.binding)
