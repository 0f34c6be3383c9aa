"""The services of a served arm: a fixed table from names to methods with checked arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from ikservo.arm import Arm, MotionPlan
from ikservo.errors import InputError
from ikservo.network.messages import OrientationFields
from ikservo.network.remote_errors import SAME_VERSION
from ikservo.network.values import FloatArray

__all__ = ["MOTIONS", "PLANS", "STREAMED", "WATCH", "Arguments", "AtSpeed", "Jog", "OfPlan",
           "Service", "parse_arguments"]  # fmt: skip

Name = Annotated[str, Field(max_length=64)]
Positions = dict[str, float]
Paths = Annotated[list[FloatArray], Field(max_length=10_000)]


class Arguments(BaseModel):
    """The arguments of a service; unknown ones are refused.

    Attributes:
        POSITIONAL: Those that the method takes by position.
    """

    POSITIONAL: ClassVar[tuple[str, ...]] = ()
    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    def positional(self) -> list[Any]:
        """Return the arguments by position."""
        return [getattr(self, name) for name in self.POSITIONAL]

    def options(self) -> dict[str, Any]:
        """Return the others, as far as they were given."""
        names = self.model_fields_set - set(self.POSITIONAL)
        given = {name: getattr(self, name) for name in names}
        stance = given.pop("stance", None)
        if isinstance(stance, OrientationFields):
            given["stance"] = stance.orientation_of_tool()
        return given


class Nothing(Arguments):
    """No arguments."""


class AtSpeed(Arguments):
    """With a speed class."""

    speed: Name = "normal"


class _Tip(AtSpeed):
    stance: OrientationFields | None = None


class ToPoint(_Tip):
    """To a point."""

    POSITIONAL = ("position_m",)
    position_m: FloatArray


class ToLine(ToPoint):
    """On a line."""

    tool_speed_m_s: float | None = None


class OnArc(_Tip):
    """On an arc or a circle."""

    POSITIONAL = ("via_m", "end_m")
    via_m: FloatArray | None = None
    end_m: FloatArray | None = None
    tool_speed_m_s: float | None = None
    full_circle: bool = False
    center_m: FloatArray | None = None
    normal: FloatArray | None = None
    angle_rad: float = 0.0


class Strokes(_Tip):
    """Along strokes."""

    POSITIONAL = ("strokes_m",)
    strokes_m: Paths
    tool_speed_m_s: float | None = None
    lift_m: float = 0.0


class Through(_Tip):
    """Through points."""

    POSITIONAL = ("points_m",)
    points_m: Paths
    tool_speed_m_s: float | None = None
    blend_m: float = 0.0
    line: bool = False


class ToJoints(AtSpeed):
    """To joint positions."""

    POSITIONAL = ("positions",)
    positions: Positions


class ToPose(AtSpeed):
    """To a named pose."""

    POSITIONAL = ("name",)
    name: Name


class GripperArguments(Arguments):
    """Of the gripper."""

    POSITIONAL = ("to",)
    to: Literal["open", "close"] | float | None = None
    width_m: float | None = None
    force: float | None = None


class Jog(Arguments):
    """Of a joint or the tip."""

    POSITIONAL = ("what", "speed")
    what: Name
    speed: float | None = None


class OfPlan(Arguments):
    """Of a plan that is kept."""

    plan: Name


class OfPositions(Arguments):
    """Joint positions."""

    POSITIONAL = ("positions",)
    positions: Positions


class Taught(Arguments):
    """A pose to teach."""

    POSITIONAL = ("name",)
    name: Name
    hold: bool = False


class InPose(Arguments):
    """A pose, and where the arm would be."""

    POSITIONAL = ("pose", "start")
    pose: Name
    start: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Service:
    """A service.

    Attributes:
        arguments: The schema of its arguments.
        method: The method of the arm that does it.
        reports_progress: Whether the method takes ``on_progress``.
    """

    arguments: type[Arguments]
    method: Callable[..., object]
    reports_progress: bool = False


def parse_arguments(kind: type[Arguments], given: Mapping[str, JsonValue]) -> Arguments:
    """Return the arguments of a request.

    Raises:
        InputError: One is missing, unknown, or of another type.
    """
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(
            f"The argument {where} cannot be used: {first['msg']}.",
            f"Nothing was done. {SAME_VERSION}",
        ) from None


def _poses(arm: Arm) -> object:
    return {
        "all": arm.poses.all_poses(),
        "taught": arm.poses.user_poses(),
        "path": str(arm.poses.path),
    }


def _within_limits(arm: Arm, pose: str, start: Any) -> object:  # noqa: ANN401  # checked
    inside = arm.pose_within_limits(pose, start)
    return {"positions": inside.positions, "changed": list(inside.changed)}


WATCH: Mapping[str, Service] = {
    "where": Service(Nothing, Arm.where),
    "last_state": Service(Nothing, Arm.last_state),
    "clearance": Service(OfPositions, Arm.clearance_m),
    "poses": Service(Nothing, _poses),
    "within_limits": Service(InPose, _within_limits),
}
"""Requests that move nothing and need no lease."""

_Planning = Callable[..., MotionPlan]

PLANS: Mapping[str, tuple[type[Arguments], _Planning]] = {
    "plan_to": (ToPoint, Arm.plan_to),
    "plan_line": (ToLine, Arm.plan_line),
    "plan_arc": (OnArc, Arm.plan_arc),
    "plan_drawing": (Strokes, Arm.plan_drawing),
    "plan_through": (Through, Arm.plan_through),
    "plan_joints": (ToJoints, Arm.plan_joints),
    "plan_rest": (Nothing, Arm.plan_rest),
    "plan_lowering": (Nothing, Arm.plan_lowering),
}
"""Requests of the operator that move nothing: their plans stay beside the arm."""

MOTIONS: Mapping[str, Service] = {
    "move_to": Service(ToPoint, Arm.move_to, reports_progress=True),
    "move_line": Service(ToLine, Arm.move_line, reports_progress=True),
    "move_arc": Service(OnArc, Arm.move_arc, reports_progress=True),
    "move_through": Service(Through, Arm.move_through, reports_progress=True),
    "draw": Service(Strokes, Arm.draw, reports_progress=True),
    "move_joints": Service(ToJoints, Arm.move_joints, reports_progress=True),
    "pose": Service(ToPose, Arm.pose, reports_progress=True),
    "gripper": Service(GripperArguments, Arm.gripper, reports_progress=True),
    "relax": Service(Nothing, Arm.relax, reports_progress=True),
    "enable": Service(Nothing, Arm.enable),
    "return_within_limits": Service(Nothing, Arm.return_within_limits),
    "teach": Service(Taught, Arm.teach),
}
"""Requests that may move the arm: one at a time, under the lease."""

STREAMED: Mapping[str, type[Arguments]] = {"jog": Jog, "follow": AtSpeed, "stream": AtSpeed}
"""Motions that go on for as long as the operator sends setpoints."""
