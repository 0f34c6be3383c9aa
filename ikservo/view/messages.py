"""Messages that a client may send, with their bounds; everything else is rejected."""

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
    "JogJoint",
    "JogTool",
    "JointTarget",
    "Key",
    "Message",
    "OrbitCamera",
    "PointTool",
    "Pointer",
    "PreferPosture",
    "SelectBehind",
    "SetJoint",
    "SetLive",
    "SetSolver",
    "SetSpeed",
    "SetTool",
    "SetTorque",
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
    """An invalid message; nothing has changed."""


class Hello(StrictModel):
    """The first message: the proof for the nonce of this connection."""

    kind: Literal["hello"]
    proof: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _Message(StrictModel):
    """Fields of all messages.

    Attributes:
        seq: Sequence number, increasing; a repeated number is a replay.
        seen: Number of the latest scene drawn when it was sent, which gives the message's age.
    """

    seq: Annotated[int, Field(ge=1, le=_MAX_SEQ)]
    seen: Annotated[int, Field(ge=0, le=_MAX_SEQ)]


class Heartbeat(_Message):
    """Sent periodically; ``visible`` is whether the page is in the foreground."""

    kind: Literal["heartbeat"]
    visible: bool


class SetViewport(_Message):
    """Size of the page's drawing in CSS pixels, its viewpoint, and whether WebGL draws it."""

    kind: Literal["viewport"]
    w: Length
    h: Length
    dpr: Annotated[float, Field(ge=0.25, le=16, allow_inf_nan=False)]
    view: Literal["side", "top", "front", "orbit", "plane"]
    webgl: bool = False


class Pointer(_Message):
    """A pointer event, in CSS pixels of the drawing."""

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
    """A wheel event at a pixel; positive notches are away from the user."""

    kind: Literal["wheel"]
    x: Pixels
    y: Pixels
    notches: Annotated[float, Field(ge=-20, le=20, allow_inf_nan=False)]
    alt: bool = False


class Key(_Message):
    """A key event that moves the target."""

    kind: Literal["key"]
    key: Literal["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]
    alt: bool = False
    shift: bool = False


class SelectBehind(_Message):
    """Select the next (1) or previous (-1) of the overlapping things under the pointer."""

    kind: Literal["behind"]
    step: Literal[-1, 1]


class OrbitCamera(_Message):
    """Orbit or pan the camera by pixels of dragging, or zoom."""

    kind: Literal["orbit_camera"]
    dx: Pixels
    dy: Pixels
    zoom: Annotated[float, Field(ge=0.2, le=5, allow_inf_nan=False)] = 1.0


class Gamepad(_Message):
    """State of a gamepad: right and up of one stick, then of the other, each -1 to 1.

    Attributes:
        grip: 1 closes the gripper, -1 opens it; from the triggers or the page's buttons.
    """

    kind: Literal["gamepad"]
    axes: Annotated[list[Axis], Field(min_length=4, max_length=4)]
    grip: Axis = 0.0


class Stop(_Message):
    """Stop and hold until acknowledged."""

    kind: Literal["stop"]


class Acknowledge(_Message):
    """The user acknowledges a stop."""

    kind: Literal["acknowledge"]


class SetLive(_Message):
    """Switch between preview and live control."""

    kind: Literal["set_live"]
    on: bool


class TakeControl(_Message):
    """Take or release control."""

    kind: Literal["take_control"]
    on: bool


class SetSpeed(_Message):
    """Set the speed class."""

    kind: Literal["set_speed"]
    name: Literal["slow", "normal", "fast"]


class SetSolver(_Message):
    """Set the solver."""

    kind: Literal["set_solver"]
    name: Name


class PreferPosture(_Message):
    """Set the preferred posture, used where the target leaves freedom.

    Attributes:
        pose: The name of a pose, ``here`` for the current posture, or ``none``.
        weights: Weights of joints, 1 where missing.
    """

    kind: Literal["prefer"]
    pose: Name
    weights: dict[Name, Weight] = Field(default_factory=dict, max_length=32)


class GoToPose(_Message):
    """Go to a named pose."""

    kind: Literal["go_to_pose"]
    name: Name


Amount = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
ToolValue = Literal["x", "y", "z", "pitch", "roll"]


class SetJoint(_Message):
    """Set the goal of one joint, degrees or millimetres."""

    kind: Literal["set_joint"]
    joint: Name
    value: Amount


class JogJoint(_Message):
    """Move the goal of one joint by a step, degrees or millimetres."""

    kind: Literal["jog_joint"]
    joint: Name
    step: Amount


class SetTool(_Message):
    """Set one coordinate of the tool [mm] or angle [degrees]; the others stay if they can."""

    kind: Literal["set_tool"]
    what: ToolValue
    value: Amount


class JogTool(_Message):
    """Move one coordinate of the tool [mm] or angle [degrees] by a step."""

    kind: Literal["jog_tool"]
    what: ToolValue
    step: Amount


class PointTool(_Message):
    """Point the tool in a direction of the base frame, of any length; its tip stays."""

    kind: Literal["point_tool"]
    direction: Annotated[list[Amount], Field(min_length=3, max_length=3)]


class SetTorque(_Message):
    """Switch the torque of one joint's servo; a joint without torque falls."""

    kind: Literal["set_torque"]
    joint: Name
    on: bool


class CalibrationAnswer(_Message):
    """User input of a calibration; ``start`` starts it and ``cancel`` ends it."""

    kind: Literal["calibration"]
    action: Literal[
        "start", "cancel", "accept", "undo", "skip", "continuous", "remeasure", "protect"
    ]
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
    | SetJoint
    | JogJoint
    | SetTool
    | JogTool
    | PointTool
    | SetTorque
    | CalibrationAnswer
)

_MESSAGES: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])
_HELLO = TypeAdapter(Hello)


def read_hello(text: str) -> Hello:
    """Parse the first message of a connection.

    Raises:
        BadMessageError: It is no valid ``Hello``.
    """
    return _validate_message(_HELLO, text)


def read_message(text: str) -> Message:
    """Parse and validate a message; every number of the result is inside its bounds.

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
    """Move a point of the arm to a position.

    Attributes:
        target: The point, fixed to the tip or to the grabbed link, and its target position.
        is_click: Whether the arm may change its IK branch: after a click, not in a drag.
    """

    target: Target
    is_click: bool = False


@dataclass(frozen=True, slots=True)
class JointTarget:
    """Move one joint to a position inside its limits, rad or m; the others stay."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class HoldCommand:
    """Hold position."""


DragCommand = DragTarget | JointTarget | HoldCommand
