"""Where the tool shall point: each axis that matters, as circles of yaw and roll."""

from __future__ import annotations

import cmath
from collections.abc import Iterator
from dataclasses import dataclass

from ikservo.ik.closed_form.anatomy import Structure
from ikservo.ik.closed_form.orbits import Orbit
from ikservo.ik.target import Target
from ikservo.kinematics.se3 import Matrix, Vector, pose

__all__ = ["Aim", "aims_of", "tool_at_zero"]


@dataclass(frozen=True, slots=True)
class Aim:
    """A tool axis a and where it shall point, d."""

    wanted: Orbit
    tool: Orbit

    def product(self, yaw_rad: float, roll_rad: float) -> complex:
        """Return d ā along the plane: its phase is the turn α that takes a to d."""
        return self.wanted.along(yaw_rad) * self.tool.along(roll_rad).conjugate()

    def miss(self, yaw_rad: float, roll_rad: float, alpha_rad: float) -> float:
        """Return how far a, turned by α, ends from d (about the angle in rad)."""
        along = self.wanted.along(yaw_rad)
        along -= cmath.rect(1.0, alpha_rad) * self.tool.along(roll_rad)
        across = self.wanted.across(yaw_rad) - self.tool.across(roll_rad)
        return abs(complex(abs(along), across))


def aims_of(target: Target, arm: Structure, tool: Matrix) -> tuple[Aim, ...]:
    """Return what a target wants of the tool, whose pose (4, 4) is given with yaw and roll zero."""
    return tuple(
        Aim(arm.yaw_back.of_vector(d), arm.roll.of_vector(a)) for a, d in _axes(target, tool)
    )


def tool_at_zero(arm: Structure, target: Target) -> Matrix:
    """Return the pose (4, 4) of the target's point while all joints are zero."""
    if target.offset_m is None:
        return arm.tool
    return arm.tool @ pose(target.offset_m)


def _axes(target: Target, tool: Matrix) -> Iterator[tuple[Vector, Vector]]:
    """Yield each tool axis that matters, base frame at zero, and where it shall point."""
    if target.rotation is not None:
        yield from zip(tool[:3, :3].T, target.rotation.T, strict=True)
    if target.wanted_axis is not None:
        yield tool[:3, :3] @ target.axis, target.wanted_axis
