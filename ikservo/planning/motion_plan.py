"""A motion plan and its preview: path, duration, joints near their limits, start conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ikservo.arguments import parse_number
from ikservo.calibration.joint_limits import near_distance
from ikservo.errors import RefusedError
from ikservo.ik import Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.motion import ConcatenatedTrajectory, JointMove, KinematicLimits, Trajectory
from ikservo.motion.sampled_trajectory import SampledTrajectory, sample_trajectory
from ikservo.planning.motions import MotionValue
from ikservo.planning.tool_speed import ToolSpeed


@dataclass(frozen=True, slots=True)
class NearLimit:
    """A joint that comes close to one of its limits along the path.

    Attributes:
        joint: The joint name.
        side: ``lower`` or ``upper``.
        margin: The distance that the joint keeps from the limit, rad or m.
        unit: ``rad`` or ``m``.
    """

    joint: str
    side: str
    margin: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class MotionPlan(FrozenArrays):
    """A planned motion that could start now.

    Attributes:
        start: The joints (n,) at the start, rad or m.
        goal: The joints (n,) at the end.
        trajectory: The trajectory of all joints, which is streamed exactly as checked.
        tip_m: The tip (3,) at the goal, metres.
        path_m: The length of the tip's path.
        duration_s: The duration of the motion.
        speed: slow, normal or fast.
        time_limiting_joints: The joints that determine the duration, at their top speed or
            acceleration.
        near_limits: The joints that come close to a limit, the closest first.
        target_m: The requested point (3,) of the tip; None for a joint motion.
        solution: The solver's result; None for a joint motion.
        orientation_error_rad: The largest angle between the tool and its requested orientation.
        orientation_requested: Whether an orientation of the tool was requested.
        orientation_change_rad: The angle between the tool's orientations at start and goal.
        speed_reduced: Whether the motion is slower than requested, because the first motion after
            torque on is always slow.
        is_cartesian: Whether the tip moves along straight lines or arcs.
        cartesian_s: Duration of these lines or arcs, which are the last part of the trajectory.
        tool_speed: The speed of the tip along lines or arcs; None if no speed was requested.
        via_pose: The intermediate retract pose; empty if the path is direct.
        around: The contact on the straight path that the plan avoids; empty if it is straight.
        kept: A text for each constraint on the tool: how near the motion comes to its limit.
        clearance_m: Smallest distance on the path between two parts of the arm, or from the arm to
            the table or an obstacle; infinite if paths are not checked.
        planning_s: The time that planning took.
        names: Names of the joints, in the order of ``start`` and ``goal``.
        units: ``rad`` or ``m`` for each joint.
        motion: The requested motion.
        requested: The requested joint goals, rad or m by name; empty for a tip motion.
        clamped: Descriptions of joints that stop at a limit short of the requested pose.
        limp_arm: The context of the limp arm for which the plan was made; None if the arm held. A
            limp arm may sink until its torque comes on; the plan is then made again.
    """

    start: Vector
    goal: Vector
    trajectory: Trajectory
    tip_m: Vector
    path_m: float
    duration_s: float
    speed: str
    time_limiting_joints: tuple[str, ...] = ()
    near_limits: tuple[NearLimit, ...] = ()
    target_m: Vector | None = None
    solution: Result | None = None
    orientation_error_rad: float = 0.0
    orientation_requested: bool = False
    orientation_change_rad: float = 0.0
    speed_reduced: bool = False
    is_cartesian: bool = False
    cartesian_s: float = 0.0
    tool_speed: ToolSpeed | None = None
    via_pose: str = ""
    around: str = ""
    kept: tuple[str, ...] = ()
    clearance_m: float = math.inf
    planning_s: float = 0.0
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    motion: MotionValue[Any] | None = None
    requested: Mapping[str, float] = field(default_factory=dict[str, float])
    clamped: tuple[str, ...] = ()
    limp_arm: object | None = None

    def sample(self, dt_s: float = 0.01) -> SampledTrajectory:
        """Sample the motion as arrays of times (k,), positions and velocities (k, n).

        Args:
            dt_s: Time between two samples; the last sample is at the motion's end.

        Raises:
            BadValueError: ``dt_s`` is not above 0, or makes more than a million samples.
        """
        dt_s = parse_number("The time between two samples", dt_s)
        return sample_trajectory(self.trajectory, dt_s, self.names, self.units)

    def to_csv(
        self, path: Path | str | None = None, dt_s: float = 0.01, *, overwrite: bool = False
    ) -> str:
        """Format the sampled motion as CSV; if a path is given, also write it to a file.

        Raises:
            BadValueError: ``dt_s`` is not valid; or the file exists and ``overwrite`` is false.
            FileWriteError: The file cannot be written.
        """
        return self.sample(dt_s).to_csv(path, overwrite=overwrite)

    def __repr__(self) -> str:
        """Show the goal, the length of the tip's path, and the duration."""
        ends = zip(self.names, self.goal.tolist(), strict=True)
        goal = ", ".join(f"{name}: {at:.4f}" for name, at in ends)
        return (
            f"Plan({self.duration_s:.2f} s, {self.speed}, tip {self.path_m:.3f} m to "
            f"({', '.join(f'{x:z.3f}' for x in self.tip_m)}), goal={{{goal}}})"
        )


