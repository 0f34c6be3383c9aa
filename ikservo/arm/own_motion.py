"""A kind of motion that an app plans and runs itself."""

from __future__ import annotations

from abc import abstractmethod
from typing import TypeVar

from ikservo.arm.arm_protocol import ArmParts
from ikservo.kinematics.arrays import Vector
from ikservo.planning.context import ArmContext
from ikservo.planning.motions import MotionValue
from ikservo.planning.reports import OnProgress

R = TypeVar("R")


class OwnMotion(MotionValue[R]):
    """A motion that an app defines, for steps of programs and for ``Arm.execute`` and ``start``.

    ``Arm.plan`` cannot plan such a motion, which runs only on the machine of the servos.
    """

    @abstractmethod
    def run(self, arm: ArmParts, on_progress: OnProgress | None) -> R:
        """Execute the motion from the position where the arm holds; return the result.

        Raises:
            IkservoError: The motion cannot be executed; the arm holds.
        """

    @abstractmethod
    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,), rad or m, after the motion from ``start`` (n,); nothing moves.

        Raises:
            IkservoError: The motion cannot be executed from ``start``.
        """
