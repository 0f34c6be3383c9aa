"""The machine a person owns: it goes to a point, says where it is, holds and lets go."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arrival import correct, settle
from ikservo.arm.journey import Watcher, travel
from ikservo.arm.planning import Plan, Planner
from ikservo.arm.reports import JointReport, MoveReport, Progress, Whereabouts
from ikservo.arm.servos import Servos
from ikservo.arm.trust import LARGEST_STEP_RAD, Zeros
from ikservo.errors import BadValueError, StoppedError, UnknownNameError
from ikservo.guard import Space
from ikservo.hardware.port import Port
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model
from ikservo.motion import JointMove

__all__ = ["Arm", "OnExit"]

OnExit = Literal["hold", "relax"]

# Servos of this class stand within one or two ticks of 0.09° of where they are told.
ARRIVAL_M = 0.002
ARRIVAL_RAD = math.radians(0.5)


class Arm:
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
        self.model, self.chain, self.zeros = model, chain, zeros
        self._servos, self._port = servos, port
        self._on_exit: OnExit = on_exit
        self._space = space
        self._planner = Planner(model, chain, servos.names)
        self._enabled = False

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

    @property
    def port_name(self) -> str:
        """Return the name of the port the arm is on."""
        return self._port.name

    def where(self) -> Whereabouts:
        """Return the measured tip, joints and health."""
        states = self._servos.states()
        joints = np.array([state.position_rad for state in states])
        return Whereabouts(self._planner.tip(joints), states)

    def enable(self) -> None:
        """Let every servo hold where it is; goals are set before torque, so nothing twitches."""
        self._servos.enable(self.model.speed("fast").rad_s)
        self._enabled = True

    def plan_to(self, position_m: ArrayLike, *, speed: str = "normal") -> Plan:
        """Find joints that bring the tip to a point and the motion that takes them there.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            BadValueError: No three finite numbers.
            RefusedError: On the way the arm would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        self.zeros.check(self.model.name)
        here = self._here()
        return self._clear(here, self._planner.to_point(here, position_m, speed))

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
        plan = self._planner.to_joints(here, positions, speed)
        self.zeros.check_steps(self.model.name, here, plan.goal, self._steps())
        self._servos.check(plan.goal, here)
        return self._clear(here, plan)

    def go(
        self, plan: Plan, on_progress: Callable[[Progress], None] | None = None
    ) -> tuple[Vector, float]:
        """Carry out a plan; return the measured joints (n,) and how long it took [s].

        Raises:
            StoppedError: The person interrupted; the servos hold.
            RefusedError: The guard stopped it; the servos hold.
        """
        if not self._enabled:
            self.enable()
        started_s = self._servos.clock.now_s()
        try:
            measured = self._follow(plan, on_progress)
        except KeyboardInterrupt:
            raise StoppedError(
                "Stopped; the arm holds.", "Release it with: ikservo relax"
            ) from None
        return measured, self._servos.clock.now_s() - started_s

    def move_to(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        on_progress: Callable[[Progress], None] | None = None,
    ) -> MoveReport:
        """Move the tip to a point and block until the arm is at rest.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.
            on_progress: Called at every beat.

        Raises:
            UnreachableError: No joints inside the limits reach it; nothing has moved.
            RefusedError: The guard will not pass a goal on.
            StoppedError: The person interrupted; the arm holds.
        """
        return self.carry_out(self.plan_to(position_m, speed=speed), on_progress)

    def carry_out(
        self, plan: Plan, on_progress: Callable[[Progress], None] | None = None
    ) -> MoveReport:
        """Carry out a plan of ``plan_to`` and report how it ended, measured."""
        if plan.target_m is None or plan.solution is None:
            raise BadValueError("The plan", "a motion of joints", "a plan of plan_to")
        measured, duration_s = self.go(plan, on_progress)
        tip_m = self._planner.tip(measured)
        error_m = float(np.linalg.norm(plan.target_m - tip_m))
        return MoveReport(
            target_m=plan.target_m,
            commanded_tip_m=plan.tip_m,
            measured_tip_m=tip_m,
            error_m=error_m,
            duration_s=duration_s,
            reached=error_m <= ARRIVAL_M,
            binding=tuple(str(limit) for limit in plan.solution.binding),
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
        measured, duration_s = self.go(plan, on_progress)
        there = {name: float(measured[self._planner.column(name)]) for name in positions}
        error_rad = max(abs(there[name] - position) for name, position in positions.items())
        return JointReport(
            goal_rad=dict(positions),
            measured_rad=there,
            measured_tip_m=self._planner.tip(measured),
            error_rad=error_rad,
            duration_s=duration_s,
            reached=error_rad <= ARRIVAL_RAD,
        )

    def hold(self) -> None:
        """Let every servo hold where it is now."""
        self.enable()

    def relax(self, on_progress: Callable[[Progress], None] | None = None) -> JointReport:
        """Lower the arm to its rest pose, slowly, then switch every servo's torque off.

        Raises:
            CalibrationError: Nobody knows where the rest pose is; see ``release``.
        """
        self.zeros.check(self.model.name)
        report = self.move_joints(self.model.pose("rest"), speed="slow", on_progress=on_progress)
        self.release()
        return report

    def release(self) -> None:
        """Switch every servo's torque off where the arm is; what nobody holds falls."""
        self._servos.release()
        self._enabled = False

    def close(self, on_exit: OnExit | None = None) -> None:
        """Give the port back, leaving the arm held or relaxed."""
        if not self._port.is_open:
            return
        try:
            if (on_exit or self._on_exit) == "relax":
                self.relax()
        finally:
            self._port.close()

    def _here(self) -> Vector:
        """Return where a motion starts: the goals of a holding arm, else the measured joints."""
        return self._servos.goals() if self._enabled else self._servos.measure()

    def _steps(self) -> dict[str, float]:
        """Return the longest way at once for each joint whose zero nobody knows, rad or m."""
        turns = {joint.name: joint.travel_per_turn / math.tau for joint in self.model.joints}
        return {name: LARGEST_STEP_RAD * turns[name] for name in self._servos.names}

    def _clear(self, here: Vector, plan: Plan) -> Plan:
        """Return the plan, if the body's way from ``here`` (n,) to its goal is free."""
        if self._space is not None and self.zeros.known:
            self._space.check_way(self._planner.way(here, plan))
        return plan

    def _follow(self, plan: Plan, on_progress: Callable[[Progress], None] | None) -> Vector:
        paces = self._planner.paces(plan.speed)
        move = JointMove(self._servos.goals(), plan.goal, paces)
        travel(self._servos, move, self._watcher(on_progress))
        return correct(self._servos, plan.goal, settle(self._servos), paces)

    def _watcher(self, on_progress: Callable[[Progress], None] | None) -> Watcher | None:
        if on_progress is None:
            return None
        return lambda elapsed_s, duration_s, joints: on_progress(
            Progress(elapsed_s, duration_s, self._planner.tip(joints))
        )
