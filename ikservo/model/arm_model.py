"""Model of an arm: joints, servos, gripper, health limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ikservo.calibration import JointMap, Limits
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.urdf_types import Urdf
from ikservo.registers import MODELS, Family


@dataclass(frozen=True, slots=True)
class Gripper:
    """The joint that moves the jaws.

    Attributes:
        joint: The name of this joint.
        closed: The position at which the jaws meet, rad or m; the end of its range on that side.
        open: The position at which the jaws are furthest apart.
        widths: Pairs of a position [rad or m] and the distance between the jaws there [m], sorted
            by position and interpolated linearly; empty if not measured.
    """

    joint: str
    closed: float
    open: float
    widths: tuple[tuple[float, float], ...] = ()

    def width_m(self, position: float) -> float | None:
        """Compute the distance between the jaws at a position, metres; None if it is unknown."""
        if not self.widths:
            return None
        positions, widths_m = zip(*self.widths, strict=True)
        return float(np.interp(position, positions, widths_m))

    def range_m(self) -> tuple[float, float] | None:
        """Return the smallest and the largest distance between the jaws, if known."""
        closed_m, open_m = self.width_m(self.closed), self.width_m(self.open)
        if closed_m is None or open_m is None:
            return None
        return min(closed_m, open_m), max(closed_m, open_m)

    def position(self, width_m: float) -> float:
        """Compute the joint position for a jaw opening; the widths must be known."""
        rows: Sequence[tuple[float, float]] = sorted(self.widths, key=lambda row: row[1])
        positions, widths_m = zip(*rows, strict=True)
        return float(np.interp(width_m, widths_m, positions))


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """Thresholds at which the arm warns, holds or relaxes; ``[health]`` in the arm file.

    Attributes:
        warn_c: Temperature from which the user is warned.
        hold_c: Temperature from which the arm holds and accepts no more goals.
        release_c: Temperature from which the arm moves to rest, if it can, and switches torque off.
        load_percent: Load, as a percentage of the maximum, that a servo may exceed only for
            ``load_s``.
        load_s: Time from which a load above ``load_percent`` is an overload.
        low_v: Minimum supply, in addition to the servo's own limit.
        high_v: Maximum supply, in addition to the servo's own limit.
    """

    warn_c: float = 60.0
    hold_c: float = 65.0
    release_c: float = 70.0
    load_percent: float = 90.0
    load_s: float = 3.0
    low_v: float = 0.0
    high_v: float = math.inf


_T = TypeVar("_T")
_USUAL_HEALTH = HealthLimits()


@dataclass(frozen=True, slots=True)
class ModelServo:
    """A servo as the arm file describes it.

    Attributes:
        id: The id on the bus.
        model: The model name, see ``ikservo.registers.MODELS``.
        eeprom: Raw values that its registers must hold.
    """

    id: int
    model: str
    eeprom: Mapping[str, int]

    @property
    def measures_current(self) -> bool:
        """Whether the servo has a sensor for its motor's current."""
        return "present_current" in MODELS[self.model].registers


