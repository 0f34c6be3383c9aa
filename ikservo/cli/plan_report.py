"""What is printed of a motion that has not begun: where it goes, how long, what sets its time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ikservo.arm import Plan
from ikservo.arm.planning import NearLimit
from ikservo.cli.output import print_json, print_lines

__all__ = ["print_plan", "turned"]


def print_plan(plan: Plan, names: Sequence[str], *, json: bool) -> None:
    """Print a plan to a point, with where the joints of those names would end."""
    assert plan.solution is not None  # noqa: S101  # what goes to a point was solved
    joints = dict(zip(names, plan.solution.q.tolist(), strict=True))
    if json:
        print_json("plan", **_fields(plan, joints))
        return
    print_lines([f"{name} {value:.4f} rad" for name, value in joints.items()])
    print_lines(_lines(plan))


def turned(left_rad: float) -> str:
    """Say how far the tool is from how it should stand."""
    return f"{math.degrees(left_rad):.1f}° from how it should stand"


def _fields(plan: Plan, joints: dict[str, float]) -> dict[str, object]:
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
        f"tool     {turned(plan.left_rad)}",
    ]


def _binding(plan: Plan) -> list[str]:
    """Return what sets the time, and the limits that hold the solution."""
    held = [] if plan.solution is None else [str(limit) for limit in plan.solution.binding]
    return [*plan.setters, *held]


def _say(near: NearLimit) -> str:
    room = f"{near.room:.4f} m" if near.unit == "m" else f"{math.degrees(near.room):.1f}°"
    return f"{near.joint} comes within {room} of its {near.side} limit"
