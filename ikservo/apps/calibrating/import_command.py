"""``ikservo import lerobot``: import a calibration from LeRobot for this arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Annotated

import typer

from ikservo.apps.calibrating.by_hand_dialogue import (
    check_zeros,
    confirm_saving,
    read_script,
    record_ranges,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibrate_by_hand import (
    print_result,
    print_servos,
    reporting_unchanged_state,
)
from ikservo.apps.calibrating.calibrate_command import Margin, Pose
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.apps.calibrating.calibration_session import (
    TorqueOffArm,
    lost_geometry_warning,
    open_torque_off,
)
from ikservo.apps.calibrating.lerobot_import import (
    check_lerobot_joints,
    lerobot_mismatches,
    lerobot_travels,
    with_lerobot_homing,
)
from ikservo.calibration.lerobot import LerobotJoint, find_lerobot, read_lerobot
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.terminal_dialogue import AnswerOptions
from ikservo.maintenance.dialogue import Dialogue, Notice

Source = Annotated[
    str, typer.Argument(metavar="ID|FILE", help="Id of the arm in LeRobot, or a file.")
]


def command(
    source: Source,
    *,
    connection: ServoConnection,
    pose: Pose = "rest",
    margin: Margin = 2.0,
    answers: AnswerOptions,
    json: JsonOption = False,
) -> None:
    """Import ids and ranges from LeRobot; zeros and signs are then measured in a pose.

    LeRobot's zero is the middle of the swept range, not the zero of the URDF.

    ikservo import lerobot my_arm --arm so101
    """
    model, port = model_from_option(connection.arm), connection.port
    joints = read_lerobot(find_lerobot(source))
    model.pose(pose)
    operator = answers.operator(read_script)
    with open_torque_off(model, port) as limp_arm:
        check_lerobot_joints(joints, model, limp_arm)
        operator.run(switch_torque_off(limp_arm))
        with reporting_unchanged_state():
            print_servos(limp_arm, pose)
            dialogue = _measure_and_review(limp_arm, joints, pose, math.radians(margin))
            state, outcome = operator.run(dialogue)
            saved = limp_arm.save(outcome)
    print_result(outcome, state, saved, json=json)


def _measure_and_review(
    limp_arm: TorqueOffArm, joints: Sequence[LerobotJoint], pose: str, margin_rad: float
) -> Dialogue[tuple[CalibrationState, CalibrationResult]]:
    """Measure the values that LeRobot's file lacks; return the last state and the result to save.

    The joints of the result are in LeRobot's order, so that it can be exported again.
    """
    subjects = limp_arm.make_subjects(pose, lerobot_travels(joints, limp_arm))
    free = frozenset(joint.name for joint in joints if joint.is_continuous)
    state = CalibrationState(subjects, margin_rad, free=free)
    state = yield from record_ranges(limp_arm, state, pose)
    yield from check_zeros(state, pose, limp_arm.model.name)
    for line in lerobot_mismatches(joints, limp_arm.facts):
        yield Notice(line)
    facts = with_lerobot_homing(joints, limp_arm.facts)
    outcome = limp_arm.build_calibration(state, pose, datetime.now(UTC), facts=facts)
    found = {joint.name: joint for joint in outcome.calibration.joints}
    ordered = tuple(found[joint.name] for joint in joints)
    calibration = outcome.calibration.model_copy(update={"joints": ordered})
    for line in lost_geometry_warning(limp_arm):
        yield Notice(f"  {line}")
    yield from confirm_saving(limp_arm, calibration)
    return state, replace(outcome, calibration=calibration)
