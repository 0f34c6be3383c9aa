"""Which way a joint goes, in words that a person standing at the arm understands."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.se3 import Vector
from ikservo.model.model import Model, ModelJoint

__all__ = ["axes", "direction"]

# A joint that moves the tip by less than this for a radian rolls the tool.
_ROLLS_M_PER_RAD = 0.03
_AHEAD_M = 0.01
_WORDS = (
    ("forwards", "back"),
    ("to the left (seen from behind the base)", "to the right (seen from behind the base)"),
    ("up", "down"),
)


def direction(model: Model, joint: ModelJoint, pose: str, towards: int) -> str:
    """Return how to move a joint from a pose so that its position grows, or falls.

    Forwards is where the tool is in the pose ``home``, seen from the base; left is the left of
    somebody who looks that way.

    Args:
        model: The arm.
        joint: Which of its joints.
        pose: Where the arm is; a named pose.
        towards: +1 for growing positions, -1 for falling ones.
    """
    if joint.name not in model.chain.names:
        return _of_gripper(model, joint, towards)
    column = model.chain.names.index(joint.name)
    T, J = model.chain.linearise(model.chain_pose(pose))
    speed: Vector = towards * (axes(model) @ J[:3, column])
    if float(np.linalg.norm(speed)) < _ROLLS_M_PER_RAD:
        axis: Vector = towards * J[3:, column]
        return _of_roll(axis, T[:3, 3] - _origin(model, joint, pose))
    along = int(np.argmax(np.abs(speed)))
    return f"so that the tool goes {_WORDS[along][0 if speed[along] > 0 else 1]}"


def axes(model: Model) -> Vector:
    """Return forwards, left and up as the rows (3, 3) of a matrix, in the base frame."""
    tip: Vector = model.chain.forward(model.chain_pose("home"))[:3, 3]
    ahead = np.array([tip[0], tip[1], 0.0])
    length = float(np.linalg.norm(ahead))
    ahead = np.array([1.0, 0.0, 0.0]) if length < _AHEAD_M else ahead / length
    up = np.array([0.0, 0.0, 1.0])
    return np.array([ahead, np.cross(up, ahead), up])


def _of_roll(axis: Vector, ahead: Vector) -> str:
    """Name a roll as seen from behind the tool: about an axis that points ahead it is clockwise."""
    turn = "clockwise" if float(axis @ ahead) > 0.0 else "counter-clockwise"
    return f"{turn}, seen along the tool"


def _of_gripper(model: Model, joint: ModelJoint, towards: int) -> str:
    """Open is the way from the pose rest to the pose home."""
    opening = model.pose("home")[joint.name] - model.pose("rest")[joint.name]
    return "so that it opens" if opening * towards >= 0.0 else "so that it closes"


def _origin(model: Model, joint: ModelJoint, pose: str) -> Vector:
    child = next(j.child for j in model.urdf.joints if j.name == joint.name)
    origin: Vector = model.chain.forward(model.chain_pose(pose), frame=child)[:3, 3]
    return origin
