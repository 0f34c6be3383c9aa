"""Calibration in the browser: the same state machine as on a terminal."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from dataclasses import replace
from datetime import UTC, datetime

from ikservo.calibration.procedure import (
    CalibrationStage,
    CalibrationState,
    JointProgress,
    JointReadout,
    joint_readouts,
    warnings,
)
from ikservo.calibration.script import apply_answer
from ikservo.errors import CalibrationError, InputError
from ikservo.maintenance.calibration_session import (
    TorqueOffArm,
    lost_geometry_warning,
    open_torque_off,
)
from ikservo.maintenance.calibration_steps import current_step
from ikservo.model import Model
from ikservo.view.snapshot import CalibrationView

__all__ = ["REFERENCE_POSE", "CalibrationDriver", "calibration_view"]


REFERENCE_POSE = "rest"


class CalibrationDriver:
    """Runs calibrations of one arm on one port.

    Args:
        model: The arm.
        port: Its port; must not be open elsewhere meanwhile.
        pose: The named reference pose.

    Attributes:
        requested: Whether a calibration shall run now.
    """

    def __init__(self, model: Model, port: str | None, pose: str = REFERENCE_POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[str] = deque(maxlen=8)
        self.requested = False

    def request_start(self) -> None:
        """Request a calibration; safe from any thread."""
        self._answers.clear()
        self.requested = True

    def put_answer(self, answer: str) -> None:
        """Queue an answer of ``ikservo.calibration.script``; safe from any thread.

        In addition, ``cancel`` ends the calibration, and ``protect`` saves it and writes the
        limits into the servos.
        """
        if answer == "cancel":
            self.requested = False
        self._answers.append(answer)

    def run(self) -> Generator[CalibrationView]:
        """Yield the state at each reading until the user ends the calibration.

        Raises:
            IkservoError: The servos do not reply, or nothing could be saved.
        """
        try:
            with open_torque_off(self.model, self._port) as arm:
                yield from self._confirm_release(arm)
                yield from self._run_dialogue(arm)
        finally:
            self.requested = False

    def _confirm_release(self, arm: TorqueOffArm) -> Generator[CalibrationView]:
        """Disable torque once the user confirms that the arm is supported."""
        while self.requested and arm.torque_on_servos():
            yield CalibrationView(None)
            if self._next_answer() == "accept":
                arm.disable_torque()
            arm.read_ticks()

    def _run_dialogue(self, arm: TorqueOffArm) -> Generator[CalibrationView]:
        view = CalibrationView(CalibrationState.begin(arm.make_subjects(self.pose)))
        while self.requested and view.state is not None:
            reading = arm.read_ticks()
            state = view.state
            if reading is not None and state.stage in (
                CalibrationStage.REFERENCE_POSE,
                CalibrationStage.SWEEP,
            ):
                view = replace(view, state=state.update(*reading))
            view = self._apply_answer(arm, view)
            yield view

    def _apply_answer(self, arm: TorqueOffArm, view: CalibrationView) -> CalibrationView:
        answer, state = self._next_answer(), view.state
        if not answer or state is None or not state.tracks:
            return view
        protect = answer == "protect" and state.stage is CalibrationStage.REVIEW
        try:
            next_state = apply_answer(state, "accept" if protect else answer)
        except (CalibrationError, InputError) as error:
            return replace(view, error=f"{error.message} {error.command_hint}")
        if next_state.stage is CalibrationStage.SAVED and state.stage is CalibrationStage.REVIEW:
            return CalibrationView(
                next_state, saved_at=self._save_result(arm, state, protect=protect)
            )
        return (
            self._make_review(arm, next_state)
            if next_state.stage is CalibrationStage.REVIEW
            else CalibrationView(next_state)
        )

    def _make_review(self, arm: TorqueOffArm, state: CalibrationState) -> CalibrationView:
        """Return the review, with the same warnings as on the command line."""
        try:
            outcome = arm.build_calibration(state, self.pose, datetime.now(UTC))
        except CalibrationError as error:
            return CalibrationView(state, error=f"{error.message} {error.command_hint}")
        warnings = (*lost_geometry_warning(arm), *arm.register_limit_warnings(outcome))
        return CalibrationView(state, warnings=warnings)

    def _next_answer(self) -> str:
        return self._answers.popleft() if self._answers else ""

    def _save_result(self, arm: TorqueOffArm, state: CalibrationState, *, protect: bool) -> str:
        now = datetime.now(UTC)
        return str(arm.save(arm.build_calibration(state, self.pose, now, write_limits=protect)))


_ALLOWED_ANSWERS = {
    CalibrationStage.REFERENCE_POSE: ("accept", "cancel"),
    CalibrationStage.REVIEW: ("accept", "protect", "undo", "cancel"),
}
_RELEASE_TEXT = "Torque will be switched off; support the arm, then continue."


def calibration_view(
    model: Model, view: CalibrationView, pose: str = REFERENCE_POSE
) -> dict[str, object]:
    """Return a calibration as the page draws it; ``pose`` is its reference pose."""
    state = view.state
    stage = CalibrationStage.REFERENCE_POSE if state is None else state.stage
    has_ranges = state is not None and stage in (CalibrationStage.SWEEP, CalibrationStage.REVIEW)
    return {
        "stage": stage.value,
        "task": _RELEASE_TEXT if state is None else _format_task(model, state, pose),
        "lines": _format_lines(view),
        "meters": [_joint_readout_fields(state, meter) for meter in joint_readouts(state)]
        if state and has_ranges
        else [],
        "error": view.error,
        "allowed": _ALLOWED_ANSWERS.get(stage, ("accept", "undo", "cancel")),
    }


def _format_task(model: Model, state: CalibrationState, pose: str) -> str:
    if state.stage is CalibrationStage.REFERENCE_POSE:
        stillness = "It is still: go on." if state.is_at_rest else "It still moves …"
        return f"Put the arm in the pose “{pose}”, as the ghost beside it, and hold it. {stillness}"
    if state.current_joint:
        return current_step(model, pose, state).request
    if state.stage is CalibrationStage.SWEEP:
        return "Now move every joint gently to both of its ends."
    return (
        "Are these the ranges of the arm?" if state.stage is CalibrationStage.REVIEW else "Saved."
    )


def _format_lines(view: CalibrationView) -> list[str]:
    if view.state is None:
        return []
    if view.state.stage is CalibrationStage.REVIEW:
        return [*warnings(view.state), *view.warnings]
    return [view.saved_at] if view.saved_at else []


def _joint_readout_fields(state: CalibrationState, meter: JointReadout) -> dict[str, object]:
    expected = meter.subject.expected
    low, high = expected.lower.value, expected.upper.value
    format_value = meter.subject.joint_map.format

    def to_fraction(position: float) -> float:
        return round(min(1.0, max(0.0, (position - low) / (high - low))), 3)

    moved = meter.state is not JointProgress.UNMOVED
    return {
        "name": meter.name,
        "current": state.current_joint is meter.subject,
        "state": meter.state.value,
        "fraction": to_fraction(meter.position),
        "recorded": [to_fraction(meter.low), to_fraction(meter.high)],
        "text": f"{format_value(meter.low)} … {format_value(meter.high)}" if moved else "",
    }
