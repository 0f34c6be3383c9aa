"""A motion plan and its preview: path, duration, limits that come close, start conditions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.arm.arguments import parse_number
from ikservo.arm.sampled_trajectory import SampledTrajectory, sample_trajectory
from ikservo.deprecation import current_name
from ikservo.errors import RefusedError
from ikservo.guard import CommandLimits
from ikservo.ik import Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.model import near_distance
from ikservo.motion import ConcatenatedTrajectory, JointMove, KinematicLimits, Trajectory

__all__ = [
    "RETRACT_POSES",
    "Inside",
    "MotionPlan",
    "NearLimit",
    "brought_inside",
    "has_moved",
    "near_limits",
    "path_length_m",
    "posed_inside",
    "rebase_trajectory",
    "sample_states",
    "time_limiting_joints",
    "via_pose_plan",
]


@dataclass(frozen=True, slots=True)
class NearLimit:
    """A joint that comes close to one of its limits on the way.

    Attributes:
        joint: Its name.
        side: ``lower`` or ``upper``.
        room: How far inside the limit it stays, rad or m.
        unit: ``rad`` or ``m``.
    """

    joint: str
    side: str
    room: float
    unit: str


_RENAMED = {
    "by": "via_pose",
    "left_rad": "orientation_error_rad",
    "near": "near_limits",
    "setters": "time_limiting_joints",
    "slowed": "speed_reduced",
    "straight": "is_cartesian",
}


@dataclass(frozen=True, slots=True, eq=False)
class MotionPlan:
    """A motion that could start now.

    Attributes:
        start: Where all joints would begin (n,), rad or m.
        goal: Where all joints would end (n,).
        course: What they would do in between; what was checked is what is streamed.
        tip_m: Where the goal puts the tip (3,), metres.
        path_m: The way of the tip.
        duration_s: How long it takes.
        speed: slow, normal or fast.
        time_limiting_joints: The joints that set the time, at their top speed or acceleration,
            in words.
        near_limits: The joints that come close to a limit on the way, the closest first.
        target_m: The point it goes to (3,); None for a motion of joints.
        solution: What the solver answered; None for a motion of joints.
        orientation_error_rad: How far the tool will be from how it should stand, at worst.
        orientation_requested: Whether an orientation of the tool was requested.
        speed_reduced: Whether it goes slower than asked, for it is the first after torque comes on.
        is_cartesian: Whether the tip goes along straight lines.
        via_pose: The pose by way of which it goes; empty where it goes straight.
        names: The joints, in the order of ``start`` and ``goal``.
        units: ``rad`` or ``m`` for each joint.
        again: Makes the same plan from where the arm is when it is called, None for another arm
            than it was made for; set where the arm was limp, for such an arm may sink until its
            torque comes on.
    """

    start: Vector
    goal: Vector
    course: Trajectory
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
    speed_reduced: bool = False
    is_cartesian: bool = False
    via_pose: str = ""
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    again: Callable[[object], MotionPlan | None] | None = None

    if not TYPE_CHECKING:  # a type checker knows today's names only

        def __getattr__(self, name: str) -> object:
            """Return what an old name of a field stands for; it warns."""
            return getattr(self, current_name("MotionPlan", _RENAMED, name))

    def sample(self, dt_s: float = 0.01) -> SampledTrajectory:
        """Return the motion as arrays: times (k,), positions and velocities (k, n).

        Args:
            dt_s: Between two samples; the last is at the motion's end.

        Raises:
            BadValueError: ``dt_s`` is not above 0, or makes more than a million samples.
        """
        dt_s = parse_number("The time between two samples", dt_s)
        return sample_trajectory(self.course, dt_s, self.names, self.units)

    def to_csv(
        self, path: Path | str | None = None, dt_s: float = 0.01, *, overwrite: bool = False
    ) -> str:
        """Return the sampled motion as CSV, and write it to a file where a path is given.

        Raises:
            BadValueError: See ``sample``; or the file exists and ``overwrite`` is false.
            FileWriteError: It cannot be written.
        """
        return self.sample(dt_s).to_csv(path, overwrite=overwrite)

    def __repr__(self) -> str:
        """Return where it goes, how far and how long."""
        ends = zip(self.names, self.goal.tolist(), strict=True)
        goal = ", ".join(f"{name}: {at:.4f}" for name, at in ends)
        return (
            f"Plan({self.duration_s:.2f} s, {self.speed}, tip {self.path_m:.3f} m to "
            f"({', '.join(f'{x:z.3f}' for x in self.tip_m)}), goal={{{goal}}})"
        )


_SAMPLES = 200
# A joint that uses this share of its pace at some instant is one that sets the time.
_FULL = 0.98


def sample_states(course: Trajectory) -> tuple[Matrix, Matrix, Matrix]:
    """Return positions, velocities and accelerations (k, n) along a course."""
    states = [course.state(time_s) for time_s in np.linspace(0.0, course.duration_s, _SAMPLES)]
    return (
        np.array([state.position for state in states]),
        np.array([state.velocity for state in states]),
        np.array([state.acceleration for state in states]),
    )


def path_length_m(chain: Chain, joints: Matrix) -> float:
    """Return the way of the tip along the chain's joints (k, dof)."""
    tips = chain.forward(joints)[:, :3, 3]
    return float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())


