"""Where servos may be told to hold when their torque comes on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ikservo.arm.streaming.asking import ask_all
from ikservo.arm.streaming.feedback import Feedback
from ikservo.calibration.in_servos.memory import CURRENT_POSITION, EXTENDED
from ikservo.clock import Clock
from ikservo.errors import RefusedError, ServoRefusedError
from ikservo.guard import Fence
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Family, Role

__all__ = [
    "await_rest",
    "await_still",
    "confirm_goals",
    "goals_taken",
    "holding_ticks",
    "nearest_goal",
]

# An arm that is caught while it falls swings a little: it stands when no joint moves by more in
# the time between two looks, and is not waited for any longer than the last number.
_LOOK_S, _STILL_TICKS, _LONGEST_S = 0.03, 2, 1.0
# A limp arm lies still when no joint moves by more than one tick between two looks. One whose
# horn turns by more than the last number meanwhile falls.
_SINK_LOOK_S, _FLICKER_TICKS, _FALLS_RAD = 0.05, 1, 0.01
# Further outside its own limits a servo is not a little out of place but on another turn: told
# to hold, it would go all the way round.
_FARTHEST_TICKS = 170


def holding_ticks(bus: ServoBus, fences: Sequence[Fence], feedback: Feedback) -> dict[str, int]:
    """Return the tick at which each joint holds, or would if its torque came on.

    A servo that already holds keeps its goal, for its load has pulled it a little below; unless
    the goal is an old one, far from where the joint is.

    Raises:
        BusError: A servo does not answer.
    """
    ids = [fence.servo_id for fence in fences]
    torque = ask_all(bus, ids, Role.TORQUE_ENABLE)
    goals = ask_all(bus, ids, Role.GOAL_POSITION)
    present = feedback.ticks()  # last, for limp joints fall
    return {
        f.joint: _holds(f, torque[f.servo_id] != 0, present[f.joint], goals[f.servo_id])
        for f in fences
    }


def await_rest(
    fences: Sequence[Fence], goals: Mapping[str, int], feedback: Feedback, clock: Clock
) -> bool:
    """Wait until the joints stand near their goals whose torque has just come on.

    Returns:
        Whether they do: False where a second was not enough.
    """
    present = feedback.ticks()
    for _ in range(int(_LONGEST_S / _LOOK_S)):
        clock.sleep_until(clock.now_s() + _LOOK_S)
        before, present = present, feedback.ticks()
        still = all(abs(present[f.joint] - before[f.joint]) <= _STILL_TICKS for f in fences)
        near = all(abs(goals[f.joint] - present[f.joint]) <= f.lead_ticks(0.0) for f in fences)
        if still and near:
            return True
    return False


def await_still(
    fences: Sequence[Fence], feedback: Feedback, clock: Clock, longest_s: float
) -> None:
    """Wait until a limp arm lies still: one that sinks is planned for where it comes to lie.

    One that falls is not waited for, for its torque shall catch it.

    Args:
        fences: One for each joint.
        feedback: Measures them.
        clock: The line's time.
        longest_s: After this time whoever waits goes on: a hand may be moving the arm.

    Raises:
        BusError: A servo does not answer.
    """
    end_s = clock.now_s() + longest_s
    before = feedback.ticks()
    while clock.now_s() < end_s:
        clock.sleep_until(clock.now_s() + _SINK_LOOK_S)
        present = feedback.ticks()
        moved = {f: abs(present[f.joint] - before[f.joint]) for f in fences}
        falls = any(way * f.joint_map.horn_rad_per_tick > _FALLS_RAD for f, way in moved.items())
        if falls or all(way <= _FLICKER_TICKS for way in moved.values()):
            return
        before = present


def _holds(fence: Fence, torque: bool, present: int, goal: int) -> int:
    return goal if torque and abs(goal - present) <= fence.lead_ticks(0.0) else present


def nearest_goal(fence: Fence, tick: int, taken: tuple[int, int]) -> int:
    """Return the tick nearest to ``tick`` that the servo will take for a goal.

    Args:
        fence: Of the joint.
        tick: Where it stands.
        taken: See ``goals_taken``.

    Raises:
        RefusedError: The joint stands far outside what its servo allows; torque stays off.
    """
    low, high = taken
    goal = min(max(tick, low), high)
    if abs(goal - tick) > _FARTHEST_TICKS:
        raise RefusedError(
            f"{fence.joint} is at tick {tick}, far outside the range {low} to {high} of its servo.",
            "Move the joint by hand into its limits; torque stays off.",
        )
    return goal


def confirm_goals(bus: ServoBus, wanted: Mapping[int, int]) -> None:
    """Read goals back before torque comes on: a stale one would make the joint snap to it.

    Raises:
        ServoRefusedError: A servo keeps another goal; torque stays off.
    """
    goals = ask_all(bus, wanted, Role.GOAL_POSITION)
    for servo_id, goal in goals.items():
        if goal != wanted[servo_id]:
            raise ServoRefusedError(
                f"keeps goal {goal} instead of {wanted[servo_id]}, its position",
                "Move the joint by hand into its limits; torque stays off.",
                servo=str(bus.servos[servo_id]),
                servo_id=servo_id,
                port=bus.port.name,
            )


def goals_taken(bus: ServoBus, servo_id: int) -> tuple[int, int]:
    """Return the least and the greatest goal that a servo takes."""
    table = bus.servos[servo_id].table
    low = bus.read(servo_id, Role.MIN_POSITION_LIMIT, raw=True)
    high = bus.read(servo_id, Role.MAX_POSITION_LIMIT, raw=True)
    counts_on = low == high == 0  # Feetech: several turns, no limits
    if table.family is Family.DYNAMIXEL_2:
        mode = bus.read(servo_id, Role.OPERATING_MODE, raw=True)
        counts_on = mode in (EXTENDED, CURRENT_POSITION)
    return table.find(Role.GOAL_POSITION).range if counts_on else (low, high)
