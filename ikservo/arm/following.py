"""Following setpoints: from a stream of targets, or from a leader arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import parse_joint_positions
from ikservo.arm.context import ArmContext
from ikservo.arm.online_control import follow_goals, measured_with_held_gripper
from ikservo.arm.reports import MotionProgress
from ikservo.arm.settling import settle_at
from ikservo.control.loop import ControlCycle
from ikservo.deprecation import current_name
from ikservo.errors import BadValueError, BusError, InputError, RefusedError, UnknownNameError
from ikservo.guard import DEAD_MAN_TIMEOUT_S, DeadManSwitch
from ikservo.ik import Solver, Target
from ikservo.kinematics import Chain, finite_array
from ikservo.kinematics.arrays import Matrix, Vector, as_floats
from ikservo.kinematics.se3 import exp_so3
from ikservo.motion import Rate

__all__ = [
    "CartesianOrJointTarget",
    "FollowResult",
    "TargetTracker",
    "follow",
    "leader_positions",
    "shared_joints",
]


CartesianOrJointTarget = Target | Mapping[str, float] | ArrayLike
"""A ``Target``, a point (3,) [m], a pose (4, 4) of the tip, or positions by joint [rad or m]."""

_MAX_POSITION = 1000.0


class TargetTracker:
    """Turns wishes into joints, each found from the last, so that the arm keeps its branch.

    Where a limit is in the way the joints go as near as they can.

    Args:
        chain: Base to tip.
        names: All joints in the order of the vectors (n,).
    """

    def __init__(self, chain: Chain, names: Sequence[str]) -> None:
        self._chain, self._names = chain, list(names)
        self._columns = [self._names.index(name) for name in chain.names]
        self._solvers: dict[tuple[object, ...], Solver] = {}

    def solve_joints(self, wish: CartesianOrJointTarget, last: Vector) -> tuple[Vector, bool]:
        """Return the joints (n,) for a wish, from those for the one before, and whether they reach.

        Raises:
            BadValueError: It is no wish, or a number in it is not finite.
            UnknownNameError: It names a joint or a link that the arm does not have.
        """
        if isinstance(wish, Mapping):
            return self._joints_from_names(parse_joint_positions(wish), last), True
        target, T = self._target_and_pose(wish)
        solver = self._solver_for(target)
        q, reached = solver.track(T, last[self._columns])
        goal = last.copy()
        goal[self._columns] = q
        return goal, reached

    def _joints_from_names(self, positions: Mapping[str, float], last: Vector) -> Vector:
        goal = last.copy()
        for name, position in positions.items():
            if name not in self._names:
                raise UnknownNameError("joint", name, self._names)
            if not abs(position) <= _MAX_POSITION:
                raise BadValueError(f"The goal of {name}", position, "a number of at most 1000")
            goal[self._names.index(name)] = position
        return goal

    def _target_and_pose(self, wish: Target | ArrayLike) -> tuple[Target, Matrix]:
        """Return what is asked and the pose (4, 4) that stands for it."""
        target = wish if isinstance(wish, Target) else _parse_target(wish)
        T = np.eye(4)
        T[:3, 3] = target.position
        T[:3, :3] = (
            exp_so3(target.orientation_error(np.eye(3)))
            if target.rotation is None
            else target.rotation
        )
        return target, T

    def _solver_for(self, target: Target) -> Solver:
        kind = "position" if target.only_position else "direction"
        kind = "pose" if target.rotation is not None else kind
        offset = None if target.offset_m is None else tuple(np.asarray(target.offset_m).tolist())
        axis = tuple(target.axis.tolist()) if kind == "direction" else (0.0, 0.0, 1.0)
        key = (kind, target.frame, offset, axis)
        if key not in self._solvers:
            self._solvers[key] = Solver(
                self._chain, kind, tool_axis=axis, frame=target.frame, offset_m=offset
            )
        return self._solvers[key]


def _parse_target(wish: ArrayLike) -> Target:
    """Return the target that an array means.

    Raises:
        BadValueError: It means none.
    """
    array = as_floats(wish, "The target", "a point (3,), a pose (4, 4), joints or a Target")
    if array.shape != (4, 4):
        return Target(array)
    T = finite_array(array, (4, 4), "The target pose")
    return Target(T[:3, 3], orientation=T[:3, :3])


@dataclass(frozen=True, slots=True, eq=False)
class FollowResult:
    """How a stream of wishes was followed.

    Attributes:
        setpoints: How many there were.
        unreached: How many of them were out of reach; the arm went as near as it could.
        refused: How often the guard would not have a new one; the arm stayed with the one before.
        reason: Why the last of those was refused.
        ended: Why it ended: the stream's end, or its silence.
        measured_rad: Where the joints are in the end, corrected, rad or m by name.
        measured_tip_m: Where that puts the tip (3,), metres.
        duration_s: From the first wish to rest, the correction included.
    """

    setpoints: int
    unreached: int
    refused: int
    reason: str
    ended: str
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    duration_s: float

    if not TYPE_CHECKING:  # a type checker knows today's names only

        def __getattr__(self, name: str) -> object:
            """Return what an old name of a field stands for; it warns."""
            return getattr(self, current_name("FollowResult", {"wishes": "setpoints"}, name))


class _SetpointFollower:
    """Says where the stream wants the joints, beat by beat."""

    def __init__(
        self,
        arm: ArmContext,
        wishes: Iterable[CartesianOrJointTarget | None],
        on_progress: Callable[[MotionProgress], None] | None,
    ) -> None:
        self._arm, self._wishes, self._on_progress = arm, iter(wishes), on_progress
        self._tracker = TargetTracker(arm.chain, arm.servos.names)
        self._dead_man = DeadManSwitch()
        self._goal: Vector | None = None
        self.count = self.unreached = self.refusals = 0
        self.reason = self.ended = ""

    def next_goal(self, beat: ControlCycle) -> Vector | None:
        """Return where to go (n,); None after too long a silence."""
        if self._goal is None:
            self._goal = measured_with_held_gripper(self._arm, beat)
            self._dead_man.refresh(self._arm.now_s())
        if self._on_progress:
            self._on_progress(self._arm.progress(beat))
        return self._solve_setpoint(self._next_setpoint(), self._goal)

    def on_rejected(self, error: RefusedError) -> None:
        """Count a wish that the guard would not have."""
        self.refusals += 1
        self.reason = error.message

    def _next_setpoint(self) -> CartesianOrJointTarget | None:
        """Return the next wish; a stream that has ended is one that is silent from then on."""
        try:
            return next(self._wishes)
        except StopIteration:
            self.ended, self._wishes = "end of the targets", repeat(None)
            return None

    def _solve_setpoint(self, wish: CartesianOrJointTarget | None, last: Vector) -> Vector | None:
        now_s = self._arm.now_s()  # a stream may have kept us waiting
        if self._dead_man.expired(now_s):
            self.ended = self.ended or f"no target for {DEAD_MAN_TIMEOUT_S} s"
            return None
        if wish is not None:
            self._dead_man.refresh(now_s)
            self._goal, reached = self._tracker.solve_joints(wish, last)
            self.count += 1
            self.unreached += not reached
        return self._goal


def follow(
    arm: ArmContext,
    wishes: Iterable[CartesianOrJointTarget | None],
    speed: str,
    on_progress: Callable[[MotionProgress], None] | None,
) -> FollowResult:
    """Follow a stream; see ``Arm.follow``."""
    follower = _SetpointFollower(arm, wishes, on_progress)
    started_s = arm.now_s()
    belongs = follow_goals(arm, follower, speed, loaded=True)
    measured = arm.servos.measure_positions() if belongs is None else settle_at(arm, belongs, speed)
    return FollowResult(
        setpoints=follower.count,
        unreached=follower.unreached,
        refused=follower.refusals,
        reason=follower.reason,
        ended=follower.ended,
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
        duration_s=arm.now_s() - started_s,
    )


def shared_joints(leader: ArmContext, follower: ArmContext) -> list[str]:
    """Return the joints that both arms have by name and kind.

    Raises:
        InputError: There is none, or a joint of the leader slides and the follower's turns.
    """
    units = {fence.joint: fence.joint_map.unit for fence in follower.servos.fences}
    own = {fence.joint: fence.joint_map.unit for fence in leader.servos.fences}
    shared = [name for name in own if name in units]
    if not shared:
        raise InputError(
            f"{leader.model.title} and {follower.model.title} have no joint in common.",
            f"Joints of the leader: {', '.join(own)}; of the follower: {', '.join(units)}.",
        )
    for name in shared:
        if own[name] != units[name]:
            raise InputError(
                f"{name} is prismatic on one of the two arms and revolute on the other.",
                "Such arms cannot be coupled.",
            )
    return shared


def leader_positions(
    leader: ArmContext,
    follower: ArmContext,
    beat_s: float,
    until: Callable[[], bool] | None = None,
) -> Iterator[dict[str, float] | None]:
    """Yield the leader's measured joints by name at each beat, or None where it did not answer.

    Args:
        leader: Who leads; its torque is left as it is.
        follower: Who follows.
        beat_s: Between two looks at the leader.
        until: Ends it by returning True.
    """
    shared = shared_joints(leader, follower)
    columns = [leader.planner.joint_index(name) for name in shared]
    for _ in Rate(leader.servos.clock, beat_s):
        if until and until():
            return
        try:
            measured = leader.servos.measure_positions()
        except BusError:
            yield None  # the follower waits a little, then holds
        else:
            yield {name: float(measured[c]) for name, c in zip(shared, columns, strict=True)}