def time_limiting_joints(
    velocity: Matrix, acceleration: Matrix, paces: Sequence[KinematicLimits], names: Sequence[str]
) -> list[str]:
    """Return which joints go as fast as they may at some instant, in words.

    Args:
        velocity: Along the way (k, n).
        acceleration: Along the way (k, n).
        paces: The pace of each joint.
        names: Their names.
    """
    words: list[str] = []
    for i, (name, pace) in enumerate(zip(names, paces, strict=True)):
        if float(np.abs(velocity[:, i]).max()) >= _FULL * pace.speed_rad_s:
            words.append(f"{name} at its top speed")
        elif float(np.abs(acceleration[:, i]).max()) >= _FULL * pace.acceleration_rad_s2:
            words.append(f"{name} at its top acceleration")
    return words


def near_limits(
    joints: Matrix, lower: Vector, upper: Vector, names: Sequence[str], units: Sequence[str]
) -> tuple[NearLimit, ...]:
    """Return the joints that come near a limit, closest first; see ``near_limit``.

    Args:
        joints: Along the way (k, n), rad or m.
        lower: The lower limits (n,); infinite where there is none.
        upper: The upper limits (n,).
        names: Their names.
        units: ``rad`` or ``m`` for each.
    """
    found: list[tuple[float, NearLimit]] = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        span = float(upper[i] - lower[i])
        if not 0.0 < span < math.inf:  # a joint that turns freely, or cannot turn
            continue
        below, above = (
            float((joints[:, i] - lower[i]).min()),
            float((upper[i] - joints[:, i]).min()),
        )
        room, side = min((below, "lower"), (above, "upper"))
        if room <= near_distance(float(lower[i]), float(upper[i]), unit):
            found.append((room / span, NearLimit(name, side, room, unit)))
    return tuple(near for _, near in sorted(found, key=lambda each: each[0]))


# What a joint goes through in this time at its full pace: a tick or two, which the guard passes
# as one step; and what an arm may have sagged by between planning and moving.
_STEP_S, _SAG_TOLERANCE_S = 0.005, 0.2


def rebase_trajectory(
    plan: MotionPlan, goals: Vector, paces: Sequence[KinematicLimits], names: Sequence[str]
) -> Trajectory:
    """Return the plan's course, begun at the goals (n,) that the servos hold.

    They are where it was planned from but for a tick, or a little inside where a limp joint stood
    outside its limits. A motion of joints then begins there; a line is led in to.

    Raises:
        RefusedError: The arm has been moved since it was planned, or it is a plan of another.
    """
    if plan.names != tuple(names):
        raise RefusedError(
            f"The plan moves {', '.join(plan.names)}, this arm has {', '.join(names)}.",
            "Nothing was sent. Plan it with this arm.",
        )
    apart_s = _time_apart_s(plan, goals, paces)
    if apart_s.max() > _SAG_TOLERANCE_S:
        raise RefusedError(
            f"{names[int(apart_s.argmax())]} is not at the start of the plan.",
            "Nothing was sent. Plan again from the present position.",
        )
    if not has_moved(plan, goals, paces):
        return plan.course
    if isinstance(plan.course, JointMove):
        return JointMove(goals, plan.goal, paces)
    return ConcatenatedTrajectory(JointMove(goals, plan.start, paces), plan.course)