_SAMPLES = 200  # evenly in time, to find the joints that determine the duration
# A joint that uses this fraction of a limit at some instant determines the duration.
_FULL = 0.98


def sample_states(trajectory: Trajectory) -> tuple[Matrix, Matrix, Matrix]:
    """Sample positions, velocities and accelerations (k, n) along a trajectory."""
    times_s = np.linspace(0.0, trajectory.duration_s, _SAMPLES)
    states = [trajectory.state(time_s) for time_s in times_s]
    return (
        np.array([state.position for state in states]),
        np.array([state.velocity for state in states]),
        np.array([state.acceleration for state in states]),
    )


def path_length_m(chain: Chain, joints: Matrix) -> float:
    """Compute the length of the tip's path along the chain's joints (k, dof)."""
    tips = chain.forward(joints)[:, :3, 3]
    return float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())


def time_limiting_joints(
    velocity: Matrix, acceleration: Matrix, limits: Sequence[KinematicLimits], names: Sequence[str]
) -> list[str]:
    """Describe the joints whose speed or acceleration (k, n) reaches its limit at some instant."""
    texts: list[str] = []
    for i, (name, limit) in enumerate(zip(names, limits, strict=True)):
        if float(np.abs(velocity[:, i]).max()) >= _FULL * limit.speed_rad_s:
            texts.append(f"{name} at its top speed")
        elif float(np.abs(acceleration[:, i]).max()) >= _FULL * limit.acceleration_rad_s2:
            texts.append(f"{name} at its top acceleration")
    return texts


def near_limits(
    joints: Matrix, lower: Vector, upper: Vector, names: Sequence[str], units: Sequence[str]
) -> tuple[NearLimit, ...]:
    """Return the joints that come near a limit, closest first; see ``near_limit``.

    Joints along the path are (k, n), rad or m; a limit (n,) is infinite if there is none.
    """
    found: list[tuple[float, NearLimit]] = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        span = float(upper[i] - lower[i])
        if not 0.0 < span < math.inf:  # a continuous joint, or a fixed one
            continue
        below = float((joints[:, i] - lower[i]).min())
        above = float((upper[i] - joints[:, i]).min())
        margin, side = min((below, "lower"), (above, "upper"))
        if margin <= near_distance(float(lower[i]), float(upper[i]), unit):
            found.append((margin / span, NearLimit(name, side, margin, unit)))
    return tuple(near for _, near in sorted(found, key=lambda each: each[0]))


# Times at top speed that cover a difference from the start.
_STEP_S = 0.005  # a tick or two, which the guard lets pass as one step
# The sag of a limp arm between planning and moving: an elbow of XL330 that falls freely sags by
# 5.5°, or 0.22 s of its planned top speed.
_SAG_TOLERANCE_S = 0.25


def rebase_trajectory(
    plan: MotionPlan, goals: Vector, limits: Sequence[KinematicLimits], names: Sequence[str]
) -> Trajectory:
    """Return the plan's trajectory, starting from the goals (n,) that the servos hold.

    The goals equal the plan's start within a tick, or are slightly inside the limits if a limp
    joint was outside. A joint motion then starts from the goals; a line is preceded by a motion to
    its start.

    Raises:
        RefusedError: The arm has moved since the plan was made, or the plan belongs to another arm.
    """
    if plan.names != tuple(names):
        raise RefusedError(
            f"The plan moves {', '.join(plan.names)}, but this arm has {', '.join(names)}.",
            "Nothing was sent. Plan the motion with this arm.",
        )
    apart_s = _time_apart_s(plan, goals, limits)
    if apart_s.max() > _SAG_TOLERANCE_S:
        raise RefusedError(
            f"{names[int(apart_s.argmax())]} is not at the start of the plan.",
            "Nothing was sent. Plan again from the present position.",
        )
    if not has_moved(plan, goals, limits):
        return plan.trajectory
    if isinstance(plan.trajectory, JointMove):
        return JointMove(goals, plan.goal, limits)
    return ConcatenatedTrajectory(JointMove(goals, plan.start, limits), plan.trajectory)


def has_moved(plan: MotionPlan, goals: Vector, limits: Sequence[KinematicLimits]) -> bool:
    """Check whether the goals (n,) are more than a tick or two from the start of a plan."""
    return bool(_time_apart_s(plan, goals, limits).max() > _STEP_S)


def _time_apart_s(plan: MotionPlan, goals: Vector, limits: Sequence[KinematicLimits]) -> Vector:
    return np.abs(goals - plan.start) / np.array([limit.speed_rad_s for limit in limits])
