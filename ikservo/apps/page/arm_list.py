"""The page's list of arms: open arms, arms that can be opened, and one stop for all."""

from __future__ import annotations

import itertools
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from ikservo.apps.page.arm_choices import ChoiceFinder
from ikservo.apps.page.dragging.labels import STOP_TEXTS
from ikservo.apps.page.messages.message_fields import Name, PageMessage, StopInput
from ikservo.apps.page.messages.page_messages import BadMessageError, Heartbeat, validate_message
from ikservo.apps.page.panels.dialogue_panel import (
    AnswerDialogue,
    DialoguePanel,
    LeaveDialogue,
    StartNewArm,
)
from ikservo.apps.page.panels.dialogue_process import CheckServos, SetUpServos
from ikservo.apps.page.panels.video import VIDEO_TYPE
from ikservo.apps.page.served_arms import ServedArms
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.downloads import Download, DownloadOffers
from ikservo.apps.page.server.server import Frame
from ikservo.clock import Clock

_PERIOD_S = 0.1  # least time between two frames
Choice = Annotated[str, Field(min_length=1, max_length=512)]


class FindChoices(PageMessage):
    """Look for ports and arms."""

    kind: Literal["find_choices"]


class OpenChoice(PageMessage):
    """Open an offered arm at an offered port."""

    kind: Literal["open_arm"]
    arm: Choice
    port: Choice


class StartServoTask(PageMessage):
    """Set up or check the servos of an offered arm, or find any servos, at an offered port."""

    kind: Literal["set_up_servos", "check_servos", "find_servos"]
    arm: Choice
    port: Choice


class CloseArm(PageMessage):
    """Close an open arm, or forget an arm that could not be opened; torque stays unchanged."""

    kind: Literal["close_arm"]
    name: Name


class ShowCamera(PageMessage):
    """Ask for the address of an arm's camera pictures, which is valid once."""

    kind: Literal["show_camera"]
    arm: Name


class StopArms(PageMessage):
    """Stop one arm, or all arms if no name is given."""

    kind: Literal["stop_arms"]
    name: Name | None = None
    by: StopInput = "button"


ArmListMessage = (
    Heartbeat
    | FindChoices
    | OpenChoice
    | CloseArm
    | ShowCamera
    | StopArms
    | StartNewArm
    | StartServoTask
    | AnswerDialogue
    | LeaveDialogue
)
_MESSAGES: TypeAdapter[ArmListMessage] = TypeAdapter(
    Annotated[ArmListMessage, Field(discriminator="kind")]
)
read_arm_list_message = partial(validate_message, _MESSAGES)
"""Parse and validate a message from the page's list of arms."""


class ArmList:
    """The arms, shown to every client; clients that may move an arm may open and close arms."""

    def __init__(
        self,
        arms: ServedArms,
        choices: ChoiceFinder,
        clock: Clock,
        downloads: DownloadOffers,
        dialogues: DialoguePanel | None = None,
    ) -> None:
        self._dialogues = dialogues or DialoguePanel(Path())
        self._arms, self._choices, self._clock = arms, choices, clock
        self._downloads = downloads
        self._addresses: dict[int, list[Frame]] = {}
        self._numbers = itertools.count(1)
        self._permissions: dict[int, Permission] = {}
        self._sent: dict[int, tuple[float, Frame]] = {}

    def connect(self, permission: Permission) -> int:
        """Register a client and return its number."""
        number = next(self._numbers)
        self._permissions[number] = permission
        return number

    def disconnect(self, client_id: int) -> None:
        """Remove a client."""
        del self._permissions[client_id]
        self._sent.pop(client_id, None)
        self._addresses.pop(client_id, None)

    def receive(self, client_id: int, message: ArmListMessage) -> None:
        """Handle a client's message.

        Raises:
            BadMessageError: The request is not permitted, or impossible now; nothing has changed.
        """
        if isinstance(message, Heartbeat):
            return
        if isinstance(message, ShowCamera):
            arm = self._arms.find(message.arm)
            if arm is None or arm.video is None:
                raise BadMessageError("There is no camera.", "Start with: ikservo view --camera 0")
            url = self._downloads.offer(Download("", arm.video.stream, VIDEO_TYPE))
            self._addresses.setdefault(client_id, []).append({"kind": "camera_url", "url": url})
            return
        if isinstance(message, StopArms):  # any client may stop them
            self._stop_arms(message)
            return
        if self._permissions[client_id] is not Permission.CONTROL:
            raise BadMessageError("This page can only watch.", "Open the control address.")
        match message:
            case FindChoices():
                self._choices.start()
            case OpenChoice():
                self._arms.start_opening(self._choices.found.choose(message.arm, message.port))
            case CloseArm():
                self._arms.start_closing(message.name)
            case StartNewArm() | StartServoTask():
                self._start_dialogue(message)
            case AnswerDialogue():
                self._dialogues.answer(message)
            case LeaveDialogue():
                self._dialogues.close()

    def _start_dialogue(self, message: StartNewArm | StartServoTask) -> None:
        if isinstance(message, StartNewArm):
            if message.port:
                self._choices.found.check_port(message.port)
            self._dialogues.start_new_arm(message)
            return
        place = self._choices.found.choose(message.arm, message.port)
        self._arms.check_free(place)
        if message.kind == "set_up_servos":
            self._dialogues.start(SetUpServos(place.model.path, message.port))
        else:
            any_servos = message.kind == "find_servos"
            self._dialogues.start(CheckServos(place.model.path, message.port, any_servos))

    def _stop_arms(self, message: StopArms) -> None:
        if message.by != "button":
            by = STOP_TEXTS[message.by]
        else:
            by = (
                "Stopped from the list of arms"
                if message.name
                else "Stopped by Stop all on the page"
            )
        self._arms.stop(message.name, by)
        if message.name is None:
            self._dialogues.stop_servos()

    def frames(self, client_id: int) -> list[Frame]:
        """Return the new frames for a client: the list, and the address of camera pictures."""
        addresses = self._addresses.pop(client_id, [])
        now_s = self._clock.now_s()
        sent_s, sent = self._sent.get(client_id, (-1e9, None))
        if now_s - sent_s < _PERIOD_S:
            return addresses
        self._choices.add_folders(self._dialogues.read())
        may_control = self._permissions[client_id] is Permission.CONTROL
        frame = {
            "kind": "arms",
            "dialogue": self._dialogues.fields() if may_control else None,
            "permission": self._permissions[client_id].value,
            "arms": [arm.fields() for arm in self._arms.all()],
            "cameras": self._arms.camera_names,
            **self._choices.found.fields(),
        }
        self._sent[client_id] = (now_s, frame)
        return addresses if frame == sent else [*addresses, frame]
