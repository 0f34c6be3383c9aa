"""The tool frame of an arm, and directions as angles and words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.model.arm_model import Model, ModelJoint

_SWINGS_M_PER_RAD = 0.03
# A tool nearer to upright than this has no heading; solutions are exact to 0.1 mrad.
_VERTICAL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class ToolFrame(FrozenArrays):
    """The axes of a tool, in the coordinates of its tip.

    Attributes:
        approach_axis: The tool axis (3,), from the wrist through the fingertips.
        left: The axis (3,) that points horizontally to the left if the tool is not rolled.
    """

    approach_axis: Vector
    left: Vector

    def pitch_rad(self, R_world_tool: Matrix) -> float:
        """Compute the angle of the tool axis above the horizontal: -π/2 is straight down."""
        up = float((R_world_tool @ self.approach_axis)[2])
        return math.asin(min(max(up, -1.0), 1.0))

    def heading_rad(self, R_world_tool: Matrix) -> float | None:
        """Compute the heading of the tool axis, from x towards y; None if the axis is upright."""
        x, y, _ = R_world_tool @ self.approach_axis
        return None if math.hypot(x, y) < _VERTICAL else math.atan2(y, x)

    def roll_rad(self, R_world_tool: Matrix, heading_rad: float) -> float:
        """Compute the rotation of the tool about its axis, clockwise as seen from behind it.

        ``heading_rad`` is the heading of a tool (3, 3) that is upright.
        """
        own = self.heading_rad(R_world_tool)
        level = _level_left(heading_rad if own is None else own)
        ahead, left = R_world_tool @ self.approach_axis, R_world_tool @ self.left
        return math.atan2(float(left @ np.cross(ahead, level)), float(left @ level))

    def rotation(self, heading_rad: float, pitch_rad: float, roll_rad: float) -> Matrix:
        """Compute the orientation R_world_tool (3, 3) of a tool with these angles."""
        ahead = direction_from_angles(heading_rad, pitch_rad)
        level = _level_left(heading_rad)
        left = math.cos(roll_rad) * level + math.sin(roll_rad) * np.cross(ahead, level)
        axes = np.column_stack(
            [self.approach_axis, self.left, np.cross(self.approach_axis, self.left)]
        )
        return np.column_stack([ahead, left, np.cross(ahead, left)]) @ axes.T


def direction_from_angles(heading_rad: float, pitch_rad: float) -> Vector:
    """Compute the direction (3,) of a tool axis with a heading and a pitch."""
    level = math.cos(pitch_rad)
    return np.array(
        [level * math.cos(heading_rad), level * math.sin(heading_rad), math.sin(pitch_rad)]
    )


def tool_frame(model: Model) -> ToolFrame:
    """Return the axes of an arm's tool, computed from its geometry.

    The tool axis is the axis of the tip's frame that is nearest to the lever: the vector to the tip
    from the last joint that moves it. Left is the other axis that is horizontal in the pose home.
    """
    chain = model.chain
    q = model.chain_pose("home") if "home" in model.poses else chain.mid_range()
    R = chain.forward(q)[:3, :3]
    J = chain.jacobian(q)
    swinging = np.flatnonzero(np.linalg.norm(J[:3], axis=0) > _SWINGS_M_PER_RAD)
    last = int(swinging[-1]) if len(swinging) else chain.dof - 1
    axis, speed = J[3:, last], J[:3, last]
    # The tip's speed about an axis is axis x lever, so speed x axis is the lever across the axis.
    lever: Vector = np.cross(speed, axis)
    outward = R.T @ (lever if float(np.linalg.norm(lever)) > 0.0 else speed)
    ahead, strongest = np.zeros(3), int(np.argmax(np.abs(outward)))
    ahead[strongest] = math.copysign(1.0, float(outward[strongest]))
    others = [axis for axis in np.eye(3) if abs(float(axis @ ahead)) < 0.5]
    left = min(others, key=lambda axis: abs(float((R @ axis)[2])))
    upside_down = float((R @ np.cross(ahead, left))[2]) < 0.0
    return ToolFrame(ahead, -left if upside_down else left)


def _level_left(heading_rad: float) -> Vector:
    """Compute the horizontal direction (3,) to the left of a heading."""
    return np.array([-math.sin(heading_rad), math.cos(heading_rad), 0.0])


# A joint that moves the tip by less than this per radian rolls the tool.
_ROLLS_M_PER_RAD = 0.03
_AHEAD_M = 0.01
_DIRECTIONS = (
    ("forwards", "back"),
    ("to the left (seen from behind the base)", "to the right (seen from behind the base)"),
    ("up", "down"),
)


def describe_direction(model: Model, joint: ModelJoint, pose: str, towards: int) -> str:
    """Describe how to move a joint from a pose so that its position increases or decreases.

    Forwards is the horizontal direction from the base to the tool in pose ``home``; left is 90°
    counter-clockwise from it, seen from above. ``towards`` is +1 for increasing positions, -1 for
    decreasing positions.
    """
    if joint.name not in model.chain.names:
        # The direction from the pose rest to the pose home counts as opening
        opening = model.pose("home")[joint.name] - model.pose("rest")[joint.name]
        return "so that it opens" if opening * towards >= 0.0 else "so that it closes"
    column = model.chain.names.index(joint.name)
    T, J = model.chain.forward_and_jacobian(model.chain_pose(pose))
    speed: Vector = towards * (view_axes(model) @ J[:3, column])
    if float(np.linalg.norm(speed)) < _ROLLS_M_PER_RAD:
        axis: Vector = towards * J[3:, column]
        # A roll is named as seen from behind the tool: clockwise about an axis that points ahead
        child = next(j.child for j in model.urdf.joints if j.name == joint.name)
        origin: Vector = model.chain.forward(model.chain_pose(pose), frame=child)[:3, 3]
        ahead = T[:3, 3] - origin
        sense = "clockwise" if float(axis @ ahead) > 0.0 else "counter-clockwise"
        return f"{sense}, seen along the tool"
    along = int(np.argmax(np.abs(speed)))
    return f"so that the tool moves {_DIRECTIONS[along][0 if speed[along] > 0 else 1]}"


def view_axes(model: Model) -> Vector:
    """Compute forwards, left and up as the rows (3, 3) of a matrix, in the base frame."""
    tip: Vector = model.chain.forward(model.chain_pose("home"))[:3, 3]
    ahead = np.array([tip[0], tip[1], 0.0])
    length = float(np.linalg.norm(ahead))
    ahead = np.array([1.0, 0.0, 0.0]) if length < _AHEAD_M else ahead / length
    up = np.array([0.0, 0.0, 1.0])
    return np.array([ahead, np.cross(up, ahead), up])
