"""What the arm says about itself and about a motion, as values."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.kinematics.se3 import Vector

__all__ = ["JointReport", "JointState", "MoveReport", "Progress", "Whereabouts"]


@dataclass(frozen=True, slots=True)
class JointState:
    """One joint as its servo reports it.

    Attributes:
        position_rad: Measured; metres for a prismatic joint.
        lower_rad: Lower limit, same unit.
        upper_rad: Upper limit.
        limit_from: Where the limits come from.
        load_percent: Share of the stall torque or, where the servo measures it, current.
        torque: Whether the servo holds.
        alarms: What the servo complains about, in words.
    """

    name: str
    position_rad: float
    lower_rad: float
    upper_rad: float
    limit_from: str
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    alarms: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Whereabouts:
    """Where the arm is, measured.

    Attributes:
        tip_m: The tip (3,), metres, base frame.
        joints: Base to tip, gripper last.
    """

    tip_m: Vector
    joints: tuple[JointState, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """One beat of a motion, for whoever watches.

    Attributes:
        tip_m: The measured tip (3,), metres.
    """

    elapsed_s: float
    duration_s: float
    tip_m: Vector


@dataclass(frozen=True, slots=True, eq=False)
class MoveReport:
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


@dataclass(frozen=True, slots=True, eq=False)
class JointReport:
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
