"""The machine a person owns: it goes to a point, says where it is, holds and lets go."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from types import TracebackType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arriving.aim import Aim
from ikservo.arm.arriving.arrival import Arrival, arrive
from ikservo.arm.given import joint_positions
from ikservo.arm.planning import AS_IT_CAN, RISEN, Plan, Stance, begun, risen
from ikservo.arm.reports import JointReport, MoveReport, Progress
from ikservo.arm.running import Running
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.stream import OnBeat
from ikservo.arm.trust import LARGEST_STEP_RAD, Zeros
from ikservo.errors import BadValueError, RefusedError, UnknownNameError
from ikservo.guard import Space
from ikservo.hardware.line.port import Port
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["Arm", "OnExit"]

OnExit = Literal["hold", "relax"]

# Servos of this class stand within one or two ticks of 0.09° of where they are told.
ARRIVAL_M = 0.002
ARRIVAL_RAD = math.radians(0.5)
_LIES_M = 0.005


class Arm(Running):
    """An arm on an open port; see ``open_arm``.

    Torque is switched on by the first motion, and stays on when the arm is closed unless
    ``on_exit`` says ``relax``: an arm never drops because a program ended.

    Attributes:
        model: What the arm is.
        chain: Base to tool, inside this arm's limits in whole ticks.
        zeros: Where the zeros of its joints come from.
    """

    def __init__(
        self,
        model: Model,
        chain: Chain,
        servos: Servos,
        port: Port,
        on_exit: OnExit = "hold",
        space: Space | None = None,
        zeros: Zeros = Zeros.SIMULATED,
    ) -> None:
        if on_exit not in ("hold", "relax"):
            raise UnknownNameError("way to exit", on_exit, ("hold", "relax"))
        super().__init__(model, chain, servos, port, space, zeros)
        self._on_exit: OnExit = on_exit

    def __enter__(self) -> Arm:
        """Return the arm; leaving the block closes it."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(self._on_exit if error is None else "hold")

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
        return self.plan_by(
            lambda here, pace: self._planner.to_point(here, position_m, pace, stance), speed
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

    def go(self, plan: Plan, on_progress: Callable[[Progress], None] | None = None) -> Arrival:
        """Carry out a plan; return where that ended, measured, and how long it took.

        Raises:
            StoppedError: The person interrupted; the servos hold.
            RefusedError: The guard stopped it; the servos hold.
        """
        self._check_speed(plan)
        with self._moving():
            return self._follow(plan, on_progress)

    def move_to(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: Stance = AS_IT_CAN,
        on_progress: Callable[[Progress], None] | None = None,
    ) -> MoveReport:
        """Move the tip to a point and block until the arm is at rest.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.
            stance: How the tool shall stand there, see ``plan_to``.
            on_progress: Called at every beat.

        Raises:
            UnreachableError: No joints inside the limits reach it; nothing has moved.
            OrientationError: The tool cannot stand there as asked; nothing has moved.
            RefusedError: The guard will not pass a goal on.
            StoppedError: The person interrupted; the arm holds.
        """
        return self.carry_out(self.plan_to(position_m, speed=speed, stance=stance), on_progress)

    def carry_out(
        self, plan: Plan, on_progress: Callable[[Progress], None] | None = None
    ) -> MoveReport:
        """Carry out a plan of ``plan_to`` and report how it ended, measured."""
        if plan.target_m is None or plan.solution is None:
            raise BadValueError("The plan", "a motion of joints", "a plan of plan_to")
        arrival = self.go(plan, on_progress)
        tip_m = self._planner.tip(arrival.measured)
        error_m = float(np.linalg.norm(plan.target_m - tip_m))
        limits = tuple(str(limit) for limit in plan.solution.binding)
        return MoveReport(
            target_m=plan.target_m,
            commanded_tip_m=plan.tip_m,
            measured_tip_m=tip_m,
            error_m=error_m,
            duration_s=arrival.duration_s,
            reached=error_m <= ARRIVAL_M,
            binding=limits + arrival.short,
            orientation_error_rad=plan.left_rad + self._planner.turned(plan.goal, arrival.measured),
            motion_s=arrival.motion_s,
            settling_s=arrival.settling_s,
        )

    def move_joints(
        self,
        positions: Mapping[str, float],
        *,
        speed: str = "normal",
        on_progress: Callable[[Progress], None] | None = None,
    ) -> JointReport:
        """Move some joints, rad (m for prismatic ones), and block until the arm is at rest.

        Raises:
            UnknownNameError: No such joint.
            RefusedError: A position lies outside the joint's limits; nothing has moved.
            StoppedError: The person interrupted; the arm holds.
        """
        plan = self.plan_joints(positions, speed=speed)
        arrival = self.go(plan, on_progress)
        measured = arrival.measured
        there = {name: float(measured[self._planner.column(name)]) for name in positions}
        error_rad = max(abs(there[name] - position) for name, position in positions.items())
        return JointReport(
            goal_rad=dict(positions),
            measured_rad=there,
            measured_tip_m=self._planner.tip(measured),
            error_rad=error_rad,
            duration_s=arrival.duration_s,
            reached=error_rad <= ARRIVAL_RAD,
            binding=arrival.short,
        )

    def relax(self, on_progress: Callable[[Progress], None] | None = None) -> JointReport:
        """Lower the arm to its rest pose, slowly, then switch every servo's torque off.

        Raises:
            CalibrationError: Nobody knows where the rest pose is; see ``release``.
        """
        self.zeros.check(self.model.name)
        self._enabled = False  # torque is looked at anew, by limits that let it come down
        with self._servos.bearing_heat():
            report = self.move_joints(
                self.model.pose("rest"), speed="slow", on_progress=on_progress
            )
        self.release()
        return report

    def close(self, on_exit: OnExit | None = None) -> None:
        """Give the port back, leaving the arm held or relaxed."""
        if not self._port.is_open:
            return
        try:
            if (on_exit or self._on_exit) == "relax":
                self.relax()
        finally:
            if self._listener is not None:
                self._listener.close()
            with self._turn:  # not while another terminal relaxes the arm
                self._port.close()

    def _steps(self) -> dict[str, float]:
        """Return the longest way at once for each joint whose zero nobody knows, rad or m."""
        turns = {joint.name: joint.travel_per_turn / math.tau for joint in self.model.joints}
        return {name: LARGEST_STEP_RAD * turns[name] for name in self._servos.names}

    def _folded(self, here: Vector) -> bool:
        """Return whether the arm lies on itself, on the table or on a box, or nearly so."""
        if self._space is None:
            return False
        return float(self._space.gaps([self.workings.in_chain(here)]).min()) < _LIES_M

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
            self._space.check_way(self._planner.way(plan))
        return replace(plan, slowed=plan.speed != asked)

    def _follow(self, plan: Plan, on_progress: Callable[[Progress], None] | None) -> Arrival:
        servos, paces = self._servos, self._planner.paces(plan.speed)
        horn_rad_s = self.model.speed(plan.speed).rad_s
        aim = Aim(self.chain, servos.fences, plan, servos.measure())
        course = begun(plan, servos.goals(), paces, servos.names)
        started_s = servos.clock.now_s()
        self._stream.run(course, self._watcher(on_progress), speed_rad_s=horn_rad_s)
        motion_s = servos.clock.now_s() - started_s
        return arrive(self._stream, servos, aim, paces, horn_rad_s, motion_s)

    def _watcher(self, on_progress: Callable[[Progress], None] | None) -> OnBeat | None:
        if on_progress is None:
            return None

        def tell(beat: Beat) -> None:
            on_progress(Progress(beat.time_s, beat.duration_s, self._planner.tip(beat.measured)))

        return tell
