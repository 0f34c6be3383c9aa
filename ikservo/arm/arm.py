"""The machine a person owns: it goes to a point, says where it is, holds and lets go."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.journey import Watcher, correct, settle, travel
from ikservo.arm.reports import JointReport, MoveReport, Progress, Whereabouts
from ikservo.arm.servos import Servos
from ikservo.errors import BadValueError, StoppedError, UnknownNameError, UnreachableError
from ikservo.hardware.port import Port
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model
from ikservo.motion import JointMove, Pace

__all__ = ["Arm", "OnExit", "Plan"]

OnExit = Literal["hold", "relax"]

# Servos of this class stand within one or two ticks of 0.09° of where they are told.
ARRIVAL_M = 0.002
ARRIVAL_RAD = math.radians(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A motion that could start now.

    Attributes:
        goal: Where all joints would end (n,), rad or m.
        tip_m: Where that puts the tip (3,), metres.
        duration_s: How long it takes.
        target_m: The point it goes to (3,); None for a motion of joints.
        solution: What the solver answered; None for a motion of joints.
    """

    goal: Vector
    tip_m: Vector
    duration_s: float
    speed: str
    target_m: Vector | None = None
    solution: Result | None = None


class Arm:
    """An arm on an open port; see ``open_arm``.

    Torque is switched on by the first motion, and stays on when the arm is closed unless
    ``on_exit`` says ``relax``: an arm never drops because a program ended.

    Attributes:
        model: What the arm is.
        chain: Base to tool, inside this arm's limits in whole ticks.
    """

    def __init__(
        self, model: Model, chain: Chain, servos: Servos, port: Port, on_exit: OnExit = "hold"
    ) -> None:
        if on_exit not in ("hold", "relax"):
            raise UnknownNameError("way to exit", on_exit, ("hold", "relax"))
        self.model, self.chain = model, chain
        self._servos, self._port = servos, port
        self._on_exit: OnExit = on_exit
        self._enabled = False
        self._columns = [servos.names.index(name) for name in chain.names]

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
        return Whereabouts(self._tip(joints), states)

    def enable(self) -> None:
        """Let every servo hold where it is; goals are set before torque, so nothing twitches."""
        limits = {name: self._pace(name, "fast").speed_rad_s for name in self._servos.names}
        self._servos.enable(self._per_servo(limits))
        self._enabled = True

    def plan_to(self, position_m: ArrayLike, *, speed: str = "normal") -> Plan:
        """Find joints that bring the tip to a point and the motion that takes them there.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            BadValueError: No three finite numbers.
        """
        self.model.speed(speed)
        target = Target(position_m)
        here = self._here()
        solution = solve(self.chain, target, here[self._columns])
        if not solution.reached:
            raise self._unreachable(target, solution, self._tip(here))
        goal = here.copy()
        goal[self._columns] = solution.q
        return self._plan(here, goal, speed, target.position, solution)

    def plan_joints(self, positions: Mapping[str, float], *, speed: str = "normal") -> Plan:
        """Plan a motion of some joints, each to its position in rad (m for a prismatic one).

        Raises:
            UnknownNameError: No such joint, or no such speed.
            BadValueError: A position is not finite, or no joint is named.
            RefusedError: A position lies outside the joint's limits.
        """
        self.model.speed(speed)
        if not positions:
            raise BadValueError("The list of joints", "empty", "at least one joint")
        here = self._here()
        goal = here.copy()
        for name, position in positions.items():
            goal[self._servos.names.index(self.model.joint(name).name)] = position
        if not np.isfinite(goal).all():
            raise BadValueError("A joint position", "not finite", "radians, or metres for a slide")
        self._servos.check(goal, here)
        return self._plan(here, goal, speed)

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
        tip_m = self._tip(measured)
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
        there = {name: float(measured[self._servos.names.index(name)]) for name in positions}
        error_rad = max(abs(there[name] - position) for name, position in positions.items())
        return JointReport(
            goal_rad=dict(positions),
            measured_rad=there,
            measured_tip_m=self._tip(measured),
            error_rad=error_rad,
            duration_s=duration_s,
            reached=error_rad <= ARRIVAL_RAD,
        )

    def hold(self) -> None:
        """Let every servo hold where it is now."""
        self.enable()

    def relax(self, on_progress: Callable[[Progress], None] | None = None) -> JointReport:
        """Lower the arm to its rest pose, slowly, then switch every servo's torque off."""
        report = self.move_joints(self.model.pose("rest"), speed="slow", on_progress=on_progress)
        self._servos.release()
        self._enabled = False
        return report

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

    def _unreachable(self, target: Target, solution: Result, tip_m: Vector) -> UnreachableError:
        """Say how near the arm can come, and offer a point in whole millimetres that it reaches."""
        nearest_m = solution.nearest_m
        return UnreachableError(
            target.position.tolist(),
            nearest_m.tolist(),
            [str(limit) for limit in solution.binding],
            self._instead(nearest_m, tip_m, solution.q),
        )

    def _instead(self, nearest_m: Vector, tip_m: Vector, q: Vector) -> list[float] | None:
        """Step back from the edge towards where the tip is until a round point is reachable."""
        for share in (0.0, 0.01, 0.02, 0.05, 0.1, 0.2):
            point_m = np.round(nearest_m + share * (tip_m - nearest_m), 3)
            if solve(self.chain, Target(point_m), q, restarts=4).reached:
                return [float(x) for x in point_m]
        return None

    def _plan(
        self,
        here: Vector,
        goal: Vector,
        speed: str,
        target_m: Vector | None = None,
        solution: Result | None = None,
    ) -> Plan:
        duration_s = JointMove(here, goal, self._paces(speed)).duration_s
        return Plan(goal, self._tip(goal), duration_s, speed, target_m, solution)

    def _follow(self, plan: Plan, on_progress: Callable[[Progress], None] | None) -> Vector:
        paces = self._paces(plan.speed)
        move = JointMove(self._servos.goals(), plan.goal, paces)
        travel(self._servos, move, self._watcher(on_progress))
        return correct(self._servos, plan.goal, settle(self._servos), paces)

    def _watcher(self, on_progress: Callable[[Progress], None] | None) -> Watcher | None:
        if on_progress is None:
            return None
        return lambda elapsed_s, duration_s, joints: on_progress(
            Progress(elapsed_s, duration_s, self._tip(joints))
        )

    def _tip(self, joints: Vector) -> Vector:
        return self.chain.forward(joints[self._columns])[:3, 3]

    def _paces(self, speed: str) -> list[Pace]:
        return [self._pace(name, speed) for name in self._servos.names]

    def _pace(self, joint: str, speed: str) -> Pace:
        """Return how fast a joint goes; a slide as fast as its horn turns it."""
        wanted = self.model.speed(speed)
        turning = Pace(wanted.rad_s, wanted.rad_s2, wanted.rad_s3)
        return turning.scaled(self.model.joint(joint).travel_per_turn / (2.0 * math.pi))

    def _per_servo(self, speeds: Mapping[str, float]) -> dict[str, float]:
        """Return joint speeds as the speeds of the horns that make them, rad/s."""
        return {
            name: speed * 2.0 * math.pi / self.model.joint(name).travel_per_turn
            for name, speed in speeds.items()
        }
