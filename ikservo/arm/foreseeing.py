"""An arm that plans: joints for a wish, and a way there on which it touches nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.given import joint_positions
from ikservo.arm.planning import AS_IT_CAN, RISEN, Plan, Stance, risen, stance_of
from ikservo.arm.running import Running
from ikservo.arm.trust import LARGEST_STEP_RAD
from ikservo.errors import RefusedError
from ikservo.kinematics.se3 import Vector

__all__ = ["Foreseeing"]

_LIES_M = 0.005
# A gripper's goal leads it by more than this at the horn where something is between its jaws.
_PRESSES_RAD = 0.05


class Foreseeing(Running):
    """What ``Arm`` finds out before it moves; nothing here moves."""

    def plan_to(
        self, position_m: ArrayLike, *, speed: str = "normal", stance: Stance = AS_IT_CAN
    ) -> Plan:
        """Find joints that bring the tip to a point and the motion that takes them there.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast; the first motion after torque comes on is slow.
            stance: How the tool shall stand there; if nothing is asked, as well as the arm can
                keep it.

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No three finite numbers.
            RefusedError: On the way the arm would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        asked = stance_of(stance)
        return self.plan_by(
            lambda here, pace: self._planner.to_point(here, position_m, pace, asked), speed
        )

    def plan_by(self, planning: Callable[[Vector, str], Plan], speed: str) -> Plan:
        """Make a plan of the tip from where the arm is, at the speed it may go; look at its way.

        An arm that lies folded touches itself on nearly every way: it rises first.

        Raises:
            RefusedError: On the way the arm would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        self.zeros.check(self.model.name)
        here, pace = self._here(), self._allowed(speed)
        try:
            return self._clear(planning(here, pace), speed)
        except RefusedError:
            found = self._rising(planning, here, pace, speed) if self._folded(here) else None
            if found is None:
                raise
            return found

    def plan_joints(self, positions: Mapping[str, float], *, speed: str = "normal") -> Plan:
        """Plan a motion of some joints, each to its position in rad (m for a prismatic one).

        Raises:
            UnknownNameError: No such joint, or no such speed.
            BadValueError: A position is not finite, or no joint is named.
            RefusedError: A position lies outside the joint's limits, or on the way the arm
                would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are, and the way is long.
        """
        here = self._here()
        plan = self._planner.to_joints(here, joint_positions(positions), self._allowed(speed))
        self.zeros.check_steps(self.model.name, here, plan.goal, self._steps())
        self._servos.check(plan.goal, here)
        return self._clear(plan, speed)

    def plan_rest(self) -> Plan:
        """Plan the slow way to the rest pose; by another pose where that is not free.

        Raises:
            CalibrationError: Nobody knows where the rest pose is.
            RefusedError: No way there is free.
        """
        rest = self._rest()
        try:
            return self.plan_joints(rest, speed="slow")
        except RefusedError:
            found = self._rising(
                lambda here, pace: self._planner.to_joints(here, rest, pace),
                self._here(), "slow", "slow",
            )  # fmt: skip
            if found is None:
                raise
            return found

    def _rest(self) -> dict[str, float]:
        """Return where the joints rest; a gripper that presses on something is left as it is."""
        rest, gripper = dict(self.model.pose("rest")), self.model.gripper
        if gripper is not None:
            column = self._planner.column(gripper.joint)
            joint_map = self._servos.fences[column].joint_map
            ahead = abs(self._here()[column] - self._servos.measure()[column])
            if ahead / joint_map.unit_per_tick * joint_map.horn_rad_per_tick > _PRESSES_RAD:
                del rest[gripper.joint]
        return rest

    def _held_to(self, planning: Callable[[], Plan]) -> Plan:
        """Return a plan from where the arm holds: a limp one may sink before its torque is on."""
        plan = planning()
        if self._enabled:
            return plan
        self.enable()
        return plan if np.array_equal(plan.start, self._servos.goals()) else planning()

    def _steps(self) -> dict[str, float]:
        """Return the longest way at once for each joint whose zero nobody knows, rad or m."""
        turns = {joint.name: joint.travel_per_turn / math.tau for joint in self.model.joints}
        return {name: LARGEST_STEP_RAD * turns[name] for name in self._servos.names}

    def _folded(self, here: Vector) -> bool:
        """Return whether the arm lies on itself, on the table or on a box, or nearly so."""
        if self._space is None:
            return False
        return float(self._space.gaps([self.workings.in_body(here)]).min()) < _LIES_M

    def _rising(
        self, planning: Callable[[Vector, str], Plan], here: Vector, pace: str, asked: str
    ) -> Plan | None:
        """Return a plan by way of a pose where the arm stands free; None where there is no way."""
        for pose in RISEN:
            goals = {n: q for n, q in self.model.pose(pose).items() if n in self.chain.names}
            first = self._planner.to_joints(here, goals, pace)
            with suppress(RefusedError):
                return self._clear(risen(first, planning(first.goal, pace), pose), asked)
        return None

    def _clear(self, plan: Plan, asked: str) -> Plan:
        """Return the plan, if the body's way to its goal is free."""
        if self._space is not None and self.zeros.known:
            self._space.check_way(list(self.workings.in_body(self._planner.way(plan))))
        return replace(plan, slowed=plan.speed != asked)
