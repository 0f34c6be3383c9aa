"""Calibration in the browser: the dialogues of the command line, with their values as JSON."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing, contextmanager, suppress

from ikservo.apps.calibrating.auto_dialogue import calibrate_against_stops, confirm_search
from ikservo.apps.calibrating.by_hand_dialogue import (
    CalibrationOptions,
    calibrate_by_hand,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.calibrating.calibration_session import TorqueOffArm, open_torque_off
from ikservo.apps.page.dragging.snapshot import CalibrationView
from ikservo.arm import Arm, StopKind, StopReason
from ikservo.control.loop import OnCycle
from ikservo.errors import BusError, IkservoError, StoppedError
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
from ikservo.maintenance.direction_check import confirm_directions
from ikservo.model import Model
from ikservo.remedies import in_page

REFERENCE_POSE = "rest"
_BY_HAND = (
    "By hand: the arm goes limp; you hold it in its pose, then move each joint to both of its ends."
)
_AGAINST_STOPS = (
    "Against the stops: you hold the limp arm in its pose until it holds itself; then it drives "
    "each joint slowly to both of its stops, so its whole reach must be clear."
)
_BEFORE_CAMERA = (
    "Before a camera: a calibrated arm shows a printed board on its gripper to a camera, all over "
    "its reach. Begin it in a terminal: ikservo calibrate {} --camera 0"
)
_HOLDS = "held"  # the stage of an arm that was stopped in its search
_LEFT = StopReason(StopKind.CLIENT, "The calibration was left.")


class CalibrationDriver:
    """Runner of calibrations of one arm on one port.

    Args:
        model: The arm.
        port: The port of the arm, which must not be open elsewhere.
        pose: The named reference pose.

    Attributes:
        requested: Whether a calibration is requested.
        arm: The arm that a search for stops moves, or has moved; None before that.
        on_cycle: Called in each control cycle of a search.
        log_message: Receives messages for the user.
    """

    def __init__(self, model: Model, port: str | None, pose: str = REFERENCE_POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[tuple[str, int]] = deque(maxlen=8)
        self.requested = self._searches = False
        self.arm: Arm | None = None
        self.on_cycle: OnCycle | None = None
        self.log_message: Callable[[str], None] = lambda _: None

    @property
    def holds(self) -> bool:
        """Whether a search has switched torque on and it is still on."""
        arm = self.arm  # another thread may set it to None
        return arm is not None and not arm.context.servos.torque.is_off

    def request_start(self) -> None:
        """Request a calibration; safe from any thread."""
        self._answers.clear()
        self.requested = True

    def put_answer(self, answer: str, number: int) -> None:
        """Queue an answer that was given on a screen; thread-safe.

        An answer on an old screen is ignored; ``cancel`` ends the calibration on every screen.
        """
        if answer == "cancel":
            self.request_stop(_LEFT)
            self.requested = False
        self._answers.append((answer, number))

    def request_stop(self, reason: StopReason) -> None:
        """End a search for stops; a moving arm brakes and holds. Safe from any thread.

        A calibration by hand, in which the arm is limp, continues.
        """
        self.requested, arm = self.requested and not self._searches, self.arm
        if arm is not None:
            arm.request_stop(reason)

    def run(self) -> Generator[CalibrationView]:
        """Yield the view at each reading until the user ends the calibration.

        Raises:
            IkservoError: The servos do not reply, or nothing could be saved.
        """
        try:
            with (
                open_torque_off(self.model, self._port) as limp_arm,
                closing(self._calibrate(limp_arm)) as dialogue,
            ):
                yield from self._run_dialogue(limp_arm, dialogue)
        finally:
            self.requested, self._searches, self.arm = False, False, None

    def _run_dialogue(
        self, limp_arm: TorqueOffArm, dialogue: Dialogue[None]
    ) -> Generator[CalibrationView]:
        answer: str | None = None
        lines: tuple[str, ...] = ()
        request: HandRequest | None = None
        number, shown, why = 0, None, ""
        progress = Progress("Each joint moves slightly")
        while self.requested:
            try:
                item = dialogue.send(answer)
            except StopIteration:
                return
            except IkservoError as error:
                if not self._may_hold(limp_arm):
                    raise
                why = " ".join([error.message, *_page_hints(error)])
                break
            answer = None
            if isinstance(item, Notice | Progress):
                progress = item if isinstance(item, Progress) else progress
                lines = (*lines, item.text.strip()) if isinstance(item, Notice) else ()
                if self.holds:
                    yield CalibrationView(progress, request, lines, number)
                continue
            request = item if isinstance(item, HandRequest) else request
            screen = (item.stage, item.step) if isinstance(item, HandRequest) else item
            number, shown = number + (screen != shown), screen
            yield CalibrationView(item, request, lines, number)
            answer = self._next_answer(number)
            while isinstance(item, Question) and self.requested and not item.offers(answer):
                limp_arm.read_ticks()  # a lost servo raises at once
                yield CalibrationView(item, request, lines, number)
                answer = self._next_answer(number)
            if answer:
                lines = ()
        if self._may_hold(limp_arm):
            yield from self._release(limp_arm, why, number + 1)

    def _next_answer(self, number: int) -> str | None:
        while self._answers:
            answer, given_on = self._answers.popleft()
            if given_on == number:
                return answer
        return None

    def _calibrate(self, limp_arm: TorqueOffArm) -> Dialogue[None]:
        """Let the user choose how to calibrate the arm, calibrate it, and save the result."""
        forbidden = self.model.auto_unsafe
        yield Notice(_BY_HAND)
        yield Notice(f"Not against the stops: {forbidden}" if forbidden else _AGAINST_STOPS)
        yield Notice(_BEFORE_CAMERA.format(self.model.name))
        how = yield Question(
            "How do you want to calibrate the arm?", Unasked.YES, CalibrationStage.REFERENCE_POSE,
            "by hand", () if forbidden else (Choice("stops", "against the stops"),),
        )  # fmt: skip
        options = CalibrationOptions(self.pose, write_limits=False)
        self._searches = how == "stops"
        if self._searches:
            yield from confirm_search(self.model, "The Stop button")
        yield from switch_torque_off(limp_arm)
        if self._searches:
            path = (yield from calibrate_against_stops(
                limp_arm, options, self.log_message, self._attended
            ))[2]  # fmt: skip
            confirm_directions(self.model, limp_arm.bus.port.name)  # each was just confirmed
        else:
            path = limp_arm.save((yield from calibrate_by_hand(limp_arm, options))[1])
        yield Notice(str(path))
        yield Question("Saved.", Unasked.YES, CalibrationStage.SAVED, "back to the arm")

    @contextmanager
    def _attended(self, arm: Arm) -> Generator[None]:
        """Let pages watch and stop an arm that moves itself."""
        self.arm, arm.runner.loop.on_every_cycle = arm, self.on_cycle
        yield

    def _release(self, limp_arm: TorqueOffArm, why: str, number: int) -> Generator[CalibrationView]:
        """Let the user support an arm that holds, then switch its torque off."""
        text = why or ((self.arm and self.arm.stop_reason) or _LEFT).text
        self.log_message(text)
        text += " The arm holds now. Support it, then switch its torque off."
        question = Question(text, Unasked.YES, _HOLDS, "switch torque off")
        while self._may_hold(limp_arm):
            while self._next_answer(number) != ACCEPT:
                with suppress(BusError):  # a servo that is silent may reply again
                    limp_arm.read_ticks()
                yield CalibrationView(question, None, (), number)
            try:
                limp_arm.disable_torque()
            except BusError as error:
                self.log_message(error.message)

    def _may_hold(self, limp_arm: TorqueOffArm) -> bool:
        """Check whether a servo holds after a search; a silent one may hold."""
        try:
            return self._searches and bool(limp_arm.torque_on_servos())
        except BusError:
            return True


def _page_hints(error: IkservoError) -> list[str]:
    """Return the sentences of an error's hint that name no option of a command."""
    hint = "" if isinstance(error, StoppedError) else in_page(error.command_hint)
    return [each for each in re.split(r"(?<=[.!?]) ", hint) if each and "--" not in each]


def calibration_fields(view: CalibrationView) -> dict[str, object]:
    """Return a calibration as the page draws it."""
    item, request = view.item, view.request
    error, share, choices = "", None, tuple[Choice, ...]()
    if isinstance(item, HandRequest):
        error, choices = item.error_text, item.choices
    elif isinstance(item, Question):
        choices = (Choice(ACCEPT, item.label), *item.more)
    else:
        share = item.done / item.total if item.total else None
    if view.stage not in (CalibrationStage.SAVED, _HOLDS):
        choices = (*choices, Choice("cancel", "leave"))
    readings = (request.readings or ()) if request else ()
    return {
        "stage": view.stage,
        "number": view.number,
        "task": str(item) if isinstance(item, Progress) else item.text,
        "share": share,
        "moves": isinstance(item, Progress),
        "shows_pose": request is item and view.stage == CalibrationStage.REFERENCE_POSE,
        "lines": view.lines,
        "meters": [_readout_fields(each, current=each.name == request.current) for each in readings]
        if request and view.stage != CalibrationStage.SAVED
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
