"""Read ``arm.toml`` and check it against the URDF and the servo tables."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

from ikservo.errors import BadValueError
from ikservo.files.reading import path_inside, quote, read_toml
from ikservo.files.validation import Location, ValidationIssue, first_issue, format_key_path
from ikservo.model.arm_schema import ArmFile, ArmGripper, ArmHealth, ArmJoint
from ikservo.model.base_placement import parse_frame
from ikservo.model.catalogue import catalogue_name

REQUIRED_POSES = ("rest", "home")


def arm_file_issues(arm: ArmFile) -> Iterator[ValidationIssue]:
    """Yield each inconsistency between values of an arm file, in the order of the file."""
    if not any(joint.role == "arm" for joint in arm.joints):
        yield ValidationIssue(("joints",), 'has no joint with role = "arm"', "at least one")
    names = [(("joints", i, "name"), joint.name) for i, joint in enumerate(arm.joints)]
    yield from _find_repeated(names, "a unique name")
    roles = [joint.role for joint in arm.joints]
    for i, role in enumerate(roles):
        if role == "arm" and "gripper" in roles[:i]:
            found = 'is "arm" after a gripper'
            yield ValidationIssue(("joints", i, "role"), found, "the gripper last")
    servo_ids: list[tuple[Location, str | int]] = []
    for i, joint in enumerate(arm.joints):
        servo_ids.append((("joints", i, "servo", "id"), joint.servo.id))
        for k, shadow in enumerate(joint.shadows):
            servo_ids.append((("joints", i, "shadows", k, "id"), shadow.id))
    yield from _find_repeated(servo_ids, "an id that is unique on the bus")
    yield from _check_transmissions(arm)
    yield from _check_limits(arm)
    yield from _check_pose_joints(arm)
    yield from _check_health(arm.health)
    if not arm.calibration.auto and arm.calibration.reason is None:
        yield ValidationIssue(("calibration", "reason"), "is missing", "why auto = false")
    yield from _check_gripper(
        arm.gripper, [joint for joint in arm.joints if joint.role == "gripper"]
    )


def _find_repeated(
    values: Sequence[tuple[Location, str | int]], expected: str
) -> Iterator[ValidationIssue]:
    first: dict[str | int, Location] = {}
    for location, value in values:
        if value in first:
            shown = quote(value) if isinstance(value, str) else value
            yield ValidationIssue(
                location, f"is {shown}, the same as {format_key_path(first[value])}", expected
            )
        first.setdefault(value, location)


def _check_transmissions(arm: ArmFile) -> Iterator[ValidationIssue]:
    for i, joint in enumerate(arm.joints):
        servo, where = joint.servo, ("joints", i, "servo")
        transmissions = (
            (servo.m_per_turn is not None) + (servo.crank is not None) + (servo.gear != 1.0)
        )
        if transmissions > 1:
            expected = "one of m_per_turn, crank and gear"
            yield ValidationIssue(where, "has several transmissions", expected)
        if servo.crank and servo.crank.radius_m >= servo.crank.rod_m:
            found = f"is {servo.crank.radius_m}, not shorter than the rod"
            yield ValidationIssue((*where, "crank", "radius_m"), found, "radius_m < rod_m")


def _check_limits(arm: ArmFile) -> Iterator[ValidationIssue]:
    for i, joint in enumerate(arm.joints):
        own, other = (
            ("limits_m", "limits_deg") if joint.is_prismatic else ("limits_deg", "limits_m")
        )
        if getattr(joint, other) is not None:
            verb = "slides" if joint.is_prismatic else "turns"
            yield ValidationIssue(("joints", i, other), f"is set, but {joint.name} {verb}", own)
        limits = getattr(joint, own)
        if limits is not None and not limits[0] < limits[1]:
            yield ValidationIssue(
                ("joints", i, own), f"is {list(limits)}", "the lower limit below the upper one"
            )


def _check_pose_joints(arm: ArmFile) -> Iterator[ValidationIssue]:
    for name in REQUIRED_POSES:
        if name not in arm.poses:
            needed = ", ".join(REQUIRED_POSES)
            yield ValidationIssue(("poses", name), "is missing", f"the poses {needed}")
    joints = {joint.name: joint for joint in arm.joints}
    for name, pose in arm.poses.items():
        for unit, values in (("deg", pose.deg), ("m", pose.m)):
            for joint in values:
                where = ("poses", name, unit, joint)
                if joint not in joints:
                    close = difflib.get_close_matches(joint, joints, n=1)
                    listed = ", ".join(joints)
                    expected = f"{close[0]} (joints: {listed})" if close else f"one of {listed}"
                    yield ValidationIssue(where, "is not a joint", expected)
                elif joints[joint].is_prismatic and unit == "deg":
                    found = "is a joint that slides (its servo has m_per_turn)"
                    yield ValidationIssue(where, found, "metres, under m")
                elif not joints[joint].is_prismatic and unit == "m":
                    found = "is a joint that turns (its servo has no m_per_turn)"
                    yield ValidationIssue(where, found, "degrees, under deg")
        missing = [joint for joint in joints if joint not in pose.deg and joint not in pose.m]
        if missing:
            found = f"leaves out {', '.join(missing)}"
            yield ValidationIssue(("poses", name), found, "every joint once")


def _check_health(health: ArmHealth) -> Iterator[ValidationIssue]:
    stages = (("warn_c", health.warn_c), ("hold_c", health.hold_c), ("release_c", health.release_c))
    for (first, low), (then, high) in itertools.pairwise(stages):
        if not low <= high:
            yield ValidationIssue(("health", then), f"is {high}, below {first}", f"{low} or more")
    if health.low_v and health.high_v and health.low_v >= health.high_v:
        found = f"is {health.low_v}, not below high_v"
        yield ValidationIssue(("health", "low_v"), found, f"less than {health.high_v}")


def _check_gripper(gripper: ArmGripper, joints: Sequence[ArmJoint]) -> Iterator[ValidationIssue]:
    if not joints:
        if gripper != ArmGripper():
            yield ValidationIssue(
                ("gripper",), "is present", 'a joint with role = "gripper", or no [gripper]'
            )
        return
    slides = joints[0].is_prismatic
    motion, expected_key = ("slides", "width_m_by_m") if slides else ("turns", "width_m_by_deg")
    for key, pairs in (
        ("width_m_by_deg", gripper.width_m_by_deg),
        ("width_m_by_m", gripper.width_m_by_m),
    ):
        if pairs and key != expected_key:
            yield ValidationIssue(
                ("gripper", key), f"is set, but {joints[0].name} {motion}", expected_key
            )
            continue
        steps = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(pairs)]
        growing = all(first > 0 and second > 0 for first, second in steps)
        falling = all(first > 0 > second for first, second in steps)
        if pairs and not (steps and (growing or falling)):
            expected = "two or more pairs, both numbers rising, or one rising and one falling"
            yield ValidationIssue(("gripper", key), "is not monotonic", expected)


def read_arm_file(path: Path | str) -> ArmFile:
    """Read and check an ``arm.toml``; the URDF that it names is not opened.

    Raises:
        FileFormatError: ``where`` is the place of the TOML error, or the path of the key.
    """
    path = Path(path)
    arm = ArmFile.from_tables(read_toml(path), path, context={"folder": path.parent})
    issues: list[ValidationIssue] = []
    folder = catalogue_name(path)
    if folder is not None and folder != arm.name:
        expected = f"{quote(folder)}, like its folder"
        issues.append(ValidationIssue(("name",), f"is {quote(arm.name)}", expected))
    if path_inside(path.parent, arm.urdf) is None:
        expected = "a file in the arm's own folder"
        issues.append(ValidationIssue(("urdf",), f"is {quote(arm.urdf)}", expected))
    try:
        parse_frame(arm.base or "rotate 0")
    except BadValueError as error:
        found = f"is {quote(arm.base or '')}"
        issues.append(ValidationIssue(("base",), found, error.expected))
    issues += arm_file_issues(arm)
    if issues:
        raise first_issue(issues, path)
    return arm
