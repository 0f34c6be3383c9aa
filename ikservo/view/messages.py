"""Messages that a client may send, with their bounds; everything else is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from ikservo.errors import InputError
from ikservo.files.validation import StrictModel
from ikservo.ik import Target

__all__ = [
    "MAX_MESSAGE_BYTES",
    "Acknowledge",
    "BadMessageError",
    "CalibrationAnswer",
    "DragCommand",
    "DragTarget",
    "Gamepad",
    "GoToPose",
    "Heartbeat",
    "Hello",
    "HoldCommand",
    "JointTarget",
    "Key",
    "Message",
    "OrbitCamera",
    "Pointer",
    "PreferPosture",
    "SelectBehind",
    "SetLive",
    "SetSolver",
    "SetSpeed",
    "SetViewport",
    "Stop",
    "TakeControl",
    "Wheel",
    "read_hello",
    "read_message",
]


_MessageT = TypeVar("_MessageT")

MAX_MESSAGE_BYTES = 2048
_MAX_SEQ = 2**53 - 1  # the largest whole number that JavaScript counts without gaps

Pixels = Annotated[float, Field(ge=-16384, le=16384, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=16, le=16384, allow_inf_nan=False)]
Axis = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]


class BadMessageError(InputError):
    """A message that is none; nothing has changed."""


class Hello(StrictModel):
    """The first message: the proof for the nonce of this connection."""

    kind: Literal["hello"]
    proof: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _Message(StrictModel):
    """What all messages have.

    Attributes:
        seq: Counts up; a number that was there before is a replay.
        seen: The latest scene that was drawn when it was sent, which tells its age.
    """

    seq: Annotated[int, Field(ge=1, le=_MAX_SEQ)]
    seen: Annotated[int, Field(ge=0, le=_MAX_SEQ)]


class Heartbeat(_Message):
    """The page lives, and whether a person can see it."""

    kind: Literal["beat"]
    visible: bool


class SetViewport(_Message):
    """What the page shows: the size of its drawing in CSS pixels, and from where it looks."""

    kind: Literal["look"]
    w: Length
    h: Length
    dpr: Annotated[float, Field(ge=0.25, le=16, allow_inf_nan=False)]
    view: Literal["side", "top", "front", "orbit", "plane"]


class Pointer(_Message):
    """A pointer, in CSS pixels of the drawing."""

    kind: Literal["pointer"]
    phase: Literal["down", "move", "up", "cancel", "hover", "leave"]
    x: Pixels
    y: Pixels
    button: Annotated[int, Field(ge=0, le=4)]
    pointer: Annotated[int, Field(ge=-(2**31), le=2**31)]
    touch: bool = False
    shift: bool = False
    alt: bool = False


class Wheel(_Message):
    """A turn of the wheel over a pixel; positive turns are away from the person."""

    kind: Literal["wheel"]
    x: Pixels
    y: Pixels
    notches: Annotated[float, Field(ge=-20, le=20, allow_inf_nan=False)]
    alt: bool = False


class Key(_Message):
    """A key that moves the target."""

    kind: Literal["key"]
    key: Literal["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]
    alt: bool = False
    shift: bool = False


class SelectBehind(_Message):
    """Let a press mean what is behind, or before, what it means now where the pointer is."""

    kind: Literal["behind"]
    step: Literal[-1, 1]


class OrbitCamera(_Message):
    """Turn the camera by pixels of dragging, or come nearer."""

    kind: Literal["orbit"]
    dx: Pixels
    dy: Pixels
    zoom: Annotated[float, Field(ge=0.2, le=5, allow_inf_nan=False)] = 1.0


class Gamepad(_Message):
    """The sticks of a gamepad: right, up, and the two of the other stick, each -1 to 1.

    Attributes:
        grip: 1 closes the gripper, -1 opens it, as the triggers or the page's buttons say.
    """

    kind: Literal["gamepad"]
    axes: Annotated[list[Axis], Field(min_length=4, max_length=4)]
    grip: Axis = 0.0


class Stop(_Message):
    """Hold now, and stay so until acknowledged."""

    kind: Literal["stop"]


class Acknowledge(_Message):
    """The person has seen why the arm holds."""

    kind: Literal["acknowledge"]


class SetLive(_Message):
    """Throw the switch between preview and arm."""

    kind: Literal["live"]
    on: bool


class TakeControl(_Message):
    """Take control, or give it back."""

    kind: Literal["take"]
    on: bool


class SetSpeed(_Message):
    """Choose a speed class."""

    kind: Literal["speed"]
    name: Literal["slow", "normal", "fast"]


class SetSolver(_Message):
    """Choose the solver."""

    kind: Literal["solver"]
    name: Name


class PreferPosture(_Message):
    """Choose the posture to lean towards where the target leaves freedom.

    Attributes:
        pose: The name of a pose, ``here`` for the one of now, or ``none``.
        weights: How strongly joints lean that do not do so with 1.
    """

    kind: Literal["prefer"]
    pose: Name
    weights: dict[Name, Weight] = Field(default_factory=dict, max_length=32)


class GoToPose(_Message):
    """Go to a named pose."""

    kind: Literal["pose"]
    name: Name


class CalibrationAnswer(_Message):
    """An answer in the conversation of a calibration; ``begin`` and ``leave`` frame it."""

    kind: Literal["calibrate"]
    word: Literal["begin", "leave", "accept", "undo", "skip", "free", "again", "protect"]
    joint: Name | None = None


Message = (
    Heartbeat
    | SetViewport
    | Pointer
    | Wheel
    | Key
    | SelectBehind
    | OrbitCamera
    | Gamepad
    | Stop
    | Acknowledge
    | SetLive
    | TakeControl
    | SetSpeed
    | SetSolver
    | PreferPosture
    | GoToPose
    | CalibrationAnswer
)

_MESSAGES: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])
_HELLO = TypeAdapter(Hello)


def read_hello(text: str) -> Hello:
    """Return the first message of a connection.

    Raises:
        BadMessageError: It is none.
    """
    return _validate_message(_HELLO, text)


def read_message(text: str) -> Message:
    """Return a message as a value whose every number is inside its bounds.

    Raises:
        BadMessageError: It is too long, no JSON, or not one of those above.
    """
    return _validate_message(_MESSAGES, text)


def _validate_message(adapter: TypeAdapter[_MessageT], text: str) -> _MessageT:
    if len(text) > MAX_MESSAGE_BYTES:
        raise BadMessageError(
            "The message is too long.", f"At most {MAX_MESSAGE_BYTES} characters."
        )
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise BadMessageError(f"The message cannot be used: {place} {first['msg']}.") from None


@dataclass(frozen=True, slots=True, eq=False)
class DragTarget:
    """A point of the arm shall go there.

    Attributes:
        target: The point, fixed to the tip or to the link that was grabbed, and where to.
        is_click: Whether the arm may fold differently to get there: after a click, not in a drag.
    """

    target: Target
    is_click: bool = False


@dataclass(frozen=True, slots=True)
class JointTarget:
    """One joint shall go to a position inside its limits, rad or m; the others stay."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class HoldCommand:
    """Stay where you are."""


DragCommand = DragTarget | JointTarget | HoldCommand
