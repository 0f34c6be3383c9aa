"""What an arm file may not say although each value by itself is right."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterator, Mapping, Sequence

from ikservo.files.complaints import Complaint, Location, spelled
from ikservo.files.quoting import quoted
from ikservo.model.arm_tables import ArmFile, ArmGripper, ArmHealth, ArmJoint, ArmPose

__all__ = ["REQUIRED_POSES", "contradictions"]

REQUIRED_POSES = ("rest", "home", "zero")


def contradictions(arm: ArmFile) -> Iterator[Complaint]:
    """Yield each contradiction between values of an arm file, in the order of the file."""
    if not any(joint.role == "arm" for joint in arm.joints):
        yield Complaint(("joints",), 'has no joint with role = "arm"', "at least one")
    yield from _repeated(_names(arm), "a unique name")
    yield from _arm_after_gripper(arm)
    yield from _repeated(_ids(arm), "an id that is unique on the bus")
    yield from _transmissions(arm)
    yield from _poses(arm)
    yield from _health(arm.health)
    if not arm.calibration.auto and arm.calibration.reason is None:
        yield Complaint(("calibration", "reason"), "is missing", "why auto = false")
    yield from _gripper(arm.gripper, [joint for joint in arm.joints if joint.role == "gripper"])


def _names(arm: ArmFile) -> Iterator[tuple[Location, str | int]]:
    for i, joint in enumerate(arm.joints):
        yield ("joints", i, "name"), joint.name


def _ids(arm: ArmFile) -> Iterator[tuple[Location, str | int]]:
    for i, joint in enumerate(arm.joints):
        yield ("joints", i, "servo", "id"), joint.servo.id
        for k, shadow in enumerate(joint.shadows):
            yield ("joints", i, "shadows", k, "id"), shadow.id


def _repeated(values: Iterator[tuple[Location, str | int]], expected: str) -> Iterator[Complaint]:
    first: dict[str | int, Location] = {}
    for location, value in values:
        if value in first:
            shown = quoted(value) if isinstance(value, str) else value
            yield Complaint(location, f"is {shown}, the same as {spelled(first[value])}", expected)
        first.setdefault(value, location)


def _arm_after_gripper(arm: ArmFile) -> Iterator[Complaint]:
    roles = [joint.role for joint in arm.joints]
    for i, role in enumerate(roles):
        if role == "arm" and "gripper" in roles[:i]:
            yield Complaint(("joints", i, "role"), 'is "arm" after a gripper', "the gripper last")


def _transmissions(arm: ArmFile) -> Iterator[Complaint]:
    for i, joint in enumerate(arm.joints):
        servo, where = joint.servo, ("joints", i, "servo")
        ways = (servo.m_per_turn is not None) + (servo.crank is not None) + (servo.gear != 1.0)
        if ways > 1:
            expected = "one of m_per_turn, crank and gear"
            yield Complaint(where, "has several transmissions", expected)
        if servo.crank and servo.crank.radius_m >= servo.crank.rod_m:
            found = f"is {servo.crank.radius_m}, not shorter than the rod"
            yield Complaint((*where, "crank", "radius_m"), found, "radius_m < rod_m")


def _poses(arm: ArmFile) -> Iterator[Complaint]:
    for name in REQUIRED_POSES:
        if name not in arm.poses:
            needed = ", ".join(REQUIRED_POSES)
            yield Complaint(("poses", name), "is missing", f"the poses {needed}")
    joints = {joint.name: joint for joint in arm.joints}
    for name, pose in arm.poses.items():
        yield from _misnamed(("poses", name), pose, joints)
        yield from _left_out(("poses", name), pose, joints)


def _health(health: ArmHealth) -> Iterator[Complaint]:
    stages = (("warn_c", health.warn_c), ("hold_c", health.hold_c), ("release_c", health.release_c))
    for (first, low), (then, high) in itertools.pairwise(stages):
        if not low <= high:
            yield Complaint(("health", then), f"is {high}, below {first}", f"{low} or more")
    if health.low_v and health.high_v and health.low_v >= health.high_v:
        found = f"is {health.low_v}, not below high_v"
        yield Complaint(("health", "low_v"), found, f"less than {health.high_v}")


def _gripper(gripper: ArmGripper, joints: Sequence[ArmJoint]) -> Iterator[Complaint]:
    if not joints:
        if gripper != ArmGripper():
            yield Complaint(
                ("gripper",), "is present", 'a joint with role = "gripper", or no [gripper]'
            )
        return
    slides = joints[0].slides
    motion, fitting = ("slides", "width_m_by_m") if slides else ("turns", "width_m_by_deg")
    for key, pairs in (
        ("width_m_by_deg", gripper.width_m_by_deg),
        ("width_m_by_m", gripper.width_m_by_m),
    ):
        if pairs and key != fitting:
            yield Complaint(("gripper", key), f"is set, but {joints[0].name} {motion}", fitting)
        elif pairs and not _one_way(pairs):
            expected = "two or more pairs, both numbers growing or one growing and one falling"
            yield Complaint(("gripper", key), "is not monotonic", expected)


def _one_way(pairs: Sequence[tuple[float, float]]) -> bool:
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(pairs)]
    growing = all(first > 0 and second > 0 for first, second in steps)
    return bool(steps) and (growing or all(first > 0 > second for first, second in steps))


def _misnamed(
    where: Location, pose: ArmPose, joints: Mapping[str, ArmJoint]
) -> Iterator[Complaint]:
    for unit, values in (("deg", pose.deg), ("m", pose.m)):
        for name in values:
            if name not in joints:
                yield Complaint((*where, unit, name), "is not a joint", _closest(name, joints))
            elif joints[name].slides != (unit == "m"):
                yield Complaint((*where, unit, name), *_other_unit(joints[name]))


def _other_unit(joint: ArmJoint) -> tuple[str, str]:
    if joint.slides:
        return "is a joint that slides (its servo has m_per_turn)", "metres, under m"
    return "is a joint that turns (its servo has no m_per_turn)", "degrees, under deg"


def _left_out(
    where: Location, pose: ArmPose, joints: Mapping[str, ArmJoint]
) -> Iterator[Complaint]:
    missing = [name for name in joints if name not in pose.deg and name not in pose.m]
    if missing:
        yield Complaint(where, f"leaves out {', '.join(missing)}", "every joint once")


def _closest(name: str, joints: Mapping[str, ArmJoint]) -> str:
    close = difflib.get_close_matches(name, joints, n=1)
    return f"{close[0]} (joints: {', '.join(joints)})" if close else f"one of {', '.join(joints)}"
