"""Small test motions that confirm each joint and its direction.

Ids, models and offsets can agree although two joints are swapped, a sign is wrong or the geometry
belongs to another arm, because a servo only measures itself. The user's confirmation is thus saved
with a fingerprint of everything on which it depends, and requested again if that changes.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from ikservo.arm.arm import Arm
from ikservo.calibration.paths import calibration_path, confirmation_path
from ikservo.errors import CalibrationError, RefusedError
from ikservo.files.writing import FileWriteError, write_atomic
from ikservo.hardware.port_names import serial_number_of
from ikservo.maintenance.dialogue import ACCEPT, Choice, Dialogue, Notice, Question, Unasked
from ikservo.model import Model, ModelJoint
from ikservo.model.tool import describe_direction
from ikservo.planning.calibrated_arm import ZeroSource

CHECK_ANGLE_RAD = math.radians(5.0)
"""Rotation of the horn in a test motion [rad]."""

_MIN_FOLLOW_FRACTION = 0.5  # fraction of the motion
_MAX_OTHER_FRACTION = 0.3  # fraction of the motion; joints that move further are coupled
# An arm that lies on the table would drag its tool, so it is lifted first below this clearance.
_CLEAR_M = 0.005
_LIFT_RAD = 2.0 * CHECK_ANGLE_RAD
# Clearance that a test motion needs, because an arm does not follow its goals exactly.
_MIN_CLEARANCE_M = 0.001

Clearance = Callable[[Mapping[str, float]], float]
"""Function that returns the clearance [m] at joint positions by name."""


@dataclass(frozen=True, slots=True)
class DirectionCheck:
    """A small test motion of one joint.

    Attributes:
        joint: The joint name.
        travel: The displacement, rad or m, signed.
        direction: Description for the user, such as ``so that the tool goes to the left``.
    """

    joint: str
    travel: float
    direction: str


def plan_direction_check(arm: Arm, name: str) -> DirectionCheck:
    """Plan the test motion of a joint, within its limits and free of collisions.

    If both directions are possible, the direction with more distance to the limit is chosen.
    """
    joint, start = arm.model.joint(name), arm.where().positions
    low, high = _range(arm, joint)
    travel = CHECK_ANGLE_RAD * joint.travel_per_turn / math.tau

    def merit(travel: float) -> tuple[bool, float, float]:
        end = start[name] + travel
        margin = high - end if travel > 0 else end - low
        return margin >= 0.0, min(arm.clearance_m({**start, name: end}), 0.0), margin

    return _make_check(arm, start, name, max((travel, -travel), key=merit))


def plan_lift(arm: Arm) -> DirectionCheck | None:
    """Plan the joint motion that best lifts an arm off its support; None if no motion is useful."""
    names = [joint.name for joint in arm.model.joints]
    return _plan_best_lift(arm, names, arm.clearance_m, _CLEAR_M)


def check_clearance_m(arm: Arm, name: str) -> float:
    """Compute the clearance of the body during the test motion of a joint and back.

    The result is the smaller of the clearances at the start and at the end; of the two possible
    ends, the end with more clearance counts. A negative result means a contact.
    """
    return _test_clearance(arm, name)(arm.where().positions)


def plan_clearance(arm: Arm, name: str) -> DirectionCheck | None:
    """Plan another joint's motion that makes room for a test; None if no motion is useful."""
    others = [joint.name for joint in arm.model.joints if joint.name != name]
    return _plan_best_lift(arm, others, _test_clearance(arm, name), _MIN_CLEARANCE_M)


def _plan_best_lift(
    arm: Arm, names: Sequence[str], clearance: Clearance, enough_m: float
) -> DirectionCheck | None:
    """Plan the joint motion, among ``names``, that gains most clearance; None if not needed."""
    start = arm.where().positions
    start_m = clearance(start)
    if start_m >= enough_m:
        return None
    lifts = [
        (clearance({**start, name: start[name] + travel}), name, travel)
        for name in names
        for travel in _possible_travels(arm, arm.model.joint(name))
    ]
    best_m, name, travel = max(lifts, default=(start_m, "", 0.0))
    return _make_check(arm, start, name, travel) if best_m > start_m else None


