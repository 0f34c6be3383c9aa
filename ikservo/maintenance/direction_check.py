"""Small test motions that confirm each joint and its direction.

Ids, models and offsets can agree although two joints are exchanged, a sign is mirrored or the
geometry is another arm's: a servo measures nothing but itself. So what was confirmed by eye is
noted as a fingerprint of everything it rests on, and another fingerprint is asked about anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from ikservo.arm.arm import Arm
from ikservo.arm.calibrated_arm import serial_number_of
from ikservo.calibration.calibration_file import calibration_path, confirmation_path
from ikservo.errors import CalibrationError, RefusedError
from ikservo.files.writing import FileWriteError, write_atomic
from ikservo.model import Model, ModelJoint
from ikservo.model.tool import describe_direction

__all__ = [
    "DirectionCheck",
    "confirm_directions",
    "directions_confirmed",
    "execute_lift",
    "making_room",
    "plan_direction_check",
    "plan_lift",
    "room_m",
    "run_direction_check",
]


CHECK_ANGLE_RAD = math.radians(5.0)
"""How far the horn turns."""

_MIN_FOLLOW_FRACTION = 0.5  # of the way, at least
_MIN_MOTION_FRACTION = 0.3  # of the way: more is more than the arm's own give
# An arm that lies on the table drags its tool along it: it is lifted first where less is free.
_CLEAR_M = 0.005
_LIFT_RAD = 2.0 * CHECK_ANGLE_RAD
# So much must stay free on a little motion: an arm does not stand where it is told to the tick.
_ROOM_M = 0.001


@dataclass(frozen=True, slots=True)
class DirectionCheck:
    """One joint's little motion.

    Attributes:
        joint: Its name.
        way: How far it shall go, rad or m, signed.
        words: Which way that is, for a person: ``so that the tool goes to the left``.
    """

    joint: str
    way: float
    words: str


def plan_direction_check(arm: Arm, name: str) -> DirectionCheck:
    """Return how a joint would be moved: inside its limits, to where the body is free.

    Where both ways are, it goes the one that has more room.
    """
    joint, here, free_m = arm.model.joint(name), _measured_positions(arm), arm.clearance_m
    low, high = _range(arm, joint)
    way = CHECK_ANGLE_RAD * joint.travel_per_turn / math.tau

    def merit(way: float) -> tuple[bool, float, float]:
        there = here[name] + way
        room = high - there if way > 0 else there - low
        return room >= 0.0, min(free_m({**here, name: there}), 0.0), room

    best = max((way, -way), key=merit)
    return DirectionCheck(name, best, _describe_wiggle(arm, joint, here, 1 if best > 0 else -1))


def plan_lift(arm: Arm) -> DirectionCheck | None:
    """Return the motion of one joint that lifts an arm off what it lies on; None where it is clear.

    Of all joints, that one is taken by which the body gains the most distance.
    """
    here, free_m = _measured_positions(arm), arm.clearance_m
    at_m = free_m(here)
    if at_m >= _CLEAR_M:
        return None
    ways = [
        (free_m({**here, joint.name: here[joint.name] + way}), joint.name, way)
        for joint in arm.model.joints
        for way in _lift_ranges(arm, joint)
    ]
    best_m, name, way = max(ways, default=(at_m, "", 0.0))
    if best_m <= at_m:
        return None
    return DirectionCheck(
        name, way, _describe_wiggle(arm, arm.model.joint(name), here, 1 if way > 0 else -1)
    )


def room_m(arm: Arm, name: str) -> float:
    """Return how far the body stays from everything while one joint goes a little way and back.

    That is where it stands now, and at the better of the two ends; negative where it would touch.
    """
    return _room(arm, name)(_measured_positions(arm))


def making_room(arm: Arm, name: str) -> DirectionCheck | None:
    """Return the motion of another joint that gives one joint room to go there and back.

    None where it has room, or where no motion of a single joint gives it more.
    """
    here, room = _measured_positions(arm), _room(arm, name)
    at_m = room(here)
    if at_m >= _ROOM_M:
        return None
    lifts = [
        (room({**here, other.name: here[other.name] + way}), other.name, way)
        for other in arm.model.joints
        if other.name != name
        for way in _lift_ranges(arm, other)
    ]
    best_m, other, way = max(lifts, default=(at_m, "", 0.0))
    if best_m <= at_m:
        return None
    return DirectionCheck(
        other, way, _describe_wiggle(arm, arm.model.joint(other), here, 1 if way > 0 else -1)
    )


def execute_lift(arm: Arm, motion: DirectionCheck) -> None:
    """Lift the arm by one joint, and leave it there; see that the joint follows.

    Raises:
        CalibrationError: It did not follow.
        RefusedError: There is no room for it.
        StoppedError: The person interrupted; the arm holds.
    """
    before = _measured_positions(arm)
    _move_joint(arm, motion.joint, before[motion.joint] + motion.way)
    _check_followed(arm, motion, _measured_positions(arm)[motion.joint] - before[motion.joint])


def run_direction_check(arm: Arm, motion: DirectionCheck) -> None:
    """Move a joint there and back, and see that it and nothing else moves.

    Raises:
        CalibrationError: It did not follow, or another joint moved as well.
        RefusedError: There is no room for it.
        StoppedError: The person interrupted; the arm holds.
    """
    before = _measured_positions(arm)
    _move_joint(arm, motion.joint, before[motion.joint] + motion.way)
    there = _measured_positions(arm)
    _move_joint(arm, motion.joint, before[motion.joint])
    _check_direction(arm, motion, {name: there[name] - before[name] for name in before})


def _move_joint(arm: Arm, joint: str, position: float) -> None:
    """Move one joint slowly to a position, or to the limit before it, where sagging began."""
    try:
        arm.move_joints({joint: _clamp_position(arm, joint, position)}, speed="slow")
    except RefusedError as error:
        raise RefusedError(f"{joint}: {error.message}", error.command_hint) from error


def _clamp_position(arm: Arm, joint: str, position: float) -> float:
    column, (lower, upper) = arm.joint_index.column(joint), arm.limits()
    return min(max(position, float(lower[column])), float(upper[column]))


def _room(arm: Arm, name: str) -> Callable[[Mapping[str, float]], float]:
    """Return what tells how much room [m] a joint has in a posture for a motion there and back."""
    free_m, ways = arm.clearance_m, _lift_ranges(arm, arm.model.joint(name), CHECK_ANGLE_RAD)

    def room(joints: Mapping[str, float]) -> float:
        ends = [free_m({**joints, name: joints[name] + way}) for way in ways]
        return min(free_m(joints), max(ends, default=-math.inf))

    return room


def _lift_ranges(arm: Arm, joint: ModelJoint, way_rad: float = _LIFT_RAD) -> list[float]:
    """Return how far the joint may be moved, each way in which its limits leave room."""
    at, (low, high) = _measured_positions(arm)[joint.name], _range(arm, joint)
    way = way_rad * joint.travel_per_turn / math.tau
    return [w for w in (way, -way) if low <= at + w <= high]


def _range(arm: Arm, joint: ModelJoint) -> tuple[float, float]:
    """Return the limits of a joint; past the arm file's, where a search may go, it has stops."""
    state = next(state for state in arm.where().joints if state.name == joint.name)
    limits = joint.limits
    return max(state.lower_rad, limits.lower.value), min(state.upper_rad, limits.upper.value)


