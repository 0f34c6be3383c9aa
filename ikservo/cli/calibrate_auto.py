"""``ikservo calibrate --auto``: the arm finds its joint ranges by itself."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ikservo.arm import Arm
from ikservo.calibration.procedure import CalibrationStage, CalibrationState
from ikservo.cli.calibrate_by_hand import (
    CalibrationOptions,
    answer_source,
    apply_options,
    check_options,
    print_result,
    review,
    run_calibration,
)
from ikservo.cli.calibrate_screen import (
    calibration_display,
    confirm_start,
    disable_torque,
    print_servos,
)
from ikservo.cli.session import second_interrupt_lowers
from ikservo.cli.terminal import print_status
from ikservo.errors import CalibrationError, IkservoError, InputError, RefusedError
from ikservo.maintenance.auto_calibration import AutoCalibration, check_auto_allowed
from ikservo.maintenance.auto_calibration_setup import (
    MeasuredRanges,
    restore_encoders,
    with_known_ranges,
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
    model: Model, port: str | None, options: CalibrationOptions, script: Path | None
) -> None:
    """Record the reference pose, let the arm find its ranges, and save the calibration.

    Raises:
        CalibrationError: The arm file forbids it, or a joint hit something that is not its stop.
        InputError: The user could not be asked to confirm.
        StoppedError: The user interrupted; the arm holds.
    """
    check_auto_allowed(model)
    check_options(model, options, script)
    _confirm_motion(options)
    with open_torque_off(model, port) as limp_arm:
        disable_torque(limp_arm, interactive=options.interactive, yes=options.yes)
        print_servos(limp_arm, options.pose)
        measured = _offer_measured_joints(limp_arm, options)
        state = with_known_ranges(_take_anchor_pose(limp_arm, options, script), measured.travels)
        with restore_encoders(limp_arm, print_status), _report_kept_joints(measured):
            auto = AutoCalibration(
                limp_arm, state, options.pose, _print_progress, measured.add_joint
            )
            state = _run_auto_calibration(auto, options)
            outcome = review(limp_arm, state, options.with_user_ranges(auto.partial_limits))
            path = limp_arm.save(outcome)
        measured.remove_file()
        if options.interactive:
            confirm_directions(
                model, limp_arm.bus.port.name
            )  # each direction has just been confirmed
    print_result(outcome, state, path, json=options.json)


def _print_progress(message: str) -> None:
    print_status(message)


def _offer_measured_joints(limp_arm: TorqueOffArm, options: CalibrationOptions) -> MeasuredRanges:
    """Return the ranges measured by an interrupted run, if the user wants to use them."""
    measured = MeasuredRanges(limp_arm)
    if not measured.travels:
        return measured
    names = ", ".join(measured.travels)
    print_status(f"An interrupted run of {measured.written} measured {names}.")
    if confirm_start(
        "Use these, and measure only the other joints?",
        default=True,
        interactive=options.interactive,
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


def _confirm_motion(options: CalibrationOptions) -> None:
    print_status(_WARNING)
    if options.yes:
        return
    if not options.interactive:
        raise InputError("Cannot ask: input is not a terminal.", "Give --yes.")
    if not confirm_start("May it begin?", default=False, interactive=True):
        raise IkservoError("Nothing moved.")


def _take_anchor_pose(
    limp_arm: TorqueOffArm, options: CalibrationOptions, script: Path | None
) -> CalibrationState:
    """Return the calibration state once the arm was held in its reference pose."""
    state = CalibrationState.begin(limp_arm.make_subjects(options.pose), options.margin_rad)
    with (
        answer_source(script, yes=options.yes, interactive=options.interactive) as answers,
        calibration_display(limp_arm.model, options.pose) as display,
    ):
        initial = apply_options(state, options.continuous, options.skip)
        return run_calibration(
            limp_arm, initial, answers, display, (CalibrationStage.REFERENCE_POSE,)
        )


def _run_auto_calibration(auto: AutoCalibration, options: CalibrationOptions) -> CalibrationState:
    """Let the arm find its ranges; a second Ctrl-C lowers it and switches torque off."""
    with second_interrupt_lowers(auto.arm):
        _show_directions(auto, options)
        auto.sweep()
        return auto.finish()


def _show_directions(auto: AutoCalibration, options: CalibrationOptions) -> None:
    """Move each joint a little, to detect a wrong sign or exchanged ids before anything else."""
    for joint in auto.arm.model.joints:
        _make_room(auto.arm, joint.name, options)
        motion = plan_direction_check(auto.arm, joint.name)
        print_status(f"{motion.joint} moves {motion.direction}, then back.")
        run_direction_check(auto.arm, motion)
        _check_seen(auto.arm, motion, options)


def _make_room(arm: Arm, joint: str, options: CalibrationOptions) -> None:
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
        _check_seen(arm, motion, options)
    if check_clearance_m(arm, joint) < 0.0:
        raise RefusedError(
            f"{joint} cannot move by 5° without a collision; torque stays on.",
            "Nothing was saved. Begin in a pose with more room: "
            f"ikservo calibrate {arm.model.name} --auto --pose home",
        )


def _check_seen(arm: Arm, motion: DirectionCheck, options: CalibrationOptions) -> None:
    question = f"Did {motion.joint} move {motion.direction}?"
    if not confirm_start(question, default=True, interactive=options.interactive):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            f"Calibrate it by hand, which finds signs: ikservo calibrate {arm.model.name}",
        )