def _make_check(arm: Arm, start: Mapping[str, float], name: str, travel: float) -> DirectionCheck:
    posed = replace(arm.model, poses={**arm.model.poses, "start": start})
    sign = 1 if travel > 0 else -1
    text = describe_direction(posed, arm.model.joint(name), "start", sign)
    return DirectionCheck(name, travel, text)


def execute_lift(arm: Arm, motion: DirectionCheck) -> None:
    """Move a joint as planned by ``plan_lift`` or ``plan_clearance``; the joint stays there.

    Raises:
        CalibrationError: The joint did not follow.
        RefusedError: Something is in the way.
        StoppedError: The user stopped the motion; the arm holds.
    """
    before = arm.where().positions
    _move_joint(arm, motion.joint, before[motion.joint] + motion.travel)
    _check_followed(arm, motion, arm.where().positions[motion.joint] - before[motion.joint])


def run_direction_check(arm: Arm, motion: DirectionCheck) -> None:
    """Move a joint by the test motion and back, and check that no other joint moves.

    Raises:
        CalibrationError: The joint did not follow, or another joint moved as well.
        RefusedError: Something is in the way.
        StoppedError: The user stopped the motion; the arm holds.
    """
    with arm.runner.requested():
        before = arm.where().positions
        _move_joint(arm, motion.joint, before[motion.joint] + motion.travel)
        moved = arm.where().positions
        _move_joint(arm, motion.joint, before[motion.joint])
    travels = {name: moved[name] - before[name] for name in before}
    _check_followed(arm, motion, travels[motion.joint])
    for name, travel in travels.items():
        horn_rad = travel / arm.model.joint(name).travel_per_turn * math.tau
        if name != motion.joint and abs(horn_rad) > _MAX_OTHER_FRACTION * CHECK_ANGLE_RAD:
            raise CalibrationError(
                f"{name} moved when only {motion.joint} was commanded.",
                "Check for two servos with one id, or joints that are mechanically coupled.",
            )


def _move_joint(arm: Arm, joint: str, position: float) -> None:
    """Move one joint slowly to a position, clamped to its limits."""
    try:
        column, (lower, upper) = arm.joint_index.column(joint), arm.limits()
        arm.move_joints(
            {joint: min(max(position, float(lower[column])), float(upper[column]))}, speed="slow"
        )
    except RefusedError as error:
        raise RefusedError(f"{joint}: {error.message}", error.command_hint) from error


def _test_clearance(arm: Arm, name: str) -> Clearance:
    """Return the function that computes the clearance for the test motion of a joint and back."""
    travels = _possible_travels(arm, arm.model.joint(name), CHECK_ANGLE_RAD)

    def clearance(joints: Mapping[str, float]) -> float:
        ends = [arm.clearance_m({**joints, name: joints[name] + travel}) for travel in travels]
        return min(arm.clearance_m(joints), max(ends, default=-math.inf))

    return clearance


def _possible_travels(arm: Arm, joint: ModelJoint, horn_rad: float = _LIFT_RAD) -> list[float]:
    """Compute the possible displacements of the joint, in each direction that its limits allow."""
    position, (low, high) = arm.where().positions[joint.name], _range(arm, joint)
    travel = horn_rad * joint.travel_per_turn / math.tau
    return [by for by in (travel, -travel) if low <= position + by <= high]


def _range(arm: Arm, joint: ModelJoint) -> tuple[float, float]:
    """Return a joint's limits within the arm file's limits, beyond which there are end stops."""
    state, limits = arm.where()[joint.name], joint.limits
    return max(state.lower_rad, limits.lower.value), min(state.upper_rad, limits.upper.value)


def _check_followed(arm: Arm, motion: DirectionCheck, moved: float) -> None:
    if moved / motion.travel < _MIN_FOLLOW_FRACTION:
        text = arm.model.joint(motion.joint).joint_map.format
        raise CalibrationError(
            f"{motion.joint} was commanded to move by {text(motion.travel)} but moved by "
            f"{text(moved)}.",
            "Check for a loose horn or an obstacle.",
        )


