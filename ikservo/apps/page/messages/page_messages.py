"""Messages that a client may send, with their bounds; everything else is rejected."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from ikservo.apps.page.messages.message_fields import Name, PageMessage, StopInput
from ikservo.apps.page.messages.program_messages import ProgramMessage, ShowStep
from ikservo.apps.page.messages.thing_messages import SaveThings, ThingMessage
from ikservo.errors import InputError
from ikservo.files.validation import StrictModel, first_mistake

_MessageT = TypeVar("_MessageT")

MAX_MESSAGE_BYTES = 2048

Pixels = Annotated[float, Field(ge=-16384, le=16384, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=16, le=16384, allow_inf_nan=False)]
Axis = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class BadMessageError(InputError):
    """An invalid message; nothing has changed."""


class Hello(StrictModel):
    """The first message, with the proof for the nonce of this connection."""

    kind: Literal["hello"]
    proof: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Heartbeat(PageMessage):
    """A periodic message; ``visible`` is true while the page is in the foreground."""

    kind: Literal["heartbeat"]
    visible: bool


class SetViewport(PageMessage):
    """Set the size of the page's drawing in CSS pixels, its viewpoint, and whether WebGL draws it.

    Attributes:
        handles: Whether WebGL draws handles on the tool.
        height_m: The height above the table of a click in a camera's picture.
    """

    kind: Literal["viewport"]
    w: Length
    h: Length
    dpr: Annotated[float, Field(ge=0.25, le=16, allow_inf_nan=False)]
    view: Literal["side", "top", "front", "orbit", "plane", "camera"]
    webgl: bool = False
    handles: bool = False
    height_m: Annotated[float, Field(ge=-1, le=2, allow_inf_nan=False)] = 0.0


class Pointer(PageMessage):
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


Shift = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]
Turn = Annotated[float, Field(ge=-math.tau, le=math.tau, allow_inf_nan=False)]


class DragTool(PageMessage):
    """A drag of the tool's handles in the 3D scene, relative to its start, in the base frame.

    Attributes:
        shift: The displacement of the tool (3,), metres.
        turn: The rotation of the tool as a rotation vector (3,), rad.
    """

    kind: Literal["drag_tool"]
    phase: Literal["down", "move", "up", "cancel"]
    shift: tuple[Shift, Shift, Shift] = Field(default=(0.0, 0.0, 0.0), strict=False)
    turn: tuple[Turn, Turn, Turn] = Field(default=(0.0, 0.0, 0.0), strict=False)


class TrackHand(PageMessage):
    """The pose of a hand or phone, in axes parallel to the axes of the base frame.

    Attributes:
        position: The position (3,) from any origin, metres.
        rotation: The orientation as a quaternion w, x, y, z.
        held: Whether the tip moves with the hand.
        clutch: The number of the press that closes the clutch; each press has a new number.
        scale: The scale from the motion of the hand to the motion of the tip.
        stamp: The page's time, which the server returns once the arm has received the pose.
    """

    kind: Literal["track_hand"]
    position: tuple[Shift, Shift, Shift] = Field(strict=False)
    rotation: tuple[Axis, Axis, Axis, Axis] = Field(strict=False)
    held: bool
    clutch: Annotated[int, Field(ge=0, le=2**53)]
    scale: Annotated[float, Field(ge=0.25, le=2, allow_inf_nan=False)] = 1.0
    stamp: Annotated[float, Field(ge=0, le=2**53, allow_inf_nan=False)] = 0.0


class Wheel(PageMessage):
    """A wheel event at a pixel; positive notches are away from the user."""

    kind: Literal["wheel"]
    x: Pixels
    y: Pixels
    notches: Annotated[float, Field(ge=-20, le=20, allow_inf_nan=False)]
    alt: bool = False


class Key(PageMessage):
    """A key event that moves the target."""

    kind: Literal["key"]
    key: Literal["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]
    alt: bool = False
    shift: bool = False


class SelectBehind(PageMessage):
    """Select the next (1) or previous (-1) of the overlapping things under the pointer."""

    kind: Literal["behind"]
    step: Literal[-1, 1]


class OrbitCamera(PageMessage):
    """Orbit or pan the camera by a drag in pixels, or zoom.

    Attributes:
        at: The pixel about which to zoom; None for the middle.
    """

    kind: Literal["orbit_camera"]
    dx: Pixels
    dy: Pixels
    zoom: Annotated[float, Field(ge=0.2, le=5, allow_inf_nan=False)] = 1.0
    at: tuple[Pixels, Pixels] | None = Field(default=None, strict=False)


class FitView(PageMessage):
    """Show the whole arm again, from the initial viewpoint of the chosen view."""

    kind: Literal["fit_view"]


class Undo(PageMessage):
    """Restore the previous target, or with ``redo`` the target that was undone."""

    kind: Literal["undo"]
    redo: bool = False


class ArmAction(PageMessage):
    """Start an action of the arm.

    Attributes:
        action: Go to the target of the preview; lower the arm to its rest pose and switch torque
            off; or switch torque off at once.
        path: The number of the path to the target that the page shows.
    """

    kind: Literal["arm_action"]
    action: Literal["execute", "relax", "release"]
    path: Annotated[int, Field(ge=0, le=2**53)] = 0


class Gamepad(PageMessage):
    """State of a gamepad: right and up of one stick, then of the other, each -1 to 1.

    Attributes:
        grip: 1 closes the gripper, -1 opens it; from the triggers or the page's buttons.
    """

    kind: Literal["gamepad"]
    axes: Annotated[list[Axis], Field(min_length=4, max_length=4)]
    grip: Axis = 0.0


class MarkTip(PageMessage):
    """Mark the pixel of the drawing at which a calibrated camera shows the tip."""

    kind: Literal["mark_tip"]
    x: Pixels
    y: Pixels


class Grasp(PageMessage):
    """Offer to pick up the block at a pixel of the drawing, or to put the held thing down there.

    Without a pixel, the blocks in the camera's picture are listed.
    """

    kind: Literal["grasp"]
    at: tuple[Pixels, Pixels] | None = Field(default=None, strict=False)


class ChooseCamera(PageMessage):
    """Show the pictures of another camera of the arm."""

    kind: Literal["choose_camera"]
    camera: Annotated[str, Field(max_length=512)]


class Stop(PageMessage):
    """Stop and hold until acknowledged."""

    kind: Literal["stop"]
    by: StopInput = "button"


class Acknowledge(PageMessage):
    """Acknowledge a stop."""

    kind: Literal["acknowledge"]


class SetLive(PageMessage):
    """Switch between preview and live control."""

    kind: Literal["set_live"]
    on: bool


class TakeControl(PageMessage):
    """Take or release control."""

    kind: Literal["take_control"]
    on: bool


class SetSpeed(PageMessage):
    """Set the speed class."""

    kind: Literal["set_speed"]
    name: Literal["slow", "normal", "fast"]


class SetSolver(PageMessage):
    """Set the solver."""

    kind: Literal["set_solver"]
    name: Name


class PreferPosture(PageMessage):
    """Set the preferred posture, used if the target leaves freedom.

    Attributes:
        pose: The name of a pose, ``here`` for the current posture, or ``none``.
        weights: Weights of the joints; 1 if missing.
    """

    kind: Literal["prefer"]
    pose: Name
    weights: dict[Name, Weight] = Field(default_factory=dict, max_length=32)


class GoToPose(PageMessage):
    """Go to a named pose."""

    kind: Literal["go_to_pose"]
    name: Name


Amount = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
ToolValue = Literal["x", "y", "z", "pitch", "roll"]


class SetJoint(PageMessage):
    """Set the goal of one joint, degrees or millimetres."""

    kind: Literal["set_joint"]
    joint: Name
    value: Amount


class JogJoint(PageMessage):
    """Move the goal of one joint by a step, degrees or millimetres."""

    kind: Literal["jog_joint"]
    joint: Name
    step: Amount


class SetTool(PageMessage):
    """Set one coordinate of the tool [mm] or angle [degrees]; other values stay if possible."""

    kind: Literal["set_tool"]
    what: ToolValue
    value: Amount


class JogTool(PageMessage):
    """Move one coordinate of the tool [mm] or angle [degrees] by a step."""

    kind: Literal["jog_tool"]
    what: ToolValue
    step: Amount


class PointTool(PageMessage):
    """Point the tool in a direction of the base frame, of any length; its tip stays."""

    kind: Literal["point_tool"]
    direction: Annotated[list[Amount], Field(min_length=3, max_length=3)]


class SetTorque(PageMessage):
    """Switch the torque of one joint's servo on or off; a joint without torque falls."""

    kind: Literal["set_torque"]
    joint: Name
    on: bool


