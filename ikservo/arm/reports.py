"""What the arm says about itself and about a motion, as values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ikservo.control.feedback import JointState
from ikservo.errors import UnknownNameError
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["ArmState", "JointMoveResult", "MotionProgress", "MoveResult"]


def _unknown_pose() -> Matrix:
    return np.full((3, 3), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """Where the arm is, measured: as a tuple of joints, as arrays, and by joint name.

    Arrays have one element for each joint, (n,), in the order of ``names``; rad, or m for
    prismatic joints. ``here["elbow_flex"]`` is the state of one joint.

    Attributes:
        tip_m: The tip (3,), metres, base frame.
        joints: Base to tip, gripper last.
        orientation: How the tool is turned, R_base_tip (3, 3); NaN where it was not told.
    """

    tip_m: Vector
    joints: tuple[JointState, ...]
    orientation: Matrix = field(default_factory=_unknown_pose)

    def __getitem__(self, joint: str) -> JointState:
        """Return the state of one joint.

        Raises:
            UnknownNameError: No such joint.
        """
        by_name = self.by_name
        if joint not in by_name:
            raise UnknownNameError("joint", joint, by_name)
        return by_name[joint]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the joints' names, in the order of the arrays."""
        return tuple(joint.name for joint in self.joints)

    @property
    def by_name(self) -> dict[str, JointState]:
        """Return the joints' states by name."""
        return {joint.name: joint for joint in self.joints}

    @property
    def positions(self) -> dict[str, float]:
        """Return the measured positions by joint, rad or m: what ``move_joints`` takes."""
        return {joint.name: joint.position_rad for joint in self.joints}

    @property
    def positions_rad(self) -> Vector:
        """Return the measured positions (n,)."""
        return np.array([joint.position_rad for joint in self.joints])

    @property
    def lower_rad(self) -> Vector:
        """Return the lower limits (n,)."""
        return np.array([joint.lower_rad for joint in self.joints])

    @property
    def upper_rad(self) -> Vector:
        """Return the upper limits (n,)."""
        return np.array([joint.upper_rad for joint in self.joints])

    @property
    def temperatures_c(self) -> Vector:
        """Return the servos' temperatures (n,), °C."""
        return np.array([joint.temperature_c for joint in self.joints])

    @property
    def voltages_v(self) -> Vector:
        """Return the servos' supply (n,), volts."""
        return np.array([joint.voltage_v for joint in self.joints])

    @property
    def loads_percent(self) -> Vector:
        """Return the servos' loads (n,), see ``JointState``; NaN where a servo tells none."""
        loads = (joint.load_percent for joint in self.joints)
        return np.array([np.nan if load is None else load for load in loads])

    @property
    def torque(self) -> NDArray[np.bool_]:
        """Return whether each servo holds (n,)."""
        return np.array([joint.torque for joint in self.joints])

    def __repr__(self) -> str:
        """Return the tip and the positions; the rest is in ``joints``."""
        positions = ", ".join(f"{name}: {at:.4f}" for name, at in self.positions.items())
        tip = ", ".join(f"{x:z.4f}" for x in self.tip_m)
        return f"ArmState(tip_m=({tip}), positions={{{positions}}})"


@dataclass(frozen=True, slots=True, eq=False)
class MotionProgress:
    """The state of a motion in one control cycle.

    Attributes:
        elapsed_s: Time of the motion; behind the clock where it was slowed down.
        duration_s: Of the whole motion; infinite for one that goes on until it is ended.
        tip_m: The measured tip (3,), metres, base frame.
        joints_rad: The measured joints (n,), rad or m; without an answer, as last measured.
        setpoints_rad: Where the servos were told to go (n,).
        names: The joints, in the order of the arrays.
    """

    elapsed_s: float
    duration_s: float
    tip_m: Vector
    joints_rad: Vector = field(default_factory=lambda: np.zeros(0))
    setpoints_rad: Vector = field(default_factory=lambda: np.zeros(0))
    names: tuple[str, ...] = ()

    @property
    def positions(self) -> dict[str, float]:
        """Return the measured joints by name, rad or m."""
        return dict(zip(self.names, self.joints_rad.tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class MoveResult:
    """How a motion to a point ended.

    Attributes:
        target_m: What was asked (3,), metres, base frame.
        commanded_tip_m: Where the solver's joints put the tip (3,).
        measured_tip_m: Where the servos' own positions put it (3,).
        error_m: From the target to the measured tip.
        duration_s: From the first goal to rest.
        reached: Whether the error is within the arm's tolerance.
        binding: The limits the solution stands at, and the joints that did not arrive, in words.
        orientation_error_rad: How far the tool is turned from how it should stand, at most.
        motion_s: From the first goal to the planned end of the motion.
        settling_s: From there until every joint stood where it belongs.
        orientation_requested: Whether an orientation of the tool was requested.
        orientation_change_rad: How far the tool is turned from where it began.
    """

    target_m: Vector
    commanded_tip_m: Vector
    measured_tip_m: Vector
    error_m: float
    duration_s: float
    reached: bool
    binding: tuple[str, ...]
    orientation_error_rad: float = 0.0
    motion_s: float = 0.0
    settling_s: float = 0.0
    orientation_requested: bool = False
    orientation_change_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class JointMoveResult:
    """How a motion of joints ended; rad, or m for prismatic joints.

    Attributes:
        goal_rad: What was asked of each joint that was named.
        measured_rad: Where those joints are.
        measured_tip_m: Where the servos' own positions put the tip (3,).
        error_rad: The largest difference of a revolute or prismatic joint.
        duration_s: From the first goal to rest.
        reached: Whether every joint is within its tolerance.
        binding: The joints that did not arrive, in words.
    """

    goal_rad: dict[str, float]
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    error_rad: float
    duration_s: float
    reached: bool
    binding: tuple[str, ...] = ()
