"""What the methods of ``Arm`` that move it need of an arm."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from ikservo.arm.background_motion import Background
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.scene import Scene
from ikservo.planning.checked_planning import PreflightPlanner
from ikservo.planning.context import ArmContext


@runtime_checkable
class ArmParts(Protocol):
    """The parts of an arm; ``Arm`` has them.

    A function whose first parameter is an ``ArmParts`` can be a method of ``Arm``.
    """

    @property
    def context(self) -> ArmContext:
        """What the arm is made of."""
        ...

    @property
    def runner(self) -> MotionRunner:
        """What runs its motions."""
        ...

    @property
    def preflight(self) -> PreflightPlanner:
        """What plans and checks them."""
        ...

    @property
    def scene(self) -> Scene:
        """What stands around it, and what its gripper holds."""
        ...

    @property
    def background(self) -> Background:
        """What runs those that the program does not wait for."""
        ...