class ShowPlots(PageMessage):
    """Choose the channels that the page plots; an empty choice closes the plots.

    Attributes:
        stopped: Show the seconds before the last stop instead of the present.
    """

    kind: Literal["show_plots"]
    quantities: Annotated[list[Name], Field(max_length=16)]
    joints: Annotated[list[Name], Field(max_length=32)]
    span_s: Annotated[int, Field(ge=1, le=600)] = 60
    stopped: bool = False


class SaveHistory(PageMessage):
    """Offer the history, or the seconds before the last stop, as a CSV file."""

    kind: Literal["save_history"]
    stopped: bool = False


class FollowArm(PageMessage):
    """Follow another open arm of the page, which is guided by hand; an empty name ends this."""

    kind: Literal["follow_arm"]
    leader: Name | None = None


class RecordEpisode(PageMessage):
    """Begin an episode of the data set to which the page records, or save or discard it."""

    kind: Literal["record_episode"]
    action: Literal["begin", "save", "discard"]


class RunPanelMotion(PageMessage):
    """Start the motion that a button in an app's panel offers."""

    kind: Literal["run_panel_motion"]
    heading: Annotated[str, Field(max_length=64)]
    button: Annotated[str, Field(max_length=64)]


class ReadServo(PageMessage):
    """Read the control table of a joint's servo."""

    kind: Literal["read_servo"]
    joint: Name


