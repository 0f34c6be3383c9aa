"""Calibration in the browser: the dialogues of the command line, with their values as JSON."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from typing import TypeAlias

from ikservo.apps.calibrating.auto_dialogue import calibrate_against_stops, confirm_search
from ikservo.apps.calibrating.by_hand_dialogue import (
    CalibrationOptions,
    calibrate_by_hand,
    switch_torque_off,
)
from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.calibrating.calibration_session import TorqueOffArm, open_torque_off
from ikservo.apps.cameras.board_detection import PictureSource
from ikservo.apps.cameras.camera_dialogue import (
    calibrate_with_camera,
    describe_result,
    kept_until_saved,
    save_result,
)
from ikservo.apps.page.dragging.snapshot import CalibrationView
from ikservo.arm import Arm, StopKind, StopReason
from ikservo.cli.camera_options import CameraOptions
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
_WITH_CAMERA = (
    "With a camera: a calibrated arm shows a printed board on its gripper to the camera of this "
    "page, all over its reach, which must be clear. To make the board: ikservo camera board"
)
_NO_CAMERA = "Not with a camera: this page has none. Add one: ikservo view {} --camera 0"
_CAMERA = "camera"
_SAVE = Question("Save this?", Unasked.YES, CalibrationStage.REVIEW, "save")
_SAVED = Question("Saved.", Unasked.YES, CalibrationStage.SAVED, "back to the arm")
_HOLDS = "held"  # the stage of an arm that was stopped in its search
_LEFT = StopReason(StopKind.CLIENT, "The calibration was cancelled.")
OpenCamera: TypeAlias = Callable[[], AbstractContextManager[tuple[PictureSource, CameraOptions]]]


class CalibrationDriver:
    """Runner of calibrations of one arm on one port.

    Args:
        model: The arm.
        port: The port of the arm, which must not be open elsewhere.
        pose: The named reference pose.

    Attributes:
        requested: Whether a calibration is requested.
        arm: The arm that a calibration moves, or has moved; None before that.
        on_cycle: Called in each control cycle of a calibration.
        on_wait: Called repeatedly while an arm in front of a camera waits for an answer.
        log_message: Receives messages for the user.
        open_arm: Opens the arm for a calibration with a camera, which does not close it.
        open_camera: Opens the camera of the page; None if it has none.
    """

    def __init__(self, model: Model, port: str | None, pose: str = REFERENCE_POSE) -> None:
        self.model, self._port, self.pose = model, port, pose
        self._answers: deque[tuple[str, int]] = deque(maxlen=8)
        self._number = 0  # of the screen
        self.requested = self._is_by_hand = self._searches = False
        self.arm: Arm | None = None
        self.on_cycle: OnCycle | None = None
        self.on_wait: Callable[[], None] = lambda: None
        self.log_message: Callable[[str], None] = lambda _: None
        self.open_arm: Callable[[], Arm] | None = None
        self.open_camera: OpenCamera | None = None

    @property
    def holds(self) -> bool:
        """Whether a calibration has switched torque on and it is still on."""
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
        """End the calibration; a moving arm brakes and holds. Safe from any thread.

        A calibration by hand, in which the arm is limp, continues.
        """
        self.requested, arm = self.requested and self._is_by_hand, self.arm
        if arm is not None:
            arm.request_stop(reason)

    def run(self) -> Generator[CalibrationView]:
        """Yield the view at each reading until the user ends the calibration.

        Raises:
            IkservoError: The servos do not reply, or nothing could be saved.
            StoppedError: The arm was stopped in a calibration with a camera; it holds.
        """
        self._number = 0
        try:
            with (
                open_torque_off(self.model, self._port) as limp_arm,
                closing(self._calibrate(limp_arm)) as dialogue,
            ):
                how = yield from self._run_dialogue(dialogue, limp_arm)
            if how == _CAMERA and self.open_arm and self.open_camera:
                with closing(self._show_board(self.open_arm(), self.open_camera)) as dialogue:
                    yield from self._run_dialogue(dialogue)
        finally:
            self.requested = self._is_by_hand = self._searches = False
            self.arm = None

    def _run_dialogue(
        self, dialogue: Dialogue[str | None], limp_arm: TorqueOffArm | None = None
    ) -> Generator[CalibrationView, None, str | None]:
        """Run a dialogue to its end; an error ends a calibration without a limp arm."""
        answer: str | None = None
        lines: tuple[str, ...] = ()
        request: HandRequest | None = None
        shown, why, read = None, "", limp_arm.read_ticks if limp_arm else self.on_wait
        progress: Progress | None = None
        while self.requested:
            try:
                item = dialogue.send(answer)
            except StopIteration as end:
                return end.value
            except IkservoError as error:
                if limp_arm is None or not self._may_hold(limp_arm):
                    raise
                why = " ".join([error.message, *_page_hints(error)])
                break
            answer = None
            if isinstance(item, Notice | Progress):
                progress = item if isinstance(item, Progress) else progress
                lines = (*lines, item.text.strip()) if isinstance(item, Notice) else ()
                if progress is not None and (limp_arm is None or self.holds):
                    yield CalibrationView(progress, request, lines, self._number)
                continue
            request = item if isinstance(item, HandRequest) else request
            screen = (item.stage, item.step) if isinstance(item, HandRequest) else item
            self._number, shown = self._number + (screen != shown), screen
            yield CalibrationView(item, request, lines, self._number)
            answer = self._next_answer(self._number)
            while isinstance(item, Question) and self.requested and not item.offers(answer):
                read()  # a lost servo raises at once
                yield CalibrationView(item, request, lines, self._number)
                answer = self._next_answer(self._number)
            if answer:
                lines = ()
        if limp_arm is not None and self._may_hold(limp_arm):
            yield from self._release(limp_arm, why, self._number + 1)
        return None

    def _next_answer(self, number: int) -> str | None:
        while self._answers:
            answer, given_on = self._answers.popleft()
            if given_on == number:
                return answer
        return None

    def _calibrate(self, limp_arm: TorqueOffArm) -> Dialogue[str]:
        """Let the user choose how to calibrate the arm; calibrate it, unless with a camera."""
        forbidden = self.model.auto_unsafe
        yield Notice(_BY_HAND)
        yield Notice(f"Not against the stops: {forbidden}" if forbidden else _AGAINST_STOPS)
        yield Notice(_WITH_CAMERA if self.open_camera else _NO_CAMERA.format(self.model.name))
        stops, camera = Choice("stops", "against the stops"), Choice(_CAMERA, "with a camera")
        how = yield Question(
            "How do you want to calibrate the arm?", Unasked.YES, CalibrationStage.REFERENCE_POSE,
            "by hand", (*(() if forbidden else (stops,)), *((camera,) if self.open_camera else ())),
        )  # fmt: skip
        if how == _CAMERA:
            return how
        self._is_by_hand = how != "stops"
        options = CalibrationOptions(self.pose, write_limits=False)
        if not self._is_by_hand:
            yield from confirm_search(self.model, "The Stop button")
        yield from switch_torque_off(limp_arm)
        self._searches = not self._is_by_hand
        if self._searches:
            path = (yield from calibrate_against_stops(
                limp_arm, options, self.log_message, self._attended
            ))[2]  # fmt: skip
            confirm_directions(self.model, limp_arm.bus.port.name)  # each was just confirmed
        else:
            path = limp_arm.save((yield from calibrate_by_hand(limp_arm, options))[1])
        yield Notice(str(path))
        yield _SAVED
        return ACCEPT

    def _show_board(self, arm: Arm, open_camera: OpenCamera) -> Dialogue[None]:
        """Calibrate an arm with the camera of the page, and save the result."""
        self.arm = arm
        with open_camera() as (camera, options):
            before, result, pictures = yield from calibrate_with_camera(
                arm, camera, options, self.log_message, self._attended
            )
        for line in describe_result(result):
            yield Notice(line)
        seen = before, options.camera or "", options.camera_name, result
        with kept_until_saved(pictures, self.model.name, self.log_message):
            saved = yield from save_result(*seen, _SAVE)
        if saved:
            yield _SAVED

    @contextmanager
    def _attended(self, arm: Arm) -> Generator[None]:
        """Let pages watch and stop an arm that moves itself.

        Raises:
            StoppedError: It was stopped before it could move.
        """
        self.arm, arm.runner.loop.on_every_cycle = arm, self.on_cycle
        if not self.requested:
            raise StoppedError(_LEFT.text)
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
            return self.arm is not None


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
