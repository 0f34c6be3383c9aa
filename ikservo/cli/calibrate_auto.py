"""``ikservo calibrate --auto``: the arm finds its joint ranges by itself."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ikservo.arm import Arm
from ikservo.calibration.procedure import CalibrationStage, CalibrationState
from ikservo.cli.calibrate_by_hand import print_result
from ikservo.cli.calibrate_screen import confirm_start, print_servos
from ikservo.cli.dialogue import Operator
from ikservo.cli.session import second_interrupt_lowers
from ikservo.cli.terminal import print_status
from ikservo.errors import CalibrationError, IkservoError, InputError, RefusedError
from ikservo.maintenance.auto_calibration import AutoCalibration, check_auto_allowed
from ikservo.maintenance.auto_calibration_setup import (
    MeasuredRanges,
    restore_encoders,
    with_known_ranges,
)
from ikservo.maintenance.calibration_dialogue import (
    CalibrationOptions,
    record_ranges,
    review,
    switch_torque_off,
)
from ikservo.maintenance.calibration_session import TorqueOffArm, open_torque_off
from ikservo.maintenance.direction_check import (
    DirectionCheck,
    check_clearance_m,
    confirm_directions,
    execute_lift,
    plan_clearance,
    plan_direction_check,
    run_direction_check,
)
from ikservo.model import Model

__all__ = ["calibrate_auto"]

_WARNING = (
    "The arm will drive every joint to its stops, slowly and with little force, and end in its "
    "rest pose. Clear its whole reach. Ctrl-C stops it; it then holds."
)


def calibrate_auto(
    model: Model,
    port: str | None,
    options: CalibrationOptions,
    operator: Operator,
    *,
    json: bool,
) -> None:
    """Record the reference pose, let the arm find its ranges, and save the calibration.

    Raises:
        CalibrationError: The arm file forbids it, or a joint hit something that is not its stop.
        InputError: The user could not be asked to confirm.
        StoppedError: The user interrupted; the arm holds.
    """
    check_auto_allowed(model)
    options.check(model)
    _confirm_motion(operator)
    with open_torque_off(model, port) as limp_arm:
        operator.run(switch_torque_off(limp_arm))
        print_servos(limp_arm, options.pose)
        measured = _offer_measured_joints(limp_arm, operator)
        pose_stage = (CalibrationStage.REFERENCE_POSE,)
        state = operator.run(
            record_ranges(limp_arm, options.begin(limp_arm), options.pose, pose_stage)
        )
        state = with_known_ranges(state, measured.travels)
        with restore_encoders(limp_arm, print_status), _report_kept_joints(measured):
            auto = AutoCalibration(limp_arm, state, options.pose, print_status, measured.add_joint)
            state = _run_auto_calibration(auto, operator)
            narrowed = options.with_user_ranges(auto.partial_limits)
            _, outcome = operator.run(review(limp_arm, state, narrowed))
            path = limp_arm.save(outcome)
        measured.remove_file()
        if operator.interactive:
            confirm_directions(
                model, limp_arm.bus.port.name
            )  # each direction has just been confirmed
    print_result(outcome, state, path, json=json)


def _offer_measured_joints(limp_arm: TorqueOffArm, operator: Operator) -> MeasuredRanges:
    """Return the ranges measured by an interrupted run, if the user wants to use them."""
    measured = MeasuredRanges(limp_arm)
    if not measured.travels:
        return measured
    names = ", ".join(measured.travels)
    print_status(f"An interrupted run of {measured.written} measured {names}.")
    if confirm_start(
        "Use these, and measure only the other joints?",
        default=True,
        interactive=operator.interactive,
    ):
        print_status(f"They are not measured again; to measure all joints, remove {measured.path}.")
    else:
        measured.remove_file()
    return measured


@contextmanager
def _report_kept_joints(measured: MeasuredRanges) -> Generator[None]:
    """On failure, print which joints need not be measured again."""
    try:
        yield
    except BaseException:
        if measured.travels:
            print_status(
                f"Measured and kept for the next run: {', '.join(measured.travels)}. "
                "Put the arm into its pose and give the same command to continue with the others."
            )
        raise


def _confirm_motion(operator: Operator) -> None:
    print_status(_WARNING)
    if operator.yes:
        return
    if not operator.interactive:
        raise InputError("Cannot ask: input is not a terminal.", "Give --yes.")
    if not confirm_start("May it begin?", default=False, interactive=True):
        raise IkservoError("Nothing moved.")


def _run_auto_calibration(auto: AutoCalibration, operator: Operator) -> CalibrationState:
    """Let the arm find its ranges; a second Ctrl-C lowers it and switches torque off."""
    with second_interrupt_lowers(auto.arm):
        _show_directions(auto, operator)
        auto.sweep()
        return auto.finish()


def _show_directions(auto: AutoCalibration, operator: Operator) -> None:
    """Move each joint a little, to detect a wrong sign or exchanged ids before anything else."""
    for joint in auto.arm.model.joints:
        _make_room(auto.arm, joint.name, operator)
        motion = plan_direction_check(auto.arm, joint.name)
        print_status(f"{motion.joint} moves {motion.direction}, then back.")
        run_direction_check(auto.arm, motion)
        _check_seen(auto.arm, motion, operator)


def _make_room(arm: Arm, joint: str, operator: Operator) -> None:
    """Move other joints of a folded arm until one joint is free to move a little.

    Raises:
        RefusedError: No motion of a single joint increases the clearance.
    """
    for _ in arm.model.joints:
        motion = plan_clearance(arm, joint)
        if motion is None:
            break
        print_status(
            f"{motion.joint} moves {motion.direction}, and stays there: "
            f"it is in the way of {joint}."
        )
        execute_lift(arm, motion)
        _check_seen(arm, motion, operator)
    if check_clearance_m(arm, joint) < 0.0:
        raise RefusedError(
            f"{joint} cannot move by 5° without a collision; torque stays on.",
            "Nothing was saved. Begin in a pose with more room: "
            f"ikservo calibrate {arm.model.name} --auto --pose home",
        )


def _check_seen(arm: Arm, motion: DirectionCheck, operator: Operator) -> None:
    question = f"Did {motion.joint} move {motion.direction}?"
    if not confirm_start(question, default=True, interactive=operator.interactive):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            f"Calibrate it by hand, which finds signs: ikservo calibrate {arm.model.name}",
        )
