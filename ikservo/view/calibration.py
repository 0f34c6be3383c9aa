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
from ikservo.maintenance.arm_sketch import ascii_sketch
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
    """Holds calibrations of one arm on one port.

    Args:
        model: The arm.
        port: Its port; the arm itself must not hold it meanwhile.
        pose: The named pose that it is held in at first.

    Attributes:
        wanted: Whether there shall be a calibration now.
    """

    def __init__(self, model: Model, port: str | None, pose: str = REFERENCE_POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[str] = deque(maxlen=8)
        self.wanted = False

    def request_start(self) -> None:
        """Want a calibration; safe from any thread."""
        self._answers.clear()
        self.wanted = True

    def put_answer(self, word: str) -> None:
        """Say a word of ``ikservo.calibration.script``; safe from any thread.

        Besides, ``leave`` ends it, and ``protect`` saves and has the servos hold the limits, too.
        """
        if word == "leave":
            self.wanted = False
        self._answers.append(word)

    def run(self) -> Generator[CalibrationView]:
        """Yield the state of the conversation at each reading until the person leaves.

        Raises:
            IkservoError: The servos do not answer, or nothing could be saved.
        """
        try:
            with open_torque_off(self.model, self._port) as loose:
                yield from self._confirm_release(loose)
                yield from self._run_dialogue(loose)
        finally:
            self.wanted = False

    def _confirm_release(self, loose: TorqueOffArm) -> Generator[CalibrationView]:
        """Let the arm go limp, once the person says that it is held."""
        while self.wanted and loose.torque_on_servos():
            yield CalibrationView(None)
            if self._next_answer() == "accept":
                loose.disable_torque()
            loose.read_ticks()

    def _run_dialogue(self, loose: TorqueOffArm) -> Generator[CalibrationView]:
        talk = CalibrationView(CalibrationState.begin(loose.make_subjects(self.pose)))
        while self.wanted and talk.wizard is not None:
            reading = loose.read_ticks()
            wizard = talk.wizard
            if reading is not None and wizard.stage in (
                CalibrationStage.REFERENCE_POSE,
                CalibrationStage.SWEEP,
            ):
                talk = replace(talk, wizard=wizard.update(*reading))
            talk = self._apply_answer(loose, talk)
            yield talk

    def _apply_answer(self, loose: TorqueOffArm, talk: CalibrationView) -> CalibrationView:
        word, wizard = self._next_answer(), talk.wizard
        if not word or wizard is None or not wizard.tracks:
            return talk
        protect = word == "protect" and wizard.stage is CalibrationStage.REVIEW
        try:
            after = apply_answer(wizard, "accept" if protect else word)
        except (CalibrationError, InputError) as error:
            return replace(talk, complaint=f"{error.message} {error.command_hint}")
        if after.stage is CalibrationStage.SAVED and wizard.stage is CalibrationStage.REVIEW:
            return CalibrationView(
                after, saved_at=self._save_result(loose, wizard, protect=protect)
            )
        return (
            self._make_review(loose, after)
            if after.stage is CalibrationStage.REVIEW
            else CalibrationView(after)
        )

    def _make_review(self, loose: TorqueOffArm, wizard: CalibrationState) -> CalibrationView:
        """Return the review, with the warnings that the command line gives."""
        try:
            outcome = loose.build_calibration(wizard, self.pose, datetime.now(UTC))
        except CalibrationError as error:
            return CalibrationView(wizard, complaint=f"{error.message} {error.command_hint}")
        warnings = (*lost_geometry_warning(loose), *loose.register_limit_warnings(outcome))
        return CalibrationView(wizard, warnings=warnings)

    def _next_answer(self) -> str:
        return self._answers.popleft() if self._answers else ""

    def _save_result(self, loose: TorqueOffArm, wizard: CalibrationState, *, protect: bool) -> str:
        now = datetime.now(UTC)
        return str(
            loose.save(loose.build_calibration(wizard, self.pose, now, write_limits=protect))
        )


_ALLOWED_ANSWERS = {
    CalibrationStage.REFERENCE_POSE: ("accept", "leave"),
    CalibrationStage.REVIEW: ("accept", "protect", "undo", "leave"),
}
_RELEASE_TEXT = "Torque will be switched off; support the arm, then go on."


def calibration_view(
    model: Model, talk: CalibrationView, pose: str = REFERENCE_POSE
) -> dict[str, object]:
    """Return a conversation that began in a pose as the page draws it."""
    wizard = talk.wizard
    stage = CalibrationStage.REFERENCE_POSE if wizard is None else wizard.stage
    swept = wizard is not None and stage in (CalibrationStage.SWEEP, CalibrationStage.REVIEW)
    return {
        "stage": stage.value,
        "task": _RELEASE_TEXT if wizard is None else _format_task(model, wizard, pose),
        "sketch": "\n".join(_sketch_lines(model))
        if stage is CalibrationStage.REFERENCE_POSE
        else "",
        "lines": _format_lines(talk),
        "meters": [_joint_readout_fields(wizard, meter) for meter in joint_readouts(wizard)]
        if wizard and swept
        else [],
        "complaint": talk.complaint,
        "may": _ALLOWED_ANSWERS.get(stage, ("accept", "undo", "leave")),
    }


def _format_task(model: Model, wizard: CalibrationState, pose: str) -> str:
    if wizard.stage is CalibrationStage.REFERENCE_POSE:
        state = "It is held still." if wizard.is_at_rest else "It still moves …"
        return f"Put the arm in the pose “{pose}” and hold it. {state}"
    if wizard.current_joint:
        return current_step(model, pose, wizard).request
    if wizard.stage is CalibrationStage.SWEEP:
        return "Now move every joint gently to both of its ends."
    return (
        "Are these the ranges of the arm?" if wizard.stage is CalibrationStage.REVIEW else "Saved."
    )


def _format_lines(talk: CalibrationView) -> list[str]:
    if talk.wizard is None:
        return []
    if talk.wizard.stage is CalibrationStage.REVIEW:
        return [*warnings(talk.wizard), *talk.warnings]
    return [talk.saved_at] if talk.saved_at else []


def _sketch_lines(model: Model) -> list[str]:
    return ascii_sketch(model, model.joints[-1].name)[:-1]


def _joint_readout_fields(wizard: CalibrationState, meter: JointReadout) -> dict[str, object]:
    expected = meter.subject.expected
    low, high = expected.lower.value, expected.upper.value
    say = meter.subject.joint_map.format

    def share(position: float) -> float:
        return round(min(1.0, max(0.0, (position - low) / (high - low))), 3)

    moved = meter.state is not JointProgress.UNMOVED
    return {
        "name": meter.name,
        "asked": wizard.current_joint is meter.subject,
        "state": meter.state.value,
        "share": share(meter.position),
        "swept": [share(meter.low), share(meter.high)],
        "text": f"{say(meter.low)} … {say(meter.high)}" if moved else "",
    }
