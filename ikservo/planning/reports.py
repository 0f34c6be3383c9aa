"""Results as values: the state of an arm, and progress and result of a motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ikservo.control.joint_reading import JointState
from ikservo.errors import UnknownNameError, format_point
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class ArmState(FrozenArrays):
    """The measured state of the arm as a tuple of joints, as arrays, and by joint name.

    Arrays have one element per joint, (n,), in the order of ``names``; rad, or m for prismatic
    joints. ``state["elbow_flex"]`` is the state of one joint.

    Attributes:
        tip_m: The tip (3,), metres, base frame.
        joints: The joints from base to tip, the gripper last.
        orientation: The orientation of the tool, R_base_tip (3, 3); NaN if it is unknown.
    """

    tip_m: Vector
    joints: tuple[JointState, ...]
    orientation: Matrix = field(default_factory=lambda: np.full((3, 3), np.nan))

    def __getitem__(self, joint: str) -> JointState:
        """Return the state of one joint.

        Raises:
            UnknownNameError: There is no such joint.
        """
        by_name = self.by_name
        if joint not in by_name:
            raise UnknownNameError("joint", joint, by_name)
        return by_name[joint]

    @property
    def names(self) -> tuple[str, ...]:
        """The joints' names, in the order used in the arrays."""
        return tuple(joint.name for joint in self.joints)

    @property
    def by_name(self) -> dict[str, JointState]:
        """The joints' states by name."""
        return {joint.name: joint for joint in self.joints}

    @property
    def positions(self) -> dict[str, float]:
        """The measured positions by joint, rad or m, in the form that ``move_joints`` accepts."""
        return {joint.name: joint.position_rad for joint in self.joints}

    @property
    def positions_rad(self) -> Vector:
        """The measured positions (n,)."""
        return np.array([joint.position_rad for joint in self.joints])

    @property
    def lower_rad(self) -> Vector:
        """The lower limits (n,)."""
        return np.array([joint.lower_rad for joint in self.joints])

    @property
    def upper_rad(self) -> Vector:
        """The upper limits (n,)."""
        return np.array([joint.upper_rad for joint in self.joints])

    @property
    def temperatures_c(self) -> Vector:
        """The servos' temperatures (n,), °C."""
        return np.array([joint.temperature_c for joint in self.joints])

    @property
    def voltages_v(self) -> Vector:
        """The supply voltages of the servos (n,), V."""
        return np.array([joint.voltage_v for joint in self.joints])

    @property
    def loads_percent(self) -> Vector:
        """The loads of the servos (n,); see ``JointState``. NaN if a servo reports no load."""
        loads = (joint.load_percent for joint in self.joints)
        return np.array([np.nan if load is None else load for load in loads])

    @property
    def torque(self) -> NDArray[np.bool_]:
        """Whether each servo holds (n,)."""
        return np.array([joint.torque for joint in self.joints])

    def __str__(self) -> str:
        """Show the tip, the positions and the torque."""
        positions = ", ".join(f"{name} {at:z.3f}" for name, at in self.positions.items())
        return f"tip {format_point(self.tip_m)}; {positions}; {describe_torque(self.joints)}"

    def __repr__(self) -> str:
        """Show the tip and the positions; ``joints`` contains the other values."""
        positions = ", ".join(f"{name}: {at:.4f}" for name, at in self.positions.items())
        tip = ", ".join(f"{x:z.4f}" for x in self.tip_m)
        return f"ArmState(tip_m=({tip}), positions={{{positions}}})"


@dataclass(frozen=True, slots=True, eq=False)
class MotionProgress(FrozenArrays):
    """The state of a motion in one control cycle.

    Attributes:
        elapsed_s: Time along the trajectory; it lags the clock if the motion was slowed down.
        duration_s: The duration of the whole motion; infinite for a motion that continues until it
            is ended.
        tip_m: The measured tip (3,), metres, base frame.
        joints_rad: The measured joints (n,), rad or m; the last position if a reply is missing.
        setpoints_rad: The setpoints of the joints (n,); the servos' goals lead them by the effect
            of load and friction.
        names: Names of the joints, in the order used in the arrays.
    """

    elapsed_s: float
    duration_s: float
    tip_m: Vector
    joints_rad: Vector = field(default_factory=lambda: np.zeros(0))
    setpoints_rad: Vector = field(default_factory=lambda: np.zeros(0))
    names: tuple[str, ...] = ()

    @property
    def positions(self) -> dict[str, float]:
        """The measured positions by joint, rad or m."""
        return dict(zip(self.names, self.joints_rad.tolist(), strict=True))


OnProgress = Callable[[MotionProgress], None]
"""Called in every control cycle, in the thread that moves the arm."""