class WriteRegister(PageMessage):
    """Write a register of a joint's servo: a raw integer, or a number with a unit."""

    kind: Literal["write_register"]
    joint: Name
    name: Name
    value: Annotated[str, Field(min_length=1, max_length=32)]


class CalibrationAnswer(PageMessage):
    """User input for a calibration; ``start`` starts it and ``cancel`` ends it.

    ``number`` is the screen on which the answer was given; answers to other screens are ignored.
    """

    kind: Literal["calibration"]
    action: Literal[
        "start", "cancel", "accept", "no", "stops", "camera", "undo", "skip", "continuous",
        "remeasure", "protect",
    ]  # fmt: skip
    joint: Name | None = None
    number: Annotated[int, Field(ge=0, le=2**31)] = 0


Message = (
    Heartbeat
    | SetViewport
    | Pointer
    | DragTool
    | TrackHand
    | Wheel
    | Key
    | SelectBehind
    | OrbitCamera
    | FitView
    | Undo
    | ArmAction
    | Gamepad
    | MarkTip
    | Grasp
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
    | ShowPlots
    | SaveHistory
    | FollowArm
    | RecordEpisode
    | RunPanelMotion
    | ChooseCamera
    | ReadServo
    | WriteRegister
    | SaveThings
    | ThingMessage
    | CalibrationAnswer
    | ProgramMessage
    | ShowStep
)

_MESSAGES: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="kind")])


def validate_message(adapter: TypeAdapter[_MessageT], text: str) -> _MessageT:
    """Parse and validate a message; every number of the result is inside its bounds.

    Raises:
        BadMessageError: The message is too long, not JSON, or of another kind.
    """
    if len(text) > MAX_MESSAGE_BYTES:
        raise BadMessageError(
            "The message is too long.", f"At most {MAX_MESSAGE_BYTES} characters."
        )
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        where, why = first_mistake(error)
        raise BadMessageError(f"The message cannot be used: {where} {why}.") from None


read_hello = partial(validate_message, TypeAdapter(Hello))
"""Parse the first message on a connection."""

read_message = partial(validate_message, _MESSAGES)
"""Parse any later message."""
