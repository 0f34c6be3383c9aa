"""The services of a served arm: a fixed table of names and methods with checked arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from ikservo.arm import Arm
from ikservo.arm.own_motion import OwnMotion
from ikservo.arm.result_json import FloatArray
from ikservo.errors import InputError, RefusedError
from ikservo.files.validation import first_mistake
from ikservo.planning.motions import MotionValue, parse_motion
from ikservo.serving.replies import SAME_VERSION

Name = Annotated[str, Field(max_length=64)]
Positions = dict[str, float]


class Arguments(BaseModel):
    """The arguments of a service; unknown arguments are refused."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

    def given(self) -> dict[str, Any]:
        """Return the given arguments by name."""
        return {name: getattr(self, name) for name in self.model_fields_set}


_A = TypeVar("_A", bound=Arguments)


class Nothing(Arguments):
    """Empty arguments."""


class AtSpeed(Arguments):
    """Arguments with a speed class."""

    speed: Name = "normal"


class OfMotion(Arguments):
    """Arguments that describe a motion; see ``parse_motion``."""

    motion: dict[str, JsonValue]

    def parse(self) -> MotionValue[Any]:
        """Parse the motion.

        Raises:
            InputError: The motion cannot be used; the error is the same as from ``Arm``.
            RefusedError: The motion would read a file on this machine.
        """
        motion = parse_motion(self.motion)
        if isinstance(motion, OwnMotion):
            raise RefusedError(
                f"{motion} works only on the arm's computer.", "Run the program on that computer."
            )
        return motion


class Jog(Arguments):
    """Arguments to jog a joint or the tip."""

    what: Name
    speed: float | None = None


class OfPlan(Arguments):
    """Arguments that name a stored plan."""

    plan: Name


class OfPositions(Arguments):
    """Arguments with joint positions."""

    positions: Positions


class Taught(Arguments):
    """Arguments with a pose to teach."""

    name: Name
    hold: bool = False


class InPose(Arguments):
    """Arguments with a pose, and the assumed present joint positions."""

    pose: Name
    start: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Service:
    """A service of a served arm; if it reports progress, its method takes ``on_progress``."""

    arguments: type[Arguments]
    method: Callable[..., object]
    reports_progress: bool = False


def parse_arguments(kind: type[_A], given: Mapping[str, JsonValue]) -> _A:
    """Parse the arguments of a request.

    Raises:
        InputError: An argument is missing, unknown, or of the wrong type.
    """
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        where, why = first_mistake(error)
        raise InputError(
            f"The argument {where} cannot be used: {why}.", f"Nothing was done. {SAME_VERSION}"
        ) from None


def _poses(arm: Arm) -> object:
    poses = arm.poses
    return {"all": poses.all_poses(), "taught": poses.user_poses(), "path": str(poses.path)}


def _within_limits(arm: Arm, pose: str, start: Any = None) -> object:  # noqa: ANN401  # checked
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

MOTIONS: Mapping[str, Service] = {
    "relax": Service(Nothing, Arm.relax, reports_progress=True),
    "enable": Service(Nothing, Arm.enable),
    "return_within_limits": Service(Nothing, Arm.return_within_limits),
    "teach": Service(Taught, Arm.teach),
}
"""Other requests that may move the arm; they run one at a time, under the lease."""

STREAMED: Mapping[str, type[Arguments]] = {"jog": Jog, "follow": AtSpeed, "stream": AtSpeed}
"""Motions that continue as long as the operator sends setpoints."""
