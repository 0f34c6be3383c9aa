"""What an arm is made of: joints that turn, slide, follow another or do not move (lecture L1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Joint", "JointKind", "Mimic"]


class JointKind(Enum):
    """How a joint moves its child link; URDF's continuous joint is REVOLUTE without limits."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: ``q = multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint of the tree.

    Attributes:
        origin: T_parent_joint (4, 4) at ``q = 0``.
        axis: Unit axis (3,) in the joint's frame; unused by fixed joints.
        lower: Lower limit, rad or m; ``-inf`` where the joint turns freely.
        upper: Upper limit, rad or m.
        mimic: The joint it follows, if it does not move by itself.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    origin: Matrix
    axis: Vector
    lower: float = -math.inf
    upper: float = math.inf
    mimic: Mimic | None = None
