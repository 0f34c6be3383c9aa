"""Each joint a little back and forth, so that a person sees whether it is the right one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ikservo.arm.arm import Arm
from ikservo.errors import CalibrationError, RefusedError
from ikservo.model import ModelJoint
from ikservo.model.directions import direction

__all__ = ["Wiggle", "expected", "lift", "lifting", "making_room", "room_m", "wiggle"]

WAY_RAD = math.radians(5.0)
"""How far the horn turns."""

_FOLLOWS = 0.5  # of the way, at least
_STIRS = 0.3  # of the way: more is more than the arm's own give
# An arm that lies on the table drags its tool along it: it is lifted first where less is free.
_CLEAR_M = 0.005
_LIFT_RAD = 2.0 * WAY_RAD
# So much must stay free on a little motion: an arm does not stand where it is told to the tick.
_ROOM_M = 0.001


@dataclass(frozen=True, slots=True)
class Wiggle:
    """One joint's little motion.

    Attributes:
        joint: Its name.
        way: How far it shall go, rad or m, signed.
        words: Which way that is, for a person: ``so that the tool goes to the left``.
    """

    joint: str
    way: float
    words: str


def expected(arm: Arm, name: str) -> Wiggle:
    """Return how a joint would be moved: inside its limits, to where the body is free.

    Where both ways are, it goes the one that has more room.
    """
    joint, here, free_m = arm.model.joint(name), _positions(arm), _clearance_m(arm)
    low, high = _range(arm, joint)
    way = WAY_RAD * joint.travel_per_turn / math.tau

    def merit(way: float) -> tuple[bool, float, float]:
        there = here[name] + way
        room = high - there if way > 0 else there - low
        return room >= 0.0, min(free_m({**here, name: there}), 0.0), room

    best = max((way, -way), key=merit)
    return Wiggle(name, best, _words(arm, joint, here, 1 if best > 0 else -1))


def lifting(arm: Arm) -> Wiggle | None:
    """Return the motion of one joint that lifts an arm off what it lies on; None where it is clear.

    Of all joints, that one is taken by which the body gains the most distance.
    """
    here, free_m = _positions(arm), _clearance_m(arm)
    at_m = free_m(here)
    if at_m >= _CLEAR_M:
        return None
    ways = [
        (free_m({**here, joint.name: here[joint.name] + way}), joint.name, way)
        for joint in arm.model.joints
        for way in _ways(arm, joint)
    ]
    best_m, name, way = max(ways, default=(at_m, "", 0.0))
    if best_m <= at_m:
        return None
    return Wiggle(name, way, _words(arm, arm.model.joint(name), here, 1 if way > 0 else -1))


def room_m(arm: Arm, name: str) -> float:
    """Return how far the body stays from everything while one joint goes a little way and back.

    That is where it stands now, and at the better of the two ends; negative where it would touch.
    """
    return _room(arm, name)(_positions(arm))


def making_room(arm: Arm, name: str) -> Wiggle | None:
    """Return the motion of another joint that gives one joint room to go there and back.

    None where it has room, or where no motion of a single joint gives it more.
    """
    here, room = _positions(arm), _room(arm, name)
    at_m = room(here)
    if at_m >= _ROOM_M:
        return None
    lifts = [
        (room({**here, other.name: here[other.name] + way}), other.name, way)
        for other in arm.model.joints
        if other.name != name
        for way in _ways(arm, other)
    ]
    best_m, other, way = max(lifts, default=(at_m, "", 0.0))
    if best_m <= at_m:
        return None
    return Wiggle(other, way, _words(arm, arm.model.joint(other), here, 1 if way > 0 else -1))


def lift(arm: Arm, motion: Wiggle) -> None:
    """Lift the arm by one joint, and leave it there; see that the joint follows.

    Raises:
        CalibrationError: It did not follow.
        RefusedError: There is no room for it.
        StoppedError: The person interrupted; the arm holds.
    """
    before = _positions(arm)
    _lead(arm, motion.joint, before[motion.joint] + motion.way)
    _check_followed(arm, motion, _positions(arm)[motion.joint] - before[motion.joint])


def wiggle(arm: Arm, motion: Wiggle) -> None:
    """Move a joint there and back, and see that it and nothing else moves.

    Raises:
        CalibrationError: It did not follow, or another joint moved as well.
        RefusedError: There is no room for it.
        StoppedError: The person interrupted; the arm holds.
    """
    before = _positions(arm)
    _lead(arm, motion.joint, before[motion.joint] + motion.way)
    there = _positions(arm)
    _lead(arm, motion.joint, before[motion.joint])
    _judge(arm, motion, {name: there[name] - before[name] for name in before})


def _lead(arm: Arm, joint: str, position: float) -> None:
    """Move one joint slowly to a position, or to the limit before it, where sagging began."""
    try:
        arm.move_joints({joint: _inside(arm, joint, position)}, speed="slow")
    except RefusedError as error:
        raise RefusedError(f"{joint}: {error.message}", error.command_hint) from error


def _inside(arm: Arm, joint: str, position: float) -> float:
    fence = next(fence for fence in arm.workings.servos.fences if fence.joint == joint)
    lower, upper = fence.positions
    return min(max(position, lower), upper)


def _clearance_m(arm: Arm) -> Callable[[Mapping[str, float]], float]:
    """Return what tells how much room the body has left in a posture; endless where unknown."""
    space, names = arm.workings.space, arm.workings.servos.names
    if space is None or not arm.zeros.known:
        return lambda _: math.inf

    def free_m(joints: Mapping[str, float]) -> float:
        vector = np.array([joints[name] for name in names])
        return float(space.gaps([arm.workings.in_body(vector)]).min())

    return free_m


def _room(arm: Arm, name: str) -> Callable[[Mapping[str, float]], float]:
    """Return what tells how much room [m] a joint has in a posture for a motion there and back."""
    free_m, ways = _clearance_m(arm), _ways(arm, arm.model.joint(name), WAY_RAD)

    def room(joints: Mapping[str, float]) -> float:
        ends = [free_m({**joints, name: joints[name] + way}) for way in ways]
        return min(free_m(joints), max(ends, default=-math.inf))

    return room


def _ways(arm: Arm, joint: ModelJoint, way_rad: float = _LIFT_RAD) -> list[float]:
    """Return how far the joint may be moved, each way in which its limits leave room."""
    at, (low, high) = _positions(arm)[joint.name], _range(arm, joint)
    way = way_rad * joint.travel_per_turn / math.tau
    return [w for w in (way, -way) if low <= at + w <= high]


def _range(arm: Arm, joint: ModelJoint) -> tuple[float, float]:
    """Return the limits of a joint; past the arm file's, where a search may go, it has stops."""
    state = next(state for state in arm.where().joints if state.name == joint.name)
    limits = joint.limits
    return max(state.lower_rad, limits.lower.value), min(state.upper_rad, limits.upper.value)


def _judge(arm: Arm, motion: Wiggle, moved: Mapping[str, float]) -> None:
    _check_followed(arm, motion, moved[motion.joint])
    for name, way in moved.items():
        most = _STIRS * WAY_RAD * arm.model.joint(name).travel_per_turn / math.tau
        if name != motion.joint and abs(way) > most:
            raise CalibrationError(
                f"{name} moved when only {motion.joint} was told to.",
                "Check for two servos with one id, or joints that are mechanically coupled.",
            )


def _check_followed(arm: Arm, motion: Wiggle, moved: float) -> None:
    if moved / motion.way < _FOLLOWS:
        say = arm.model.joint(motion.joint).joint_map.say
        raise CalibrationError(
            f"{motion.joint} was told to move by {say(motion.way)} and moved by {say(moved)}.",
            "Check for a loose horn or an obstacle.",
        )


def _words(arm: Arm, joint: ModelJoint, here: Mapping[str, float], towards: int) -> str:
    posed = replace(arm.model, poses={**arm.model.poses, "here": here})
    return direction(posed, joint, "here", towards)


def _positions(arm: Arm) -> dict[str, float]:
    return {state.name: state.position_rad for state in arm.where().joints}
