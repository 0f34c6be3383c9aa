"""``ikservo calibrate --auto``: the arm finds its joint ranges by itself."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace

from ikservo.apps.calibrating.auto_calibration import AutoCalibration, check_auto_allowed
from ikservo.apps.calibrating.auto_calibration_setup import (
    MeasuredRanges,
    restore_encoders,
    with_known_ranges,
)
from ikservo.apps.calibrating.by_hand_dialogue import (
    CalibrationOptions,
    record_ranges,
    review,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.calibrating.calibrate_by_hand import print_result, print_servos
from ikservo.apps.calibrating.calibration_session import TorqueOffArm, open_torque_off
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.cli.terminal import print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError
from ikservo.maintenance.dialogue import ACCEPT, Dialogue, Notice, Question, Unasked
from ikservo.maintenance.direction_check import confirm_directions
from ikservo.model import Model

_WARNING = (
    "The arm will drive every joint to its stops, slowly and with little force, and end in its "
    "rest pose. Clear its whole reach. Ctrl-C stops the arm, which then holds."
)


def calibrate_auto(
    model: Model, port: str | None, options: CalibrationOptions, operator: Operator, *, json: bool
) -> None:
    """Record the reference pose, let the arm find its ranges, and save the calibration.

    Raises:
        CalibrationError: The arm file forbids it, or a joint hit something that is not its stop.
        InputError: The user could not be asked for confirmation.
        StoppedError: The user interrupted; the arm holds.
    """
    check_auto_allowed(model)
    options.check(model)
    print_status(_WARNING)
    if not operator.agrees(Question("Begin?", Unasked.ERROR)):
        raise IkservoError("Nothing moved.")
    with open_torque_off(model, port) as limp_arm:
        operator.run(switch_torque_off(limp_arm))
        print_servos(limp_arm, options.pose)
        measured = operator.run(_offer_measured_joints(limp_arm))
        pose_stage = (CalibrationStage.REFERENCE_POSE,)
        state = operator.run(
            record_ranges(limp_arm, options.begin(limp_arm), options.pose, pose_stage)
        )
        state = with_known_ranges(state, measured.travels)
        with (
            exiting_on_signals(),
            restore_encoders(limp_arm, print_status),
            _report_kept_joints(measured),
        ):
            auto = AutoCalibration(limp_arm, state, options.pose, measured)
            with second_interrupt_lowers(auto.arm):
                state = operator.run(auto.run())
            narrowed = replace(options, user={**auto.partial_limits, **options.user})
            _, outcome = operator.run(review(limp_arm, state, narrowed, may_have_sagged=True))
            path = limp_arm.save(outcome)
        measured.remove_file()
        if operator.interactive:
            # Each direction has just been confirmed.
            confirm_directions(model, limp_arm.bus.port.name)
    print_result(outcome, state, path, json=json)


def _offer_measured_joints(limp_arm: TorqueOffArm) -> Dialogue[MeasuredRanges]:
    """Return the ranges measured by an interrupted run, if the user wants to use them."""
    measured = MeasuredRanges(limp_arm)
    if not measured.travels:
        return measured
    yield Notice(
        f"An interrupted run from {measured.written} measured {', '.join(measured.travels)}."
    )
    if (
        yield Question("Use these results, and measure only the other joints?", Unasked.YES)
    ) == ACCEPT:
        path = measured.path
        yield Notice(f"These joints are not measured again; to measure all joints, remove {path}.")
    else:
        measured.remove_file()
    return measured


@contextmanager
def _report_kept_joints(measured: MeasuredRanges) -> Generator[None]:
    """If the calibration fails, print which joints need not be measured again."""
    try:
        yield
    except BaseException:
        if measured.travels:
            print_status(
                f"Measured and kept for the next run: {', '.join(measured.travels)}. "
                "To continue with the others, put the arm into its pose and run this command again."
            )
        raise
