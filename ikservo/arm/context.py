"""The shared context of an arm's motion functions, and the progress they report."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ikservo.arm.planner import Planner
from ikservo.arm.reports import MotionProgress
from ikservo.arm.zeros import ZeroSource
from ikservo.control.loop import ControlCycle, OnCycle
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker, sample_line, sample_path
from ikservo.ik import Solver
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model import Model
from ikservo.motion import JointMove, RuckigMotion, Trajectory

__all__ = ["ArmContext", "TrajectoryFactory", "make_progress"]


def make_progress(beat: ControlCycle, tip_m: Vector, names: tuple[str, ...]) -> MotionProgress:
    """Return the state of a motion in one control cycle.

    Args:
        beat: What was told and heard.
        tip_m: The measured tip (3,), metres.
        names: The joints, in the order of the cycle's vectors.
    """
    return MotionProgress(
        beat.time_s, beat.duration_s, tip_m, beat.measured.copy(), beat.goals.copy(), names
    )


_CONTACT_M, _SINK_MARGIN_M = 0.005, 0.010

TrajectoryFactory = Callable[[Vector], Trajectory]
"""Makes a course that begins at the goals (n,) the servos hold."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmContext:
    """The inside of an arm, for the rooms that make it do something.

    Attributes:
        model: What the arm is.
        chain: Base to tip inside this arm's limits.
        servos: Its servos.
        planner: Joints, tip and paces.
        space: What the body must keep clear of; None where nobody looks.
        zeros: Where its zeros come from.
        drive: Switches torque on where it is off, streams a course, and hears Ctrl-C meanwhile;
            takes what begins it, who looks at each beat, and slow, normal or fast. Returns the
            joints (n,) at the last beat.
        allowed_speed: The speed a motion may have that was asked for at one: the first is slow.
    """

    model: Model
    chain: Chain
    servos: ServoGroup
    planner: Planner
    space: CollisionChecker | None
    zeros: ZeroSource
    drive: Callable[[TrajectoryFactory, OnCycle | None, str], Vector]
    allowed_speed: Callable[[str], str]

    def now_s(self) -> float:
        """Return the time on the line's clock."""
        return self.servos.clock.now_s()

    def progress(self, beat: ControlCycle) -> MotionProgress:
        """Return what a control cycle tells whoever watches the motion."""
        return make_progress(beat, self.planner.tip(beat.measured), self.servos.names)

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest positions (n,) that are whole ticks inside limits."""
        low, high = zip(*(fence.position_range for fence in self.servos.fences), strict=True)
        return np.array(low), np.array(high)

    def return_within_limits(self) -> None:
        """Lead joints that stand a little outside their limits back inside, slowly.

        A limp arm sinks there. A motion that is aimed anew at each beat must begin inside: the
        guard lets a joint come back, and not out again by a single tick.
        """
        lower, upper = self.limits()
        measured = self.servos.measure_positions()
        if ((measured >= lower) & (measured <= upper)).all():
            return
        paces = self.planner.motion_limits("slow")
        self.drive(lambda here: JointMove(here, np.clip(here, lower, upper), paces), None, "slow")

    def warm_up(self) -> None:
        """Load what solving and checking need: no goal may wait for it."""
        q = self.chain.clip(np.zeros(self.chain.dof))
        Solver(self.chain, "position").track(self.chain.forward(q), q)
        if self.space is not None:
            here = np.zeros(self.space.dof)
            with suppress(RefusedError):
                self.space.check_path([here, here])

    def chain_joints(self, joints: Matrix) -> Matrix:
        """Return the columns of the chain (…, dof) out of vectors of all joints (…, n)."""
        columns = [self.planner.joint_index(name) for name in self.chain.names]
        return joints[..., columns]

    def body_joints(self, joints: Matrix) -> Matrix:
        """Return the columns that the body is looked at with: the chain's, then the gripper's."""
        chained = self.chain_joints(joints)
        if self.model.gripper is None or self.space is None or self.space.dof == self.chain.dof:
            return chained
        jaws = self.planner.joint_index(self.model.gripper.joint)
        return np.concatenate([chained, joints[..., jaws : jaws + 1]], axis=-1)

    def check_streamed_path(self, course: Trajectory, speed: str) -> None:
        """Check the way of a course as it will be streamed, wherever it was planned.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is not None and self.zeros.are_known:
            way = self.body_joints(self.planner.sample_trajectory(course, speed))
            self.space.check_path(list(way), self.planner.dynamic_load_factor(speed))

    def check_trajectory(self, move: RuckigMotion) -> None:
        """Check the way of a motion as it will be gone, braking and turning round included.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is not None and self.zeros.are_known:
            way = sample_path(move.at, move.duration_s, move.top_speed)
            self.space.check_path(list(self.body_joints(way)))

    def check_straight_path(self, here: Vector, goal: Vector) -> None:
        """Check the straight way of the joints (n,) to a goal for contact of the body.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is None or not self.zeros.are_known:
            return
        self.space.check_path(list(self.body_joints(self.interpolate_joints(here, goal))))

    def interpolate_joints(self, here: Vector, goal: Vector) -> Matrix:
        """Return the straight way (k, n) between joints, near enough to look for contact."""
        turns = [self.model.joint(name).travel_per_turn / math.tau for name in self.servos.names]
        return sample_line(here, goal, np.array(turns))

    def check_recorded_path(self, way: Matrix) -> None:
        """Check a recorded way (k, n) of the joints for contact of the body.

        A limp arm lies on itself or on the table and sinks on; so what it lay on at one of the
        ends it may lie on again, a little deeper, for it was led there by hand.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is None or not self.zeros.are_known:
            return
        looks = list(self.body_joints(way))
        gap_m = self.space.distances(looks)
        ends_m = np.minimum(gap_m[0], gap_m[-1])
        least_m = np.where(ends_m < _CONTACT_M, np.minimum(ends_m, 0.0) - _SINK_MARGIN_M, 0.0)
        if (gap_m < least_m).any():
            self.space.check_path(looks)
