"""The dialogue of a calibration against the stops: warning, pose, directions, search, review."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

from ikservo.apps.calibrating.auto_calibration import AutoCalibration, check_auto_allowed
from ikservo.apps.calibrating.auto_calibration_setup import MeasuredRanges, with_known_ranges
from ikservo.apps.calibrating.by_hand_dialogue import CalibrationOptions, record_ranges, review
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage, CalibrationState
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.arm.arm import Arm
from ikservo.errors import IkservoError
from ikservo.maintenance.dialogue import ACCEPT, Choice, Dialogue, Notice, Question, Unasked
from ikservo.model import Model

_WARNING = (
    "The arm will drive every joint to its stops, slowly and with little force, and end in its "
    "rest pose. Clear its whole reach. {stop} stops the arm, which then holds."
)


def confirm_search(model: Model, stop: str) -> Dialogue[None]:
    """Warn of the search, and ask whether to begin; ``stop`` names what stops the arm.

    Raises:
        CalibrationError: The arm file forbids the search.
        IkservoError: The user declined; nothing moved.
    """
    check_auto_allowed(model)
    yield Notice(_WARNING.format(stop=stop))
    stage = CalibrationStage.REFERENCE_POSE
    if (yield Question("Begin?", Unasked.ERROR, stage, "begin")) != ACCEPT:
        raise IkservoError("Nothing moved.")


def calibrate_against_stops(
    limp_arm: TorqueOffArm,
    options: CalibrationOptions,
    on_status: Callable[[str], None],
    attended: Callable[[Arm], AbstractContextManager[None]],
) -> Dialogue[tuple[CalibrationState, CalibrationResult, Path]]:
    """Record the pose of a limp arm, let it search for its stops, and save the calibration.

    ``on_status`` receives a line about what is kept after a failure; ``attended`` makes the context
    in which the arm moves itself. A failure leaves servos that ``restore_encoders`` restores.

    Returns:
        The last state, the saved result, and its file.

    Raises:
        CalibrationError: A joint hit something that is not its stop.
        StoppedError: The user stopped the arm, which holds.
    """
    measured = yield from _offer_measured_joints(limp_arm)
    pose_stage = (CalibrationStage.REFERENCE_POSE,)
    state = yield from record_ranges(limp_arm, options.begin(limp_arm), options.pose, pose_stage)
    state = with_known_ranges(state, measured.travels)
    with _report_kept_joints(measured, on_status):
        auto = AutoCalibration(limp_arm, state, options.pose, measured)
        with attended(auto.arm):
            state = yield from auto.run()
        narrowed = replace(options, user={**auto.partial_limits, **options.user})
        _, outcome = yield from review(limp_arm, state, narrowed, may_have_sagged=True)
        path = limp_arm.save(outcome)
    measured.remove_file()
    return state, outcome, path


def _offer_measured_joints(limp_arm: TorqueOffArm) -> Dialogue[MeasuredRanges]:
    """Return the ranges measured by an interrupted run, if the user wants to use them."""
    measured = MeasuredRanges(limp_arm)
    if not measured.travels:
        return measured
    yield Notice(
        f"An interrupted run from {measured.written} measured {', '.join(measured.travels)}."
    )
    question = "Use these results, and measure only the other joints?"
    no, stage = (Choice("no", "measure all"),), CalibrationStage.REFERENCE_POSE
    if (yield Question(question, Unasked.YES, stage, "use them", no)) == ACCEPT:
        path = measured.path
        yield Notice(f"These joints are not measured again; to measure all joints, remove {path}.")
    else:
        measured.remove_file()
    return measured


@contextmanager
def _report_kept_joints(
    measured: MeasuredRanges, on_status: Callable[[str], None]
) -> Generator[None]:
    """If the calibration fails, tell which joints need not be measured again."""
    try:
        yield
    except BaseException:
        if measured.travels:
            on_status(
                f"Measured and kept for the next run: {', '.join(measured.travels)}. "
                "To continue with the others, put the arm into its pose and calibrate again."
            )
        raise
