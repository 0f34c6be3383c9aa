"""Which way an arm's tool points, and how steep, how rolled it stands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model.model import Model

__all__ = ["Tool", "tool_of"]

_SWINGS_M_PER_RAD = 0.03
# Nearer to upright than this a tool points nowhere, as solved to a tenth of a milliradian.
_VERTICAL = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """The axes of a tool, in the coordinates of its tip.

    Attributes:
        ahead: The tool axis (3,): from the wrist out through the fingertips.
        left: The axis (3,) that lies level, to the left, where the tool is not rolled.
    """

    ahead: Vector
    left: Vector

    def pitch_rad(self, R_world_tool: Matrix) -> float:
        """Return the angle of the tool axis above the horizontal: -π/2 is straight down."""
        up = float((R_world_tool @ self.ahead)[2])
        return math.asin(min(max(up, -1.0), 1.0))

    def heading_rad(self, R_world_tool: Matrix) -> float | None:
        """Return where the tool axis points, seen from above, from x towards y; None if upright."""
        x, y, _ = R_world_tool @ self.ahead
        return None if math.hypot(x, y) < _VERTICAL else math.atan2(y, x)

    def roll_rad(self, R_world_tool: Matrix, heading_rad: float) -> float:
        """Return how far the tool is turned about its axis, clockwise as seen from behind it.

        Args:
            R_world_tool: Its orientation (3, 3).
            heading_rad: Where it points, for a tool that is upright.
        """
        own = self.heading_rad(R_world_tool)
        level = _level(heading_rad if own is None else own)
        ahead, left = R_world_tool @ self.ahead, R_world_tool @ self.left
        return math.atan2(float(left @ np.cross(ahead, level)), float(left @ level))

    def rotation(self, heading_rad: float, pitch_rad: float, roll_rad: float) -> Matrix:
        """Return the orientation R_world_tool (3, 3) of a tool that stands so."""
        ahead = pointing(heading_rad, pitch_rad)
        level = _level(heading_rad)
        left = math.cos(roll_rad) * level + math.sin(roll_rad) * np.cross(ahead, level)
        axes = np.column_stack([self.ahead, self.left, np.cross(self.ahead, self.left)])
        return np.column_stack([ahead, left, np.cross(ahead, left)]) @ axes.T


def pointing(heading_rad: float, pitch_rad: float) -> Vector:
    """Return the direction (3,) of a tool axis with a heading and a pitch."""
    level = math.cos(pitch_rad)
    return np.array(
        [level * math.cos(heading_rad), level * math.sin(heading_rad), math.sin(pitch_rad)]
    )


def tool_of(model: Model) -> Tool:
    """Return the axes of an arm's tool, out of its geometry.

    The tool axis is the axis of the tip's frame nearest to the way from the last joint that swings
    the tip to the tip; left is the one of the others that lies level in the pose home.
    """
    chain = model.chain
    q = model.chain_pose("home") if "home" in model.poses else chain.middle()
    R = chain.forward(q)[:3, :3]
    outward = R.T @ _reach(chain, q)
    ahead = _nearest_axis(outward)
    others = [axis for axis in np.eye(3) if abs(float(axis @ ahead)) < 0.5]
    left = min(others, key=lambda axis: abs(float((R @ axis)[2])))
    upside_down = float((R @ np.cross(ahead, left))[2]) < 0.0
    return Tool(ahead, -left if upside_down else left)


def _level(heading_rad: float) -> Vector:
    """Return the level direction (3,) to the left of a heading."""
    return np.array([-math.sin(heading_rad), math.cos(heading_rad), 0.0])


def _reach(chain: Chain, q: Vector) -> Vector:
    """Return the way (3,) from the last joint that swings the tip to the tip, world axes."""
    J = chain.jacobian(q)
    swinging = np.flatnonzero(np.linalg.norm(J[:3], axis=0) > _SWINGS_M_PER_RAD)
    last = int(swinging[-1]) if len(swinging) else chain.dof - 1
    axis, speed = J[3:, last], J[:3, last]
    # The tip's speed about an axis is axis x arm; so speed x axis is the arm across the axis.
    arm: Vector = np.cross(speed, axis)
    return arm if float(np.linalg.norm(arm)) > 0.0 else speed


def _nearest_axis(v: Vector) -> Vector:
    axis = np.zeros(3)
    strongest = int(np.argmax(np.abs(v)))
    axis[strongest] = math.copysign(1.0, float(v[strongest]))
    return axis
