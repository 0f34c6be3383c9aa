"""What an arm is: its chain, the servos that turn it, its limits, poses and speeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ikservo.calibration import JointMap, Limits
from ikservo.errors import UnknownNameError
from ikservo.kinematics import Chain
from ikservo.model.gripper import Gripper
from ikservo.model.health import HealthLimits
from ikservo.model.urdf import Urdf
from ikservo.registers import Family

__all__ = ["KeepOut", "Model", "ModelJoint", "ModelServo", "Speed"]

_T = TypeVar("_T")
_USUAL_HEALTH = HealthLimits()


@dataclass(frozen=True, slots=True)
class ModelServo:
    """A servo as the arm file describes it.

    Attributes:
        id: Its bus id.
        model: Its model name, see ``ikservo.registers.MODELS``.
        eeprom: Raw register values it must hold.
    """

    id: int
    model: str
    eeprom: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class ModelJoint:
    """A joint that a servo turns.

    Attributes:
        limits: The range the arm file's URDF gives.
        joint_map: How the servo's ticks relate to the joint, as the arm file gives it.
        travel_per_turn: What one turn of the horn is worth at most: rad, or metres of a slide.
        backlash: How far the joint can be moved by hand while its servo holds, rad or m; 0 where
            nobody has measured it.
        shadows: Servos that turn the same joint together with the first.
        zero_from: ``vendor`` where the maker fixes the zero, ``nominal`` where each arm differs.
    """

    name: str
    role: Literal["arm", "gripper"]
    limits: Limits
    joint_map: JointMap
    travel_per_turn: float
    backlash: float
    servo: ModelServo
    shadows: tuple[ModelServo, ...]
    zero_from: Literal["vendor", "nominal"]


@dataclass(frozen=True, slots=True)
class Speed:
    """How fast revolute joints go in one speed class."""

    rad_s: float
    rad_s2: float
    rad_s3: float


@dataclass(frozen=True, slots=True)
class KeepOut:
    """An upright box that the arm keeps out of: its corners, metres, base frame."""

    name: str
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Model:
    """An arm: geometry and, where an arm file gives them, servos.

    Attributes:
        chain: From the base to the tool, inside the arm file's limits.
        joints: Every joint with a servo, base to tip, gripper last; empty for a bare URDF.
        poses: Joint positions by pose and joint, rad or m.
        speeds: By name: slow, normal, fast.
        family: The dialect its servos speak; None for a bare URDF.
        baud_rate: Of its bus, bits a second.
        path: The file it was loaded from.
        floor_m: Height of the table in the base frame; None where nobody says.
        keep_out: What else the arm keeps clear of.
        health: What its servos may be asked to bear.
        auto_unsafe: Why it must not look for its own stops; empty where it may.
        gripper: What is known of its jaws; None where no servo moves any.
        base_frame: How the base frame differs from the convention of the catalogue, and why; empty
            where it does not: x forward, y left, z up, origin on the first axis at the mounting
            surface.
    """

    name: str
    title: str
    chain: Chain
    urdf: Urdf
    joints: tuple[ModelJoint, ...]
    poses: Mapping[str, Mapping[str, float]]
    speeds: Mapping[str, Speed]
    family: Family | None
    baud_rate: int
    path: Path
    floor_m: float | None = None
    keep_out: tuple[KeepOut, ...] = ()
    health: HealthLimits = _USUAL_HEALTH
    auto_unsafe: str = ""
    gripper: Gripper | None = None
    base_frame: str = ""

    @classmethod
    def bare(cls, name: str, title: str, chain: Chain, urdf: Urdf, path: Path) -> Model:
        """Return an arm of which only the geometry is known: no servos, poses or speeds."""
        return cls(name, title, chain, urdf, (), {}, {}, None, 0, path)

    def __repr__(self) -> str:
        """Return its name, joints and poses; the attributes tell the rest."""
        joints = ", ".join(joint.name for joint in self.joints) or ", ".join(self.chain.names)
        poses = ", ".join(self.poses) or "none"
        return f"Model({self.name!r}: {self.title}; joints {joints}; poses {poses})"

    def joint(self, name: str) -> ModelJoint:
        """Return the joint of that name.

        Raises:
            UnknownNameError: No servo turns such a joint.
        """
        return _found("joint", name, {joint.name: joint for joint in self.joints})

    def pose(self, name: str) -> Mapping[str, float]:
        """Return the joint positions of a named pose, rad or m by joint.

        Raises:
            UnknownNameError: The arm has no such pose.
        """
        return _found("pose", name, self.poses)

    def speed(self, name: str) -> Speed:
        """Return a speed class.

        Raises:
            UnknownNameError: Not slow, normal or fast.
        """
        return _found("speed", name, self.speeds)

    def chain_pose(self, name: str) -> NDArray[np.float64]:
        """Return the joint vector (dof,) of the chain at a named pose."""
        pose = self.pose(name)
        return np.array([pose[joint] for joint in self.chain.names])


def _found(kind: str, name: object, known: Mapping[str, _T]) -> _T:
    if not isinstance(name, str) or name not in known:
        raise UnknownNameError(kind, name, known)
    return known[name]
