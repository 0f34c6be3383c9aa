"""A kind of motion that an app plans and runs itself."""

from __future__ import annotations

from abc import abstractmethod
from typing import TypeVar

from ikservo.arm.arm_parts import ArmParts
from ikservo.kinematics.arrays import Vector
from ikservo.planning.context import ArmContext
from ikservo.planning.motions import MotionValue
from ikservo.planning.reports import OnProgress

R = TypeVar("R")


class OwnMotion(MotionValue[R]):
    """A motion of an app: a step of programs, and an argument of ``Arm.execute`` and ``start``.

    It has no plan to show before it runs, and runs only on the machine of the servos.
    """

    @abstractmethod
    def run(self, arm: ArmParts, on_progress: OnProgress | None) -> R:
        """Make the motion from where the arm holds, and return its result.

        Raises:
            IkservoError: The motion cannot be made; the arm holds.
        """

    @abstractmethod
    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,), rad or m, after the motion from ``start`` (n,); nothing moves.

        Raises:
            IkservoError: The motion cannot be made from there.
        """
