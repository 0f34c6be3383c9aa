"""Print a motion plan: target, duration, active limits."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ikservo.arm import MotionPlan
from ikservo.arm.plan import NearLimit
from ikservo.calibration import JointUnit
from ikservo.cli.posture_reports import joint_lines
from ikservo.cli.terminal import print_json, print_lines
from ikservo.model import Model

__all__ = ["describe_orientation_error", "print_plan"]


def print_plan(
    plan: MotionPlan,
    model: Model,
    goal: Mapping[str, float],
    change_rad: float = 0.0,
    *,
    json: bool,
) -> None:
    """Print a plan.

    Args:
        plan: The motion.
        model: The arm.
        goal: Goal positions, rad or m by joint name.
        change_rad: Rotation of the tool.
        json: Whether to print one JSON object.
    """
    if json:
        print_json("plan", **_plan_fields(plan, goal))
        return
    print_lines(joint_lines({name: (at, _joint_unit(model, name)) for name, at in goal.items()}))
    print_lines(_plan_lines(plan, change_rad), indent=9)


def describe_orientation_error(angle_rad: float, *, requested: bool) -> str:
    """Return the error of a requested orientation as text, or the change if none was requested."""
    angle = f"{math.degrees(angle_rad):.1f}°"
    if requested:
        return f"orientation error {angle}"
    return f"orientation changed by {angle} (none was requested)"


def _joint_unit(model: Model, name: str) -> JointUnit:
    return model.joint(name).joint_map.unit


def _plan_fields(plan: MotionPlan, goal: Mapping[str, float]) -> dict[str, object]:
    return {
        "target_m": plan.target_m,
        "q_rad": goal,
        "joints_rad": goal,
        "duration_s": plan.duration_s,
        "path_m": plan.path_m,
        "speed": plan.speed,
        "binding": _limiting_lines(plan),
        "near_limits": [
            {"joint": near.joint, "side": near.side, f"room_{near.unit}": near.margin}
            for near in plan.near_limits
        ],
        "orientation_error_rad": plan.orientation_error_rad,
        "orientation_requested": plan.orientation_requested,
        "tool_speed": plan.tool_speed,
    }


def _plan_lines(plan: MotionPlan, change_rad: float) -> list[str]:
    angle_rad = plan.orientation_error_rad if plan.orientation_requested else change_rad
    tool = describe_orientation_error(angle_rad, requested=plan.orientation_requested)
    return [
        f"duration {plan.duration_s:.2f} s",
        f"path     {plan.path_m:.3f} m of the tip",
        f"speed    {plan.speed}",
        *([] if plan.tool_speed is None else [f"tip      {plan.tool_speed}"]),
        *(f"binds    {words}" for words in _limiting_lines(plan)),
        *(f"near     {_format_near_limit(near)}" for near in plan.near_limits),
        *([] if plan.target_m is None else [f"tool     {tool}"]),
    ]


def _limiting_lines(plan: MotionPlan) -> list[str]:
    """Return the joints that limit the duration, and the active limits of the solution."""
    held = [] if plan.solution is None else [str(limit) for limit in plan.solution.binding]
    return [*plan.time_limiting_joints, *held]


def _format_near_limit(near: NearLimit) -> str:
    room = f"{near.margin:.4f} m" if near.unit == "m" else f"{math.degrees(near.margin):.1f}°"
    return f"{near.joint} to {room} from its {near.side} limit"