def has_moved(plan: MotionPlan, goals: Vector, paces: Sequence[KinematicLimits]) -> bool:
    """Return whether the goals (n,) are further than a tick or two from where a plan begins."""
    return bool(_time_apart_s(plan, goals, paces).max() > _STEP_S)


def _time_apart_s(plan: MotionPlan, goals: Vector, paces: Sequence[KinematicLimits]) -> Vector:
    return np.abs(goals - plan.start) / np.array([pace.speed_rad_s for pace in paces])


RETRACT_POSES = ("home", "rest")
"""The poses that are tried, in this order; every arm file has them."""


def via_pose_plan(first: MotionPlan, then: MotionPlan, pose: str) -> MotionPlan:
    """Return a plan that goes to a pose first, rests there, and goes on from it.

    Args:
        first: To the pose.
        then: From the pose.
        pose: Its name.
    """
    return replace(
        then,
        start=first.start,
        course=ConcatenatedTrajectory(first.course, then.course),
        path_m=first.path_m + then.path_m,
        duration_s=first.duration_s + then.duration_s,
        time_limiting_joints=tuple(
            dict.fromkeys(first.time_limiting_joints + then.time_limiting_joints)
        ),
        via_pose=pose,
    )


# A joint that hung on its end stop when a pose was taught stood this far beyond its limit at most.
_END_STOP_RAD = math.radians(6.0)


@dataclass(frozen=True, slots=True)
class Inside:
    """A pose as an arm can go to it.

    Attributes:
        positions: By joint, rad or m.
        changed: Which joints stop at a limit short of the pose, in words.
    """

    positions: dict[str, float]
    changed: tuple[str, ...]


def brought_inside(
    pose: Mapping[str, float],
    fences: Sequence[CommandLimits],
    here: Vector,
    most_rad: float = _END_STOP_RAD,
) -> Inside:
    """Return a pose with joints beyond their limits brought to them.

    Args:
        pose: Positions by joint, rad or m; joints that are not named stay where they are.
        fences: The limits, in the order of ``here``.
        here: Where the joints are (n,). One that stands beyond its limit need not come inside.
        most_rad: A joint further beyond, at the horn, is left there for the guard to refuse.
    """
    positions, changed = dict(pose), list[str]()
    for fence, at in zip(fences, here.tolist(), strict=True):
        if fence.joint not in pose or fence.limits.contains(pose[fence.joint]):
            continue
        wanted, (low, high) = pose[fence.joint], fence.position_range
        inside = min(max(wanted, min(low, at)), max(high, at))
        joint_map = fence.joint_map
        beyond_rad = max(low - wanted, wanted - high) / joint_map.unit_per_horn_rad
        if inside != wanted and beyond_rad <= most_rad:
            positions[fence.joint] = inside
            if joint_map.format(inside) != joint_map.format(wanted):  # less is rounding, not news
                changed.append(_describe_clamped(fence, wanted, inside))
    return Inside(positions, tuple(changed))


def posed_inside(
    name: str, pose: Mapping[str, float], fences: Sequence[CommandLimits], here: Vector
) -> Inside:
    """Return a named pose as an arm goes to it; see ``brought_inside``.

    The rest pose is brought inside the limits whatever they are: an arm must always be able to
    come down. Another pose is where its joints lie on their end stops, just beyond a limit.
    """
    most_rad = math.inf if name == "rest" else _END_STOP_RAD
    return brought_inside(pose, fences, here, most_rad)


def _describe_clamped(fence: CommandLimits, wanted: float, inside: float) -> str:
    limits, say = fence.limits, fence.joint_map.format
    limit = limits.upper if wanted > inside else limits.lower
    return (
        f"{fence.joint} goes to {say(inside)}, not to {say(wanted)}: "
        f"its limit is {say(limit.value)} ({limit.source})"
    )