def check_each_joint(arm: Arm, names: Sequence[str]) -> Dialogue[list[DirectionCheck]]:
    """Enable an arm, and confirm the named joints by test motions; return the motions.

    If every joint is then confirmed, the confirmation is saved.

    Raises:
        CalibrationError: A joint is not the expected one; torque stays on.
        RefusedError: Something is in the way.
        StoppedError: The user stopped the motion; the arm holds.
    """
    arm.enable()  # a limp arm sinks: motions are measured from where it holds
    with contextlib.suppress(RefusedError):  # the test motions are planned and checked separately
        arm.return_within_limits()  # it may have sunk past a limit
    lift = plan_lift(arm)
    if lift is not None:
        yield Notice(
            f"The arm rests on something, so {lift.joint} moves {lift.direction} and stays there."
        )
        execute_lift(arm, lift)
        yield from _confirm_direction(arm, lift, searching=False)
    motions = yield from show_directions(arm, names)
    if len(motions) == len(arm.model.joints):
        confirm_directions(arm.model, arm.port_name)
    return motions


def show_directions(
    arm: Arm, names: Sequence[str], *, searching: bool = False
) -> Dialogue[list[DirectionCheck]]:
    """Move each of the joints slightly and back, and ask whether it moved as described.

    If ``searching``, the search for end stops comes next, and the arm has no calibration yet.

    Raises:
        CalibrationError: A joint is not the expected one; torque stays on.
        RefusedError: Something is in the way.
        StoppedError: The user stopped the motion; the arm holds.
    """
    motions: list[DirectionCheck] = []
    for name in names:
        yield from _make_room(arm, name, searching=searching)
        motion = plan_direction_check(arm, name)
        yield Notice(f"{name} moves {motion.direction}, then back.")
        run_direction_check(arm, motion)
        yield from _confirm_direction(arm, motion, searching=searching)
        motions.append(motion)
    return motions


def _make_room(arm: Arm, name: str, *, searching: bool) -> Dialogue[None]:
    """Move other joints of a folded arm until one joint is free to move slightly."""
    for _ in arm.model.joints:
        motion = plan_clearance(arm, name)
        if motion is None:
            break
        yield Notice(
            f"{motion.joint} moves {motion.direction}, and stays there, because it is in "
            f"the way of {name}."
        )
        execute_lift(arm, motion)
        yield from _confirm_direction(arm, motion, searching=searching)
    if searching and check_clearance_m(arm, name) < 0.0:
        raise RefusedError(
            f"{name} cannot move by 5° without a collision; torque stays on.",
            "Nothing was saved. Start from a pose with more room: "
            f"ikservo calibrate {arm.model.name} --auto --pose home",
        )


def _confirm_direction(arm: Arm, motion: DirectionCheck, *, searching: bool) -> Dialogue[None]:
    question = f"Did {motion.joint} move {motion.direction}?"
    if (yield Question(question, Unasked.YES, more=(Choice("no", "no"),))) != ACCEPT:
        by_hand = f"ikservo calibrate {arm.model.name}"
        raise CalibrationError(
            f"{motion.joint} does not move as the arm file says; torque stays on.",
            f"Calibrate it by hand, which also finds its sign: {by_hand}"
            if searching
            else "If another joint moved: check the ids in the arm file. If the joint went the "
            f"other way: {by_hand} --joint {motion.joint}",
        )


def needs_direction_check(arm: Arm) -> bool:
    """Check whether the joints must be tested, because the present files are not confirmed.

    An arm with unknown zeros moves in small steps that are each confirmed; it needs no test.
    """
    if arm.zeros in (ZeroSource.SIMULATED, ZeroSource.UNKNOWN):
        return False
    return not directions_confirmed(arm.model, arm.port_name)


def directions_confirmed(model: Model, port_name: str) -> bool:
    """Check whether the user has confirmed the joints with the present files."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    try:
        return path.read_text("ascii").strip() == _fingerprint(model, port_name)
    except (OSError, ValueError):  # not saved, or malformed
        return False


def confirm_directions(model: Model, port_name: str) -> None:
    """Save the user's confirmation of the joints if a file can be written."""
    path = confirmation_path(model.name, serial_number_of(port_name))
    with contextlib.suppress(FileWriteError):
        write_atomic(path, _fingerprint(model, port_name) + "\n")


def _fingerprint(model: Model, port_name: str) -> str:
    """Return a digest of joints, servos, geometry and calibration."""
    path = calibration_path(model.name, serial_number_of(port_name))
    calibration = path.read_bytes() if path.is_file() else b""
    content = repr((model.name, model.joints, model.urdf.joints)).encode("utf-8", "replace")
    return hashlib.sha256(content + b"\0" + calibration).hexdigest()
