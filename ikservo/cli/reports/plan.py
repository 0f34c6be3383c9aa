"""What is printed of a motion that has not begun: where it goes, how long, what sets its time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from ikservo.arm import Plan
from ikservo.arm.planning import NearLimit
from ikservo.cli.output import print_json, print_lines

__all__ = ["print_plan", "turned"]


def print_plan(
    plan: Plan, joints: Mapping[str, float], say: Callable[[str, float], str], *, json: bool
) -> None:
    """Print a plan, and where joints would end; ``say`` says it of one by its name."""
    if json:
        print_json("plan", **_fields(plan, joints))
        return
    print_lines([f"{name} {say(name, value)}" for name, value in joints.items()])
    print_lines(_lines(plan))


def turned(left_rad: float) -> str:
    """Say how far the tool is from how it should stand."""
    return f"{math.degrees(left_rad):.1f}° from how it should stand"


def _fields(plan: Plan, joints: Mapping[str, float]) -> dict[str, object]:
    return {
        "target_m": plan.target_m,
        "q_rad": joints,
        "duration_s": plan.duration_s,
        "path_m": plan.path_m,
        "speed": plan.speed,
        "binding": _binding(plan),
        "near_limits": [
            {"joint": near.joint, "side": near.side, f"room_{near.unit}": near.room}
            for near in plan.near
        ],
        "orientation_error_rad": plan.left_rad,
    }


def _lines(plan: Plan) -> list[str]:
    return [
        f"duration {plan.duration_s:.2f} s",
        f"path     {plan.path_m:.3f} m of the tip",
        f"speed    {plan.speed}",
        *(f"binds    {words}" for words in _binding(plan)),
        *(f"near     {_say(near)}" for near in plan.near),
        *([] if plan.target_m is None else [f"tool     {turned(plan.left_rad)}"]),
    ]


def _binding(plan: Plan) -> list[str]:
    """Return what sets the time, and the limits that hold the solution."""
    held = [] if plan.solution is None else [str(limit) for limit in plan.solution.binding]
    return [*plan.setters, *held]


def _say(near: NearLimit) -> str:
    room = f"{near.room:.4f} m" if near.unit == "m" else f"{math.degrees(near.room):.1f}°"
    return f"{near.joint} comes within {room} of its {near.side} limit"
