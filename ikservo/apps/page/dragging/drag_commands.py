"""Commands from gestures and typed values, which a solver turns into goals."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.ik import Target
from ikservo.kinematics.arrays import Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class DragTarget:
    """Move a point of the arm to a position.

    Attributes:
        target: The point, fixed to the tip or to the grabbed link, and its target position.
        is_click: Whether the arm may change its IK branch: after a click, not in a drag.
    """

    target: Target
    is_click: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ToolPoseTarget:
    """Move the tool to a pose; its position has priority over its orientation.

    Attributes:
        position_m: Position (3,) of the tip, base frame.
        orientation: Orientation (3, 3) of the tip: R_base_tip.
        in_plane: Whether the orientation is relative to the arm's own plane, kept if possible.
    """

    position_m: Vector
    orientation: Matrix
    in_plane: bool = False


@dataclass(frozen=True, slots=True)
class JointTarget:
    """Move one joint to a position inside its limits, rad or m; the other joints stay."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class HoldCommand:
    """Hold position."""


DragCommand = DragTarget | ToolPoseTarget | JointTarget | HoldCommand