@dataclass(frozen=True, slots=True)
class ModelJoint:
    """A joint with a servo.

    Attributes:
        limits: The range in the arm file's URDF.
        joint_map: The conversion of ticks and positions, as in the arm file.
        travel_per_turn: Largest joint motion per revolution of the horn, rad or m.
        backlash: Free motion felt by hand while the servo holds, rad or m; 0 if not measured.
        shadows: Further servos that drive the joint together with the first servo.
        zero_from: ``vendor`` if the maker fixes the zero, ``nominal`` if each arm differs.
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
class SpeedClass:
    """The limits of revolute joints in one speed class."""

    rad_s: float
    rad_s2: float
    rad_s3: float


class Obstacle(Protocol):
    """A thing that the arm must not touch."""

    @property
    def name(self) -> str:
        """Name for messages, such as ``the cup``."""
        ...

    @property
    def low_m(self) -> tuple[float, float, float]:
        """Lowest corner (3,) of the axis-aligned bounding box, metres, base frame."""
        ...

    @property
    def high_m(self) -> tuple[float, float, float]:
        """Highest corner (3,) of the axis-aligned bounding box, metres, base frame."""
        ...

    @property
    def row(self) -> Vector:
        """The obstacle as a row (17,) for the kernels; see ``kinematics.packed``."""
        ...


@dataclass(frozen=True, slots=True)
class KeepOutBox:
    """An upright box that the arm must not touch.

    Attributes:
        name: Name for messages, such as ``the cup``.
        low_m: The lowest corner (3,), metres, base frame.
        high_m: The highest corner (3,).

    Raises:
        BadValueError: A corner is not finite, or low_m is not below high_m.
    """

    name: str
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        corners = np.array([self.low_m, self.high_m], dtype=np.float64)
        if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
            raise BadValueError(f"The box {self.name}", corners.tolist(), "finite low < high")

    @property
    def row(self) -> Vector:
        """The box as a row (17,) for the kernels; see ``kinematics.packed``."""
        low, high = np.array(self.low_m), np.array(self.high_m)
        return np.array([*np.eye(3).ravel(), *0.5 * (low + high), *0.5 * (high - low), 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Model:
    """An arm: geometry and, if an arm file gives them, servos.

    Attributes:
        chain: The chain from the base to the tool, with the limits of the arm file.
        joints: Every joint with a servo, base to tip, gripper last; empty for a plain URDF.
        poses: Joint positions by pose and joint, rad or m.
        speeds: The speed classes by name: slow, normal, fast.
        family: The protocol family of the servos; None for a plain URDF.
        baud_rate: The baud rate of the bus, bit/s.
        supply_v: Supply voltage of servos that are sold for several voltages; None if the arm file
            does not give it.
        path: The file from which the model was loaded.
        floor_m: Height of the table in the base frame; None if not given.
        keep_out: Further obstacles.
        health: The health limits of the servos.
        auto_unsafe: The reason why the arm must not search for end stops; empty if it may.
        gripper: The gripper; None for an arm without one.
        base_frame: The reason why the base frame differs from the convention of the catalogue (x
            forward, y left, z up, origin on the first axis at the mounting surface); empty if it
            does not.
        payload_kg: The heaviest payload at the tool that the servos must lift.
    """

    name: str
    title: str
    chain: Chain
    urdf: Urdf
    joints: tuple[ModelJoint, ...]
    poses: Mapping[str, Mapping[str, float]]
    speeds: Mapping[str, SpeedClass]
    family: Family | None
    baud_rate: int
    path: Path
    supply_v: float | None = None
    floor_m: float | None = None
    keep_out: tuple[Obstacle, ...] = ()
    health: HealthLimits = _USUAL_HEALTH
    auto_unsafe: str = ""
    gripper: Gripper | None = None
    base_frame: str = ""
    payload_kg: float = 0.0

    def __post_init__(self) -> None:
        poses = {name: MappingProxyType(dict(pose)) for name, pose in self.poses.items()}
        object.__setattr__(self, "poses", MappingProxyType(poses))
        object.__setattr__(self, "speeds", MappingProxyType(dict(self.speeds)))

    @classmethod
    def from_geometry(cls, name: str, title: str, chain: Chain, urdf: Urdf, path: Path) -> Model:
        """Make an arm from its geometry only, without servos, poses or speeds."""
        return cls(name, title, chain, urdf, (), {}, {}, None, 0, path)

    def __repr__(self) -> str:
        """Return the model's name, joints and poses as text."""
        joints = ", ".join(joint.name for joint in self.joints) or ", ".join(self.chain.names)
        poses = ", ".join(self.poses) or "none"
        return f"Model({self.name!r}: {self.title}; joints {joints}; poses {poses})"

    def joint(self, name: str) -> ModelJoint:
        """Return the joint that has this name.

        Raises:
            UnknownNameError: The arm has no servo for such a joint.
        """
        return _find_named("joint", name, {joint.name: joint for joint in self.joints})

    def pose(self, name: str) -> Mapping[str, float]:
        """Return the joint positions of a named pose, rad or m by joint.

        Raises:
            UnknownNameError: The arm has no such pose.
        """
        return _find_named("pose", name, self.poses)

    def speed(self, name: str) -> SpeedClass:
        """Return a speed class.

        Raises:
            UnknownNameError: The speed is not slow, normal or fast.
        """
        return _find_named("speed", name, self.speeds)

    def initial_joints(self) -> NDArray[np.float64]:
        """Return joints (dof,) inside the limits, from which the search for a solution starts.

        The start is the pose ``home``, or the middle of the ranges if there is no such pose.
        """
        has_home = "home" in self.poses
        return self.chain.clip(self.chain_pose("home")) if has_home else self.chain.mid_range()

    def chain_pose(self, name: str) -> NDArray[np.float64]:
        """Compute the joint vector (dof,) of the chain at a named pose."""
        pose = self.pose(name)
        return np.array([pose[joint] for joint in self.chain.names])


def _find_named(kind: str, name: object, known: Mapping[str, _T]) -> _T:
    if not isinstance(name, str) or name not in known:
        raise UnknownNameError(kind, name, known)
    return known[name]


def link_masses(model: Model, chain: Chain) -> list[LinkMass]:
    """Return the masses and inertia of a chain's links; links without a mass are omitted."""
    masses: list[LinkMass] = []
    for link in model.urdf.links:
        if link.mass_kg > 0 and link.name in chain.frames:
            ixx, ixy, ixz, iyy, iyz, izz = link.inertia_kg_m2
            inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
            R = rotation_rpy(*link.inertia_rpy_rad)  # inertia frame to link frame
            masses.append(
                LinkMass(link.name, link.mass_kg, np.array(link.com_m), R @ inertia @ R.T)
            )
    return masses
