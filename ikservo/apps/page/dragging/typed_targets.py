"""Targets that are typed or stepped: a joint's position, the tool's coordinates and angles.

The page uses degrees, and millimetres for prismatic joints and coordinates.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.arm import Arm, ToolOrientation
from ikservo.errors import InputError, UnreachableError
from ikservo.ik import Target
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.tool import tool_frame
from ikservo.planning.tool_orientation import solve_with_orientation

_MM = 1000.0
_ROUNDING = 0.05  # rounding error of shown limits, degrees or mm
_STAYS = "Nothing was changed."


class JointRanges:
    """Joint positions in the units that the page shows and sends."""

    def __init__(self, arm: Arm) -> None:
        self._index = arm.joint_index
        self._sources = [driven.limits.source for driven in arm.context.servos.driven_joints]
        lower, upper = arm.limits()
        self._lower: list[float] = lower.tolist()
        self._upper: list[float] = upper.tolist()
        joints = [arm.model.joint(name) for name in self._index.names]
        self._prismatic = [joint.joint_map.unit == "m" for joint in joints]

    def fields(self) -> list[dict[str, object]]:
        """Return unit, lowest and highest position of each joint."""
        return [
            {
                "name": name,
                "unit": "mm" if self._prismatic[column] else "°",
                "low": round(self.to_shown(column, self._lower[column]), 1),
                "high": round(self.to_shown(column, self._upper[column]), 1),
            }
            for column, name in enumerate(self._index.names)
        ]

    def to_shown(self, column: int, position: float) -> float:
        """Convert a position [rad or m] to degrees or millimetres."""
        return position * _MM if self._prismatic[column] else math.degrees(position)

    def moved(self, goal: Vector, joint: str, value: float) -> Vector:
        """Return the goal (n,) with one joint at a position, degrees or mm.

        Raises:
            UnknownNameError: There is no such joint.
            InputError: The position is past a limit.
        """
        column = self._index.column(joint)
        wanted, slack = (
            number / _MM if self._prismatic[column] else math.radians(number)
            for number in (value, _ROUNDING)
        )
        position = min(max(wanted, self._lower[column]), self._upper[column])
        if abs(position - wanted) > slack:
            raise InputError(self._describe_limit(column, value), _STAYS)
        return self._index.with_position(goal, joint, position)

    def stepped(self, goal: Vector, joint: str, step: float) -> Vector:
        """Return the goal (n,) with one joint moved by a step, at most to its limit.

        Raises:
            UnknownNameError: There is no such joint.
            InputError: The joint is at that limit already.
        """
        column = self._index.column(joint)
        by = step / _MM if self._prismatic[column] else math.radians(step)
        at = float(goal[column])
        position = min(max(at + by, self._lower[column]), self._upper[column])
        if (position - at) * step <= 0.0:
            wanted = self.to_shown(column, at + by)
            raise InputError(self._describe_limit(column, wanted), _STAYS)
        return self._index.with_position(goal, joint, position)

    def _describe_limit(self, column: int, value: float) -> str:
        unit = " mm" if self._prismatic[column] else "°"
        low, high = (
            f"{self.to_shown(column, ends[column]):.1f}" for ends in (self._lower, self._upper)
        )
        name = self._index.names[column]
        return (
            f"{name} cannot be at {round(value, 1):g}{unit}; its range is {low} to {high}{unit} "
            f"({self._sources[column]})."
        )


class ToolTargets:
    """Solver of tool targets: one value is given, the other values stay if possible."""

    def __init__(self, arm: Arm) -> None:
        self._chain, self._tool = arm.chain, tool_frame(arm.model)

    def values(self, q: Vector) -> dict[str, float]:
        """Return x, y, z [mm] and pitch, roll [degrees] of the tool at joints (dof,)."""
        return self._values_at(self._chain.forward(q))

    def fields(self, q: Vector) -> dict[str, object]:
        """Return the rounded values for a page and the direction of the tool, at joints (dof,)."""
        T = self._chain.forward(q)
        direction = T[:3, :3] @ self._tool.approach_axis
        values = {name: round(value, 1) for name, value in self._values_at(T).items()}
        return {**values, "direction": np.round(direction, 2).tolist()}

    def _values_at(self, T: Matrix) -> dict[str, float]:
        x, y, z = (_MM * T[:3, 3]).tolist()
        pitch_rad = self._tool.pitch_rad(T[:3, :3])
        roll_rad = self._tool.roll_rad(T[:3, :3], math.atan2(y, x))
        return {"x": x, "y": y, "z": z} | {
            "pitch": math.degrees(pitch_rad),
            "roll": math.degrees(roll_rad),
        }

    def solve_value(self, q: Vector, what: str, value: float) -> tuple[Vector, TargetMarker]:
        """Find joints (dof,) with one value of the tool, and the marker of its target.

        Raises:
            UnreachableError: There are no such joints; also ``OrientationError``.
            InputError: An angle is beyond its range.
        """
        T = self._chain.forward(q)
        if what == "pitch":
            return self._solve(q, T[:3, 3], ToolOrientation(pitch_rad=math.radians(value)))
        if what == "roll":
            return self._solve(q, T[:3, 3], ToolOrientation(roll_rad=math.radians(value)))
        position = T[:3, 3].copy()
        position["xyz".index(what)] = value / _MM
        return self._solve(q, position, ToolOrientation())

    def solve_direction(self, q: Vector, direction: Vector) -> tuple[Vector, TargetMarker]:
        """Find joints (dof,) with the tool in a direction (3,), and the marker of its target.

        Raises:
            UnreachableError: There are no such joints.
            InputError: The direction has no length.
        """
        if float(np.linalg.norm(direction)) < 1e-6:
            raise InputError("The direction 0, 0, 0 has no length.", _STAYS)
        position = self._chain.forward(q)[:3, 3]
        return self._solve(q, position, ToolOrientation(direction=direction))

    def _solve(
        self, q: Vector, position: Vector, orientation: ToolOrientation
    ) -> tuple[Vector, TargetMarker]:
        start = self._chain.clip(q)
        found = solve_with_orientation(
            self._chain, self._tool, Target(position), orientation, start
        )
        if not found.reached:
            raise UnreachableError(
                position.tolist(), found.nearest_m.tolist(), [str(limit) for limit in found.binding]
            )
        return found.q, TargetMarker(position, found.nearest_m, reached=True, stance=orientation)
