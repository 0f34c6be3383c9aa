"""How the tool stands along a way: as it stood at its beginning, or turned to how it shall end."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.kinematics.se3 import Matrix, Vector, exp_so3, log_so3
from ikservo.motion.plane import ArmPlane

__all__ = ["Turning"]


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """An orientation that goes evenly from one to another about one axis, in the arm's plane.

    Attributes:
        plane: What carries the orientation along.
        start: The orientation R_plane_tool (3, 3) at the beginning.
        turn_rad: The rotation vector (3,) of the whole turn, in the plane.
    """

    plane: ArmPlane
    start: Matrix
    turn_rad: Vector

    @classmethod
    def between(
        cls, plane: ArmPlane, start: tuple[Matrix, Vector], end: tuple[Matrix, Vector]
    ) -> Turning:
        """Return the shortest turn between orientations R_world_tool at their joints (dof,)."""
        first = plane.rotation(start[1]).T @ start[0]
        last = plane.rotation(end[1]).T @ end[0]
        return cls(plane, first, log_so3(last @ first.T))

    @classmethod
    def none(cls, plane: ArmPlane, R_world_tool: Matrix, q: Vector) -> Turning:
        """Return the orientation at joints (dof,), kept."""
        return cls.between(plane, (R_world_tool, q), (R_world_tool, q))

    def at(self, share: float, q: Vector) -> Matrix:
        """Return the orientation R_world_tool (3, 3) wanted at joints (dof,), a share along."""
        return self.plane.rotation(q) @ exp_so3(share * self.turn_rad) @ self.start
