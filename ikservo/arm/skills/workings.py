"""What an arm's abilities work with: its description, its servos, and the one way to move them."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ikservo.arm.planning import Planner
from ikservo.arm.progress import progress_of
from ikservo.arm.reports import Progress
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.stream import OnBeat
from ikservo.arm.trust import Zeros
from ikservo.errors import RefusedError
from ikservo.guard import Space, sample_line, sample_path
from ikservo.ik import Solver
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model import Model
from ikservo.motion import Course, JointMove, RuckigMotion

__all__ = ["Begin", "Workings"]

_LIES_M, _SINKS_M = 0.005, 0.010

Begin = Callable[[Vector], Course]
"""Makes a course that begins at the goals (n,) the servos hold."""


@dataclass(frozen=True, slots=True, eq=False)
class Workings:
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
        allowed: The speed a motion may have that was asked for at one: the first is slow.
    """

    model: Model
    chain: Chain
    servos: Servos
    planner: Planner
    space: Space | None
    zeros: Zeros
    drive: Callable[[Begin, OnBeat | None, str], Vector]
    allowed: Callable[[str], str]

    def now_s(self) -> float:
        """Return the time on the line's clock."""
        return self.servos.clock.now_s()

    def progress(self, beat: Beat) -> Progress:
        """Return what a control cycle tells whoever watches the motion."""
        return progress_of(beat, self.planner.tip(beat.measured), self.servos.names)

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest positions (n,) that are whole ticks inside limits."""
        low, high = zip(*(fence.positions for fence in self.servos.fences), strict=True)
        return np.array(low), np.array(high)

    def walk_back(self) -> None:
        """Lead joints that stand a little outside their limits back inside, slowly.

        A limp arm sinks there. A motion that is aimed anew at each beat must begin inside: the
        guard lets a joint come back, and not out again by a single tick.
        """
        lower, upper = self.limits()
        measured = self.servos.measure()
        if ((measured >= lower) & (measured <= upper)).all():
            return
        paces = self.planner.paces("slow")
        self.drive(lambda here: JointMove(here, np.clip(here, lower, upper), paces), None, "slow")

    def rehearse(self) -> None:
        """Load what is compiled: the first look takes seconds, and no goal may wait for it."""
        q = self.chain.clip(np.zeros(self.chain.dof))
        Solver(self.chain, "position").track(self.chain.forward(q), q)
        if self.space is not None:
            here = np.zeros(self.space.dof)
            with suppress(RefusedError):
                self.space.check_way([here, here])

    def in_chain(self, joints: Matrix) -> Matrix:
        """Return the columns of the chain (…, dof) out of vectors of all joints (…, n)."""
        columns = [self.planner.column(name) for name in self.chain.names]
        return joints[..., columns]

    def in_body(self, joints: Matrix) -> Matrix:
        """Return the columns that the body is looked at with: the chain's, then the gripper's."""
        chained = self.in_chain(joints)
        if self.model.gripper is None or self.space is None or self.space.dof == self.chain.dof:
            return chained
        jaws = self.planner.column(self.model.gripper.joint)
        return np.concatenate([chained, joints[..., jaws : jaws + 1]], axis=-1)

    def check_course(self, course: Course, speed: str) -> None:
        """Check the way of a course as it will be streamed, wherever it was planned.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is not None and self.zeros.known:
            way = self.in_body(self.planner.way_of(course, speed))
            self.space.check_way(list(way), self.planner.load(speed))

    def check_move(self, move: RuckigMotion) -> None:
        """Check the way of a motion as it will be gone, braking and turning round included.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is not None and self.zeros.known:
            way = sample_path(move.at, move.duration_s, move.top_speed)
            self.space.check_way(list(self.in_body(way)))

    def check_way(self, here: Vector, goal: Vector) -> None:
        """Check the straight way of the joints (n,) to a goal for contact of the body.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is None or not self.zeros.known:
            return
        self.space.check_way(list(self.in_body(self.straight(here, goal))))

    def straight(self, here: Vector, goal: Vector) -> Matrix:
        """Return the straight way (k, n) between joints, near enough to look for contact."""
        turns = [self.model.joint(name).travel_per_turn / math.tau for name in self.servos.names]
        return sample_line(here, goal, np.array(turns))

    def check_recorded(self, way: Matrix) -> None:
        """Check a recorded way (k, n) of the joints for contact of the body.

        A limp arm lies on itself or on the table and sinks on; so what it lay on at one of the
        ends it may lie on again, a little deeper, for it was led there by hand.

        Raises:
            RefusedError: Something would be touched.
        """
        if self.space is None or not self.zeros.known:
            return
        looks = list(self.in_body(way))
        gap_m = self.space.gaps(looks)
        ends_m = np.minimum(gap_m[0], gap_m[-1])
        least_m = np.where(ends_m < _LIES_M, np.minimum(ends_m, 0.0) - _SINKS_M, 0.0)
        if (gap_m < least_m).any():
            self.space.check_way(looks)