@dataclass(frozen=True, slots=True, eq=False)
class MoveResult(FrozenArrays):
    """Report on a motion to a point.

    Attributes:
        target_m: The requested point (3,), metres, base frame.
        commanded_tip_m: The tip (3,) at the solver's joints.
        measured_tip_m: The tip (3,) at the measured joint positions.
        error_m: Distance from the target to the measured tip.
        duration_s: Time from the first goal to rest.
        reached: Whether the error is within the arm's tolerance.
        binding: The active limits of the solution, and the joints that did not arrive.
        orientation_error_rad: The largest angle between the tool and its requested orientation.
        motion_s: Time from the first goal to the planned end of the motion.
        settling_s: Time from the planned end until every joint had settled.
        orientation_requested: Whether an orientation of the tool was requested.
        orientation_change_rad: The angle between the tool's orientations at start and end.
        path_error_rms_m: The distance from the measured tip to the commanded path, root mean square
            over the control cycles; a lag along the path is not an error. None if the tip followed
            no Cartesian path.
        path_error_max_m: The largest distance in a control cycle.
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
    path_error_rms_m: float | None = None
    path_error_max_m: float | None = None

    def __str__(self) -> str:
        """Show the error and the duration; ``repr`` shows all fields."""
        off = f"{1e3 * self.error_m:.1f} mm from {format_point(self.target_m)}"
        return _ended(self.reached, off, self.duration_s, self.binding)


@dataclass(frozen=True, slots=True, eq=False)
class JointMoveResult(FrozenArrays):
    """Report on a joint motion; rad, or m for prismatic joints.

    Attributes:
        goal_rad: The requested joint goals.
        measured_rad: The measured positions of these joints.
        measured_tip_m: The tip (3,) at the measured joint positions.
        error_rad: The largest error of a joint.
        duration_s: Time from the first goal to rest.
        reached: Whether every joint is within its tolerance.
        binding: The joints that did not arrive.
    """

    goal_rad: dict[str, float]
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    error_rad: float
    duration_s: float
    reached: bool
    binding: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Show the error and the duration; ``repr`` shows all fields."""
        off = f"{', '.join(self.goal_rad)} off by at most {self.error_rad:.4f}"
        return _ended(self.reached, off, self.duration_s, self.binding)


@dataclass(frozen=True, slots=True)
class GraspResult:
    """Report on a motion of the gripper.

    Attributes:
        grasped: Whether the closing jaws were blocked before their goal for half a second, usually
            by an object between them. Jaws whose friction exceeds their force look the same to the
            servo; in that case, try more force.
        reached: Whether the jaws are at their goal.
        position_rad: The position of the gripper's joint, rad or m.
        width_m: The distance between the jaws; None if the arm file has no widths.
        load_percent: The load of the servo, in percent of its maximum torque or current.
        force: The fraction of its maximum torque that the servo may use.
        duration_s: The duration of the motion.
    """

    grasped: bool
    reached: bool
    position_rad: float
    width_m: float | None
    load_percent: float | None
    force: float
    duration_s: float

    def __str__(self) -> str:
        """Show whether something is grasped, and where; ``repr`` shows all fields."""
        at = f"{self.position_rad:.3f}" if self.width_m is None else f"{1e3 * self.width_m:.1f} mm"
        return (
            f"{'grasped' if self.grasped else 'nothing grasped'} at {at}; {self.duration_s:.1f} s"
        )


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult(FrozenArrays):
    """Report on the replay of a recording.

    Attributes:
        samples: The number of samples in the recording.
        duration_s: The duration of the replay.
        slowdown: The factor by which the replay was slower than the recording, because the
            recording exceeded the limits.
        error_rad: The largest error of a joint at the last sample, rad or m.
        measured_rad: The joints at the end, rad or m by name.
        measured_tip_m: The tip at the end (3,), metres.
    """

    samples: int
    duration_s: float
    slowdown: float
    error_rad: float
    measured_rad: dict[str, float]
    measured_tip_m: Vector

    def __str__(self) -> str:
        """Show the length and the error; ``repr`` shows all fields."""
        slower = f", {self.slowdown:.1f} times slower than recorded" if self.slowdown > 1 else ""
        return (
            f"{self.samples} samples in {self.duration_s:.1f} s{slower}; error {self.error_rad:.4f}"
        )


def _ended(reached: bool, off: str, duration_s: float, binding: Sequence[str]) -> str:
    held = f" ({', '.join(binding)})" if binding else ""
    return f"{'reached' if reached else 'not reached'}: {off}{held}; {duration_s:.1f} s"


def describe_alarms(states: Sequence[JointState]) -> list[tuple[str, str]]:
    """Group the servos that report alarms; return the names and the alarms of each group."""
    by_alarms: dict[str, list[str]] = {}
    for state in states:
        by_alarms.setdefault(", ".join(state.alarms), []).append(state.name)
    return [(", ".join(names), each) for each, names in by_alarms.items() if each]


def describe_torque(states: Sequence[JointState]) -> str:
    """Return ``torque stays on``, or a text with the names of the servos without torque."""
    limp = [state.name for state in states if not state.torque]
    if not limp:
        return "torque stays on"
    if len(limp) == len(states):
        return "torque is off; the arm is limp"
    return f"the torque of {', '.join(limp)} is off"


@dataclass(frozen=True, slots=True, eq=False)
class FollowResult(FrozenArrays):
    """Report on how the arm followed a stream of targets.

    Attributes:
        setpoints: The number of targets.
        unreached: The number of targets out of reach; the arm moved as close to them as it could.
        refused: The number of targets that the guard refused; the arm kept the previous one.
        reason: The reason for the last refusal.
        ended: The reason for the end: the end of the stream, or a time-out.
        measured_rad: The joints at the end, corrected, rad or m by name.
        measured_tip_m: The tip at the end (3,), metres.
        duration_s: Time from the first target to rest, including the correction.
        warnings: The warnings during the motion: a servo is hot, or is about to protect itself.
    """

    setpoints: int
    unreached: int
    refused: int
    reason: str
    ended: str
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    duration_s: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class JogResult(FrozenArrays):
    """Report on a jog.

    Attributes:
        ended: The reason for the end: no longer requested, a limit, or the message from the guard.
        blocked: Whether the jog cannot continue in this direction because a limit or the guard
            ended it.
        measured_rad: The joints at the end, rad or m by name.
        measured_tip_m: The tip at the end (3,), metres.
        duration_s: The duration of the jog.
    """

    ended: str
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    duration_s: float
    blocked: bool = False
