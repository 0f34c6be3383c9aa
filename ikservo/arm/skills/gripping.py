"""The gripper: it opens, closes, goes to a width, and notices what stands between its jaws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ikservo.arm.given import number
from ikservo.arm.reports import Progress
from ikservo.arm.skills.jaws import Jaws
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.errors import BadValueError, IkservoError, UnknownNameError
from ikservo.kinematics.se3 import Vector
from ikservo.model.gripper import Gripper
from ikservo.motion import Pursuit

__all__ = ["GripReport", "Opening", "grip"]

Opening = Literal["open", "close"]

_FORCE = 0.3  # of a servo's torque: holds a full cup, and can be held for an hour
_LEAST_FORCE = 0.05  # friction takes 2 to 5 % of the torque of the servos we know
# Jaws that come to stand in this share of their way from open were too weak to close.
_WIDE = 0.05


@dataclass(frozen=True, slots=True)
class GripReport:
    """How a motion of the gripper ended.

    Attributes:
        grasped: Whether the jaws stand short of where they were closing to, and have not yielded
            to their force for half a second. Mostly something is between them. Jaws that stick, by
            more than their force, look the same to the servo: try more force where that may be.
        reached: Whether they are where they were told to go.
        position_rad: Where the gripper's joint is, rad or m.
        width_m: How far the jaws are apart; None where the arm file does not know.
        load_percent: What the servo reports: share of its torque or current.
        force: The share of its torque that it may use.
        duration_s: How long it took.
    """

    grasped: bool
    reached: bool
    position_rad: float
    width_m: float | None
    load_percent: float | None
    force: float
    duration_s: float


def grip(
    arm: Workings,
    to: Opening | float,
    force: float | None,
    on_progress: Callable[[Progress], None] | None,
) -> GripReport:
    """Move the gripper; see ``Arm.gripper``."""
    gripper = _gripper(arm)
    column = arm.planner.column(gripper.joint)
    goal, share = _goal(arm, gripper, column, to), _share(force)
    _check_way(arm, column, goal)
    jaws = Jaws(arm, column, goal)
    started_s = arm.now_s()
    arm.walk_back()

    def begin(here: Vector) -> Pursuit:
        arm.servos.limit_force(gripper.joint, share)  # torque is on by now, and it was set anew
        return jaws.begin(here)

    def on_beat(beat: Beat) -> None:
        jaws.beat(beat)
        if on_progress:
            on_progress(arm.progress(beat))

    arm.drive(begin, on_beat, jaws.speed)
    state = arm.servos.states()[column]
    at = state.position_rad
    reached = jaws.arrived(at)
    closed = (at - gripper.open) / (gripper.closed - gripper.open)
    closing = (goal - gripper.open) * (gripper.closed - gripper.open) > 0
    return GripReport(
        grasped=jaws.blocked and closing and closed > _WIDE and not reached,
        reached=reached,
        position_rad=at,
        width_m=gripper.width_m(at),
        load_percent=state.load_percent,
        force=share,
        duration_s=arm.now_s() - started_s,
    )


def _check_way(arm: Workings, column: int, goal: float) -> None:
    here = arm.servos.measure()
    there = here.copy()
    there[column] = goal
    arm.check_way(here, there)


def _gripper(arm: Workings) -> Gripper:
    if arm.model.gripper is None:
        raise IkservoError(
            f'Arm "{arm.model.name}" has no gripper.',
            'Its arm file has no joint with role = "gripper".',
        )
    return arm.model.gripper


def _goal(arm: Workings, gripper: Gripper, column: int, to: Opening | float) -> float:
    """Return where the joint shall go: inside this very arm's limits."""
    low, high = (float(side[column]) for side in arm.limits())
    if isinstance(to, str):
        ends = {"open": gripper.open, "close": gripper.closed}
        if to not in ends:
            raise UnknownNameError("motion of the gripper", to, ends)
        return min(max(ends[to], low), high)
    width_m, known = number("The width", to), gripper.range_m()
    if known is None:
        raise BadValueError(
            "The width", f"{width_m:g} m", "open or close: the arm file has no widths ([gripper])"
        )
    if not known[0] - 1e-9 <= width_m <= known[1] + 1e-9:
        raise BadValueError("The width", f"{width_m:g} m", f"{known[0]:.3f} to {known[1]:.3f} m")
    return min(max(gripper.position(width_m), low), high)


def _share(force: float | None) -> float:
    share = _FORCE if force is None else number("The force", force)
    if not _LEAST_FORCE <= share <= 1.0:
        raise BadValueError("The force", f"{share:g}", f"a share from {_LEAST_FORCE} to 1")
    return share