def _check_direction(arm: Arm, motion: DirectionCheck, moved: Mapping[str, float]) -> None:
    _check_followed(arm, motion, moved[motion.joint])
    for name, way in moved.items():
        most = (
            _MIN_MOTION_FRACTION
            * CHECK_ANGLE_RAD
            * arm.model.joint(name).travel_per_turn
            / math.tau
        )
        if name != motion.joint and abs(way) > most:
            raise CalibrationError(
                f"{name} moved when only {motion.joint} was told to.",
                "Check for two servos with one id, or joints that are mechanically coupled.",
            )


def _check_followed(arm: Arm, motion: DirectionCheck, moved: float) -> None:
    if moved / motion.way < _MIN_FOLLOW_FRACTION:
        say = arm.model.joint(motion.joint).joint_map.format
        raise CalibrationError(
            f"{motion.joint} was told to move by {say(motion.way)} and moved by {say(moved)}.",
            "Check for a loose horn or an obstacle.",
        )


def _describe_wiggle(arm: Arm, joint: ModelJoint, here: Mapping[str, float], towards: int) -> str:
    posed = replace(arm.model, poses={**arm.model.poses, "here": here})
    return describe_direction(posed, joint, "here", towards)


def _measured_positions(arm: Arm) -> dict[str, float]:
    return {state.name: state.position_rad for state in arm.where().joints}


def directions_confirmed(model: Model, port_name: str) -> bool:
    """Return whether the joints were seen to be right with the files as they are now."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    try:
        return path.read_text("ascii").strip() == _fingerprint(model, port_name)
    except (OSError, ValueError):  # never noted, or spoiled: nobody has seen it
        return False


def confirm_directions(model: Model, port_name: str) -> None:
    """Note that the joints were seen to be right; where no file can be written it is asked anew."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    with contextlib.suppress(FileWriteError):
        write_atomic(path, _fingerprint(model, port_name) + "\n")


def _fingerprint(model: Model, port_name: str) -> str:
    """Return a digest of joints, servos, geometry and calibration."""
    path = calibration_path(model.name, serial_number_of(port_name))
    calibration = path.read_bytes() if path.is_file() else b""
    said = repr((model.name, model.joints, model.urdf.joints)).encode("utf-8", "replace")
    return hashlib.sha256(said + b"\0" + calibration).hexdigest()
