"""Calibration in the browser: the dialogue of the command line, with its values as JSON."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from contextlib import closing

from ikservo.apps.calibrating.by_hand_dialogue import (
    CalibrationOptions,
    calibrate_by_hand,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.calibrating.calibration_session import TorqueOffArm, open_torque_off
from ikservo.apps.page.dragging.snapshot import CalibrationView
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Choice,
    Dialogue,
    HandRequest,
    JointProgress,
    JointReadout,
    Notice,
    Progress,
    Question,
    Unasked,
)
from ikservo.model import Model

REFERENCE_POSE = "rest"


class CalibrationDriver:
    """Runner of calibrations of one arm on one port.

    Args:
        model: The arm.
        port: The port of the arm, which must not be open elsewhere.
        pose: The named reference pose.

    Attributes:
        requested: Whether a calibration is requested.
    """

    def __init__(self, model: Model, port: str | None, pose: str = REFERENCE_POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[tuple[str, int]] = deque(maxlen=8)
        self.requested = False

    def request_start(self) -> None:
        """Request a calibration; safe from any thread."""
        self._answers.clear()
        self.requested = True

    def put_answer(self, answer: str, number: int) -> None:
        """Queue an answer that was given on a screen; thread-safe.

        An answer on an old screen is ignored; ``cancel`` ends the calibration on every screen.
        """
        if answer == "cancel":
            self.requested = False
        self._answers.append((answer, number))

    def run(self) -> Generator[CalibrationView]:
        """Yield the view at each reading until the user ends the calibration.

        Raises:
            IkservoError: The servos do not reply, or nothing could be saved.
        """
        try:
            with (
                open_torque_off(self.model, self._port) as arm,
                closing(_calibrate(arm, self.pose)) as dialogue,
            ):
                yield from self._run_dialogue(arm, dialogue)
        finally:
            self.requested = False

    def _run_dialogue(
        self, arm: TorqueOffArm, dialogue: Dialogue[None]
    ) -> Generator[CalibrationView]:
        answer: str | None = None
        lines: tuple[str, ...] = ()
        request: HandRequest | None = None
        number, shown = 0, None
        while self.requested:
            try:
                item = dialogue.send(answer)
            except StopIteration:
                return
            answer = None
            if isinstance(item, Notice | Progress):
                lines = (*lines, item.text.strip())
                continue
            request = item if isinstance(item, HandRequest) else request
            screen = (item.stage, item.step) if isinstance(item, HandRequest) else item
            number, shown = number + (screen != shown), screen
            yield CalibrationView(item, request, lines, number)
            answer = self._next_answer(number)
            while isinstance(item, Question) and self.requested and not item.offers(answer):
                arm.read_ticks()  # a lost servo raises at once
                yield CalibrationView(item, request, lines, number)
                answer = self._next_answer(number)
            if answer:
                lines = ()

    def _next_answer(self, number: int) -> str | None:
        while self._answers:
            answer, given_on = self._answers.popleft()
            if given_on == number:
                return answer
        return None


def _calibrate(arm: TorqueOffArm, pose: str) -> Dialogue[None]:
    """Calibrate an arm by hand and save the result."""
    yield from switch_torque_off(arm)
    options = CalibrationOptions(pose, write_limits=False)
    _, outcome = yield from calibrate_by_hand(arm, options)
    yield Notice(str(arm.save(outcome)))
    yield Question("Saved.", Unasked.YES, CalibrationStage.SAVED, "back to the arm")


def calibration_fields(view: CalibrationView) -> dict[str, object]:
    """Return a calibration as the page draws it."""
    item, request = view.item, view.request
    if isinstance(item, HandRequest):
        error, choices = item.error_text, item.choices
    else:
        error, choices = "", (Choice(ACCEPT, item.label), *item.more)
    if item.stage != CalibrationStage.SAVED:
        choices = (*choices, Choice("cancel", "leave"))
    readings = (request.readings or ()) if request else ()
    return {
        "stage": item.stage,
        "number": view.number,
        "task": item.text,
        "shows_pose": isinstance(item, HandRequest)
        and item.stage == CalibrationStage.REFERENCE_POSE,
        "lines": view.lines,
        "meters": [_readout_fields(each, current=each.name == request.current) for each in readings]
        if request and item.stage != CalibrationStage.SAVED
        else [],
        "error": error,
        "choices": [
            {
                "answer": choice.answer,
                "label": choice.label[:1].upper() + choice.label[1:],
                "joints": choice.joints,
            }
            for choice in choices
        ],
    }


def _readout_fields(readout: JointReadout, *, current: bool) -> dict[str, object]:
    low, high = readout.subject.expected.lower.value, readout.subject.expected.upper.value
    format_value = readout.subject.joint_map.format

    def to_fraction(position: float) -> float:
        return round(min(1.0, max(0.0, (position - low) / (high - low))), 3)

    moved = readout.state is not JointProgress.UNMOVED
    return {
        "name": readout.name,
        "current": current,
        "state": readout.state.value,
        "fraction": to_fraction(readout.position),
        "recorded": [to_fraction(readout.low), to_fraction(readout.high)],
        "text": f"{format_value(readout.low)} … {format_value(readout.high)}" if moved else "",
    }
