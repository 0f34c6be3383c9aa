"""Each joint a little back and forth, so that a person sees whether it is the right one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ikservo.arm.arm import Arm
from ikservo.errors import CalibrationError, RefusedError
from ikservo.model import ModelJoint
from ikservo.model.directions import direction

__all__ = ["Wiggle", "expected", "wiggle"]

WAY_RAD = math.radians(5.0)
"""How far the horn turns."""

_FOLLOWS = 0.5  # of the way, at least
_STIRS = 0.3  # of the way: more is more than the arm's own give


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
    """Return how a joint would be moved: to where it has more room."""
    joint, here = arm.model.joint(name), _positions(arm)
    state = next(state for state in arm.where().joints if state.name == name)
    way = WAY_RAD * joint.travel_per_turn / math.tau
    up = state.upper_rad - state.position_rad >= state.position_rad - state.lower_rad
    return Wiggle(name, way if up else -way, _words(arm, joint, here, 1 if up else -1))


def wiggle(arm: Arm, motion: Wiggle) -> None:
    """Move a joint there and back, and see that it and nothing else moves.

    Raises:
        CalibrationError: It did not follow, or another joint moved as well.
        RefusedError: There is no room for it.
        StoppedError: The person interrupted; the arm holds.
    """
    before = _positions(arm)
    try:
        arm.move_joints({motion.joint: before[motion.joint] + motion.way}, speed="slow")
        there = _positions(arm)
        arm.move_joints({motion.joint: before[motion.joint]}, speed="slow")
    except RefusedError as error:
        raise RefusedError(f"{motion.joint}: {error.message}", error.hint) from error
    _judge(arm, motion, {name: there[name] - before[name] for name in before})


def _judge(arm: Arm, motion: Wiggle, moved: Mapping[str, float]) -> None:
    if moved[motion.joint] / motion.way < _FOLLOWS:
        say = arm.model.joint(motion.joint).joint_map.say
        raise CalibrationError(
            f"{motion.joint} was to go {say(motion.way)} and went {say(moved[motion.joint])}.",
            "Look for a loose horn or something in its way.",
        )
    for name, way in moved.items():
        most = _STIRS * WAY_RAD * arm.model.joint(name).travel_per_turn / math.tau
        if name != motion.joint and abs(way) > most:
            raise CalibrationError(
                f"{name} moved when {motion.joint} was told to.",
                "Look for two servos with one id, or a joint that hangs on another.",
            )


def _words(arm: Arm, joint: ModelJoint, here: Mapping[str, float], towards: int) -> str:
    posed = replace(arm.model, poses={**arm.model.poses, "here": here})
    return direction(posed, joint, "here", towards)


def _positions(arm: Arm) -> dict[str, float]:
    return {state.name: state.position_rad for state in arm.where().joints}
