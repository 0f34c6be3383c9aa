"""Enable torque: verified hold positions, gains, and checks before goals are streamed.

That is how far a joint sinks when its watchdog makes its goal where it stands.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from ikservo.calibration.servo_config import CURRENT_POSITION, EXTENDED
from ikservo.clock import Clock
from ikservo.control.feedback import Feedback, read_register
from ikservo.control.health_polling import HealthPoller
from ikservo.control.servo_limits import ServoRamLimits
from ikservo.errors import HeldUpError, RefusedError, ServoRejectedError
from ikservo.guard import CommandLimits
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Family, RegisterName

__all__ = [
    "accepted_goal_range",
    "clamp_goal",
    "hold_ticks",
    "prepare_servos",
    "raise_gains",
    "verify_goals",
    "wait_until_settled",
    "wait_until_still",
]


# An arm that is caught while it falls swings a little: it stands when no joint moves by more in
# the time between two looks, and is not waited for any longer than the last number.
_POLL_PERIOD_S, _AT_REST_TICKS, _MAX_WAIT_S = 0.03, 2, 1.0
# A limp arm lies still when no joint moves by more than one tick between two looks. One whose
# horn turns by more than the last number meanwhile falls.
_SINK_POLL_PERIOD_S, _NOISE_TICKS, _FALLS_RAD = 0.05, 1, 0.01
# Further outside its own limits a servo is not a little out of place but on another turn: told
# to hold, it would go all the way round.
_MAX_GOAL_TICKS = 170


def hold_ticks(
    bus: ServoBus, fences: Sequence[CommandLimits], feedback: Feedback
) -> dict[str, int]:
    """Return the tick at which each joint holds, or would if its torque came on.

    A servo that already holds keeps its goal, for its load has pulled it a little below; unless
    the goal is an old one, far from where the joint is.

    Raises:
        BusError: A servo does not answer.
    """
    ids = [fence.servo_id for fence in fences]
    torque = read_register(bus, ids, RegisterName.TORQUE_ENABLE)
    goals = read_register(bus, ids, RegisterName.GOAL_POSITION)
    present = feedback.measure_ticks()  # last, for limp joints fall
    return {
        f.joint: _held_tick(f, torque[f.servo_id] != 0, present[f.joint], goals[f.servo_id])
        for f in fences
    }


def wait_until_settled(
    fences: Sequence[CommandLimits], goals: Mapping[str, int], feedback: Feedback, clock: Clock
) -> bool:
    """Wait until the joints stand near their goals whose torque has just come on.

    Returns:
        Whether they do: False where a second was not enough.
    """
    present = feedback.measure_ticks()
    for _ in range(int(_MAX_WAIT_S / _POLL_PERIOD_S)):
        clock.sleep_until(clock.now_s() + _POLL_PERIOD_S)
        before, present = present, feedback.measure_ticks()
        still = all(abs(present[f.joint] - before[f.joint]) <= _AT_REST_TICKS for f in fences)
        near = all(abs(goals[f.joint] - present[f.joint]) <= f.max_lead_ticks(0.0) for f in fences)
        if still and near:
            return True
    return False


def wait_until_still(
    fences: Sequence[CommandLimits], feedback: Feedback, clock: Clock, longest_s: float
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
    before = feedback.measure_ticks()
    while clock.now_s() < end_s:
        clock.sleep_until(clock.now_s() + _SINK_POLL_PERIOD_S)
        present = feedback.measure_ticks()
        moved = {f: abs(present[f.joint] - before[f.joint]) for f in fences}
        falls = any(way * f.joint_map.horn_rad_per_tick > _FALLS_RAD for f, way in moved.items())
        if falls or all(way <= _NOISE_TICKS for way in moved.values()):
            return
        before = present


def _held_tick(fence: CommandLimits, torque: bool, present: int, goal: int) -> int:
    return goal if torque and abs(goal - present) <= fence.max_lead_ticks(0.0) else present


def clamp_goal(fence: CommandLimits, tick: int, taken: tuple[int, int]) -> int:
    """Return the tick nearest to ``tick`` that the servo will take for a goal.

    Args:
        fence: Of the joint.
        tick: Where it stands.
        taken: See ``accepted_goal_range``.

    Raises:
        RefusedError: The joint stands far outside what its servo allows; torque stays off.
    """
    low, high = taken
    goal = min(max(tick, low), high)
    if abs(goal - tick) > _MAX_GOAL_TICKS:
        raise RefusedError(
            f"{fence.joint} is at tick {tick}, far outside the range {low} to {high} of its servo.",
            "Move the joint by hand into its limits; torque stays off.",
        )
    return goal


def verify_goals(bus: ServoBus, wanted: Mapping[int, int]) -> None:
    """Read goals back before torque comes on: a stale one would make the joint snap to it.

    Raises:
        ServoRefusedError: A servo keeps another goal; torque stays off.
    """
    goals = read_register(bus, wanted, RegisterName.GOAL_POSITION)
    for servo_id, goal in goals.items():
        if goal != wanted[servo_id]:
            raise ServoRejectedError(
                f"keeps goal {goal} instead of {wanted[servo_id]}, its position",
                "Move the joint by hand into its limits; torque stays off.",
                servo=str(bus.servos[servo_id]),
                servo_id=servo_id,
                port=bus.port.name,
            )


def accepted_goal_range(bus: ServoBus, servo_id: int) -> tuple[int, int]:
    """Return the least and the greatest goal that a servo takes."""
    table = bus.servos[servo_id].table
    low = bus.read(servo_id, RegisterName.MIN_POSITION_LIMIT, raw=True)
    high = bus.read(servo_id, RegisterName.MAX_POSITION_LIMIT, raw=True)
    counts_on = low == high == 0  # Feetech: several turns, no limits
    if table.family is Family.DYNAMIXEL_2:
        mode = bus.read(servo_id, RegisterName.OPERATING_MODE, raw=True)
        counts_on = mode in (EXTENDED, CURRENT_POSITION)
    return table.find(RegisterName.GOAL_POSITION).range if counts_on else (low, high)


# Watchdogs are armed in less than this, or armed again so many times.
_WATCHDOG_DELAY_S, _ATTEMPTS = 0.08, 3


def prepare_servos(
    limits: ServoRamLimits, health_round: HealthPoller | None, clock: Clock, horn_rad_s: float
) -> float:
    """Set limits and watchdogs and hear that all is well: again where that took too long.

    A watchdog that trips meanwhile takes the limits with it.

    Args:
        limits: Of the servos.
        health_round: Asks how they are; None before torque was ever switched on.
        clock: The line's time.
        horn_rad_s: The top speed of the motion.

    Returns:
        From when on the first beat counts, so that no pause in between is overlooked.

    Raises:
        BusError: A servo does not answer.
        ServoAlarmError: A servo is not well.
        HeldUpError: The program was held up again and again.
    """

    def armed_s() -> float:
        limits.set_speed(horn_rad_s)
        since_s = clock.now_s()
        limits.arm_watchdog()
        if health_round:
            health_round.poll_all()
        return since_s

    for _ in range(_ATTEMPTS):
        with contextlib.suppress(HeldUpError):  # one has tripped already
            since_s = armed_s()
            if clock.now_s() - since_s < _WATCHDOG_DELAY_S or not limits.watchdog_ids:
                return since_s
        limits.disarm_watchdog()
        limits.invalidate()
    armed_s()
    return clock.now_s()  # the line is as slow as that


# The gains at which owners of Koch and OMX arms run their elbows: a D part goes with so much P.
_ARM_GAINS: Mapping[str, int] = MappingProxyType({"position_d_gain": 600, "position_p_gain": 1500})
# A gripper yields a little more.
_GRIPPER_GAINS: Mapping[str, int] = MappingProxyType({"position_p_gain": 800})
_SOFT_GAINS = ("XL330-M288", "XL330-M077")


def raise_gains(bus: ServoBus, servo_id: int, *, jaws: bool) -> None:
    """Raise the gains of a servo that is too soft; in RAM, never below what stands there.

    Raises:
        BusError: It does not answer.
    """
    table = bus.servos[servo_id].table
    if table.model_name not in _SOFT_GAINS:
        return
    for name, least in (_GRIPPER_GAINS if jaws else _ARM_GAINS).items():
        if bus.read(servo_id, table.registers[name], raw=True) < least:
            bus.write(servo_id, table.registers[name], least, raw=True)
