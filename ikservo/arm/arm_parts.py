"""The parts of an arm that the motion methods of ``Arm`` use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from ikservo.app_discovery import load_place
from ikservo.arm.background_motion import Background
from ikservo.arm.motion_runner import MotionRunner
from ikservo.planning.context import ArmContext
from ikservo.planning.preflight_planner import PreflightPlanner

if TYPE_CHECKING:
    from ikservo.arm.scene import Scene


@runtime_checkable
class ArmParts(Protocol):
    """The parts of an arm that motion functions need; ``Arm`` provides them.

    A function whose first parameter is an ``ArmParts`` can be a method of ``Arm``.
    """

    @property
    def context(self) -> ArmContext:
        """The servos, model, calibration and checks of the arm."""
        ...

    @property
    def runner(self) -> MotionRunner:
        """The runner of the arm's motions."""
        ...

    @property
    def preflight(self) -> PreflightPlanner:
        """The planner and checker of the arm's motions."""
        ...

    @property
    def scene(self) -> Scene:
        """The things around the arm, and the things that its gripper holds."""
        ...

    @property
    def background(self) -> Background:
        """The runner of motions for which the program does not wait."""
        ...


class ImportedMethod:
    """A method whose module is imported at its first use, to keep the opening of an arm fast.

    Args:
        place: ``package.module:name`` of a function whose first parameter is the object.
    """

    def __init__(self, place: str) -> None:
        self._place = place

    def __get__(self, owner: object, kind: type) -> Any:  # noqa: ANN401  # its own signature
        """Return the function, bound to the object if there is one."""
        function = load_place(self._place)
        return function if owner is None else function.__get__(owner, kind)
