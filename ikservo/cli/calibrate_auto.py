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
    confirm_directions,
    execute_lift,
    making_room,
    plan_direction_check,
    room_m,
    run_direction_check,
)
from ikservo.model import Model

__all__ = ["calibrate_auto"]

_WARNING = (
    "The arm will drive every joint to its stops, slowly and with little force, and end in its "
    "rest pose. Clear its whole reach. Ctrl-C stops it; it then holds."
)


def calibrate_auto(
    model: Model, port: str | None, wishes: CalibrationOptions, script: Path | None
) -> None:
    """Take the pose, let the arm find its ranges, and save what was found.

    Raises:
        CalibrationError: The arm file forbids it, or a joint met what cannot be its stop.
        InputError: Nobody agreed.
        StoppedError: The person interrupted; the arm holds.
    """
    check_auto_allowed(model)
    check_options(model, wishes, script)
    _confirm_motion(wishes)
    with open_torque_off(model, port) as loose:
        disable_torque(loose, asks=wishes.asks, yes=wishes.yes)
        print_servos(loose, wishes.pose)
        kept = _offer_measured_joints(loose, wishes)
        wizard = with_known_ranges(_take_anchor_pose(loose, wishes, script), kept.travels)
        with restore_encoders(loose, print_status), _report_kept_joints(kept):
            auto = AutoCalibration(loose, wizard, wishes.pose, _print_progress, kept.add_joint)
            wizard = _run_auto_calibration(auto, wishes)
            outcome = review(loose, wizard, wishes.with_user_ranges(auto.partial_limits))
            path = loose.save(outcome)
        kept.remove_file()
        if wishes.asks:
            confirm_directions(model, loose.bus.port.name)  # each direction has just been agreed to
    print_result(outcome, wizard, path, json=wishes.json)


def _print_progress(words: str) -> None:
    print_status(words)


def _offer_measured_joints(loose: TorqueOffArm, wishes: CalibrationOptions) -> MeasuredRanges:
    """Return the joints that an interrupted run has measured, if the person wants to use them."""
    kept = MeasuredRanges(loose)
    if not kept.travels:
        return kept
    names = ", ".join(kept.travels)
    print_status(f"An interrupted run of {kept.written} measured {names}.")
    if confirm_start(
        "Use these, and measure only the other joints?", default=True, asks=wishes.asks
    ):
        print_status(f"They are not measured again; to measure all joints, remove {kept.path}.")
    else:
        kept.remove_file()
    return kept


@contextmanager
def _report_kept_joints(kept: MeasuredRanges) -> Generator[None]:
    """Say, where the run does not end well, which joints need not be measured again."""
    try:
        yield
    except BaseException:
        if kept.travels:
            print_status(
                f"Measured and kept for the next run: {', '.join(kept.travels)}. "
                "Put the arm into its pose and give the same command to go on with the others."
            )
        raise


def _confirm_motion(wishes: CalibrationOptions) -> None:
    print_status(_WARNING)
    if wishes.yes:
        return
    if not wishes.asks:
        raise InputError("Cannot ask: input is not a terminal.", "Give --yes.")
    if not confirm_start("May it begin?", default=False, asks=True):
        raise IkservoError("Nothing moved.")


def _take_anchor_pose(
    loose: TorqueOffArm, wishes: CalibrationOptions, script: Path | None
) -> CalibrationState:
    """Return the conversation once the arm has been held in its pose."""
    wizard = CalibrationState.begin(loose.make_subjects(wishes.pose), wishes.margin_rad)
    with (
        answer_source(script, yes=wishes.yes, ask=wishes.asks) as who,
        calibration_display(loose.model, wishes.pose) as shown,
    ):
        begun = apply_options(wizard, wishes.free, wishes.skip)
        return run_calibration(loose, begun, who, shown, (CalibrationStage.REFERENCE_POSE,))


def _run_auto_calibration(auto: AutoCalibration, wishes: CalibrationOptions) -> CalibrationState:
    """Let the arm find its ranges; a second Ctrl-C lowers it and lets go."""
    with second_interrupt_lowers(auto.arm):
        _show_directions(auto, wishes)
        auto.sweep()
        return auto.finish()


def _show_directions(auto: AutoCalibration, wishes: CalibrationOptions) -> None:
    """Move each joint a little, so that a mirrored sign or exchanged ids show before anything."""
    for joint in auto.arm.model.joints:
        _make_room(auto.arm, joint.name, wishes)
        motion = plan_direction_check(auto.arm, joint.name)
        print_status(f"{motion.joint} moves {motion.words}, then back.")
        run_direction_check(auto.arm, motion)
        _check_seen(auto.arm, motion, wishes)


def _make_room(arm: Arm, joint: str, wishes: CalibrationOptions) -> None:
    """Move other joints of a folded arm until one joint can go a little way and back.

    Raises:
        RefusedError: No motion of a single joint makes more room.
    """
    for _ in arm.model.joints:
        motion = making_room(arm, joint)
        if motion is None:
            break
        print_status(f"{motion.joint} moves {motion.words}, and stays there: {joint} needs room.")
        execute_lift(arm, motion)
        _check_seen(arm, motion, wishes)
    if room_m(arm, joint) < 0.0:
        raise RefusedError(
            f"{joint} cannot move by 5° without a collision; torque stays on.",
            "Nothing was saved. Begin in a pose with more room: "
            f"ikservo calibrate {arm.model.name} --auto --pose home",
        )


def _check_seen(arm: Arm, motion: DirectionCheck, wishes: CalibrationOptions) -> None:
    question = f"Did {motion.joint} move {motion.words}?"
    if not confirm_start(question, default=True, asks=wishes.asks):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            f"Calibrate it by hand, which finds signs: ikservo calibrate {arm.model.name}",
        )
