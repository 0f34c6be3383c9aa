"""Joints of a chain: type, axis, mimic relation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ikservo.errors import InputError, UnknownNameError
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector, read_only
from ikservo.kinematics.se3 import make_pose, skew


class JointType(Enum):
    """Type of a joint; URDF's continuous joint is REVOLUTE without limits."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another joint: ``q = multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint(FrozenArrays):
    """One joint of the tree.

    Attributes:
        origin: T_parent_joint (4, 4) at ``q = 0``.
        axis: Unit axis (3,) in the joint's frame; unused by fixed joints.
        lower: Lower limit, rad or m; ``-inf`` for a continuous joint.
        upper: Upper limit, rad or m.
        mimic: The relation to the joint that it follows; None if it moves by itself.
    """

    name: str
    kind: JointType
    parent: str
    child: str
    origin: Matrix
    axis: Vector
    lower: float = -math.inf
    upper: float = math.inf
    mimic: Mimic | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ChainJoint:
    """One joint on the path to a frame: its value is ``scale * q[column] + shift``.

    Attributes:
        joint: The joint.
        column: The entry of q that moves it; unused if ``scale`` is 0.
        scale: 1, or the multiplier of a mimic; 0 for a joint that is held or fixed.
        shift: Offset of the value, rad or m.
        twist_matrix: The joint's twist (4, 4): the skew matrix of its axis, or for a prismatic
            joint the axis as a translation.
    """

    joint: Joint
    column: int
    scale: float
    shift: float
    twist_matrix: Matrix = field(init=False)
    _twist_squared: Matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        twist = np.zeros((4, 4))
        if self.joint.kind is JointType.REVOLUTE:
            twist[:3, :3] = skew(self.joint.axis)
        elif self.joint.kind is JointType.PRISMATIC:
            twist[:3, 3] = self.joint.axis
        object.__setattr__(self, "twist_matrix", read_only(twist))
        object.__setattr__(self, "_twist_squared", read_only(twist @ twist))

    def value(self, q: Vector) -> Vector:
        """Compute the joint's value () or (n,) for q (dof,) or (n, dof)."""
        return self.scale * q[..., self.column] + self.shift

    def motion(self, q: Vector) -> Matrix:
        """Compute the joint's own motion (4, 4) or (n, 4, 4): ``exp(value * twist)``.

        For a rotation this is Rodrigues' formula I + sin W + (1 - cos) W².
        """
        value = np.asarray(self.value(q))[..., None, None]
        if self.joint.kind is not JointType.REVOLUTE:
            return _IDENTITY + value * self.twist_matrix
        return (
            _IDENTITY
            + np.sin(value) * self.twist_matrix
            - (np.cos(value) - 1.0) * self._twist_squared
        )

    def motion_at(self, value: float) -> Matrix:
        """Return the joint's own motion (4, 4) at one value."""
        return ChainJoint(self.joint, 0, 0.0, value).motion(_ORIGIN)

    def jacobian_column(self, T_world_joint: Matrix, point_m: Vector) -> Vector:
        """Return the motion (6,) or (n, 6) of a point per unit of the joint's value."""
        axis = T_world_joint[..., :3, :3] @ self.joint.axis
        if self.joint.kind is JointType.PRISMATIC:
            return np.concatenate([axis, np.zeros_like(axis)], axis=-1)
        return np.concatenate(
            [_cross_product(axis, point_m - T_world_joint[..., :3, 3]), axis], axis=-1
        )


def joints_to_each_link(joints: Sequence[Joint], base: str) -> dict[str, tuple[Joint, ...]]:
    """Return the joints from the base to every connected link, parents first."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    paths: dict[str, tuple[Joint, ...]] = {base: ()}
    waiting = [base]
    while waiting:
        link = waiting.pop()
        for joint in below.get(link, []):
            paths[joint.child] = (*paths[link], joint)
            waiting.append(joint.child)
    return paths


def make_chain_joint(
    joint: Joint, columns: Mapping[str, int], by_name: Mapping[str, Joint]
) -> ChainJoint:
    """Make a joint with its index in q; a mimic has its leader's index, a held joint has none."""
    leader, scale, shift = _resolve_mimic(joint, by_name)
    if leader.name in columns:
        return ChainJoint(joint, columns[leader.name], scale, shift)
    held = min(max(0.0, leader.lower), leader.upper)
    return ChainJoint(joint, 0, 0.0, scale * held + shift)


def effective_limits(moving: Sequence[Joint], joints: Sequence[Joint]) -> list[tuple[float, float]]:
    """Compute the range of each joint that keeps it and all its mimics inside their limits.

    Raises:
        InputError: A follower's limits leave a joint no possible value.
    """
    by_name = {joint.name: joint for joint in joints}
    ranges = {joint.name: (joint.lower, joint.upper) for joint in moving}
    for joint in joints:
        leader, scale, shift = _resolve_mimic(joint, by_name)
        if leader.name in ranges and joint is not leader and scale:
            low, high = ranges[leader.name]
            ends = sorted([(joint.lower - shift) / scale, (joint.upper - shift) / scale])
            ranges[leader.name] = max(low, ends[0]), min(high, ends[1])
    for name, (low, high) in ranges.items():
        if low > high:
            raise InputError(
                f"{name} has no position at which all joints that follow it are within their "
                f"limits.",
                "Check the limits, multipliers and offsets of its mimic joints.",
            )
    return list(ranges.values())


def _resolve_mimic(joint: Joint, by_name: Mapping[str, Joint]) -> tuple[Joint, float, float]:
    """Return the leader, and scale and shift in ``value = scale * leader's value + shift``."""
    scale, shift, leader = 1.0, 0.0, joint
    for _ in by_name:
        if leader.mimic is None:
            break
        if leader.mimic.joint not in by_name:
            raise UnknownNameError("joint", leader.mimic.joint, by_name)
        shift += scale * leader.mimic.offset
        scale *= leader.mimic.multiplier
        leader = by_name[leader.mimic.joint]
    return leader, scale, shift


def _cross_product(a: Vector, b: Vector) -> Vector:
    """Compute a x b over the last axis; NumPy's function is slow for single vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


_IDENTITY = read_only(make_pose(np.zeros(3)))
_ORIGIN = read_only(np.zeros(1))
