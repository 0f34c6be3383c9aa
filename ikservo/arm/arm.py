"""The machine a person owns: it goes to a point, says where it is, holds and lets go."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arriving.aim import Aim
from ikservo.arm.arriving.arrival import Arrival, arrive
from ikservo.arm.arriving.one_side import drawn_back
from ikservo.arm.foreseeing import Foreseeing
from ikservo.arm.planning import AS_IT_CAN, Plan, Stance, begun
from ikservo.arm.reports import JointReport, MoveReport, Progress
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.servos import Servos
from ikservo.arm.streaming.stream import OnBeat
from ikservo.arm.trust import Zeros
from ikservo.errors import BadValueError, RefusedError, UnknownNameError
from ikservo.guard import Space
from ikservo.hardware.line.port import Port
from ikservo.kinematics import Chain
from ikservo.model import Model
from ikservo.motion import JointMove, Pace

__all__ = ["Arm", "OnExit"]

OnExit = Literal["hold", "relax"]

# Servos of this class stand within one or two ticks of 0.09° of where they are told.
ARRIVAL_M = 0.002
ARRIVAL_RAD = math.radians(0.5)


class Arm(Foreseeing):
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
        plan = self._held_to(lambda: self.plan_to(position_m, speed=speed, stance=stance))
        return self.carry_out(plan, on_progress)

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
        plan = self._held_to(lambda: self.plan_joints(positions, speed=speed))
        return self._bring(positions, plan, on_progress)

    def _bring(
        self,
        positions: Mapping[str, float],
        plan: Plan,
        on_progress: Callable[[Progress], None] | None,
    ) -> JointReport:
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
            RefusedError: Neither the straight way there nor one by its other poses is free.
        """
        self.zeros.check(self.model.name)
        self._enabled = False  # torque is looked at anew, by limits that let it come down
        with self._servos.bearing_heat():
            plan = self._held_to(self.plan_rest)
            report = self._bring(self._rest(), plan, on_progress)
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

    def _follow(self, plan: Plan, on_progress: Callable[[Progress], None] | None) -> Arrival:
        servos, paces = self._servos, self._planner.paces(plan.speed)
        horn_rad_s = self.model.speed(plan.speed).rad_s
        aim = Aim(self.chain, servos.fences, plan, servos.measure())
        course = begun(plan, servos.goals(), paces, servos.names)
        started_s = servos.clock.now_s()
        self._stream.run(course, self._watcher(on_progress), speed_rad_s=horn_rad_s)
        motion_s = servos.clock.now_s() - started_s
        if not plan.straight:  # the tool stays on its line
            self._take_up_play(plan, paces, horn_rad_s)
        arrival = arrive(self._stream, servos, aim, paces, horn_rad_s, motion_s)
        return replace(arrival, settling_s=servos.clock.now_s() - started_s - motion_s)

    def _take_up_play(self, plan: Plan, paces: Sequence[Pace], horn_rad_s: float) -> None:
        """Let joints with known play come from below, unless something is in that way."""
        servos, goals = self._servos, self._servos.goals()
        backlash = np.array([self.model.joint(name).backlash for name in servos.names])
        below = drawn_back(goals, plan.goal != plan.start, backlash, servos.fences)
        if below is None:
            return
        try:
            self.workings.check_way(goals, below)
        except RefusedError:
            return
        self._stream.run(JointMove(goals, below, paces), speed_rad_s=horn_rad_s)

    def _watcher(self, on_progress: Callable[[Progress], None] | None) -> OnBeat | None:
        if on_progress is None:
            return None

        def tell(beat: Beat) -> None:
            on_progress(Progress(beat.time_s, beat.duration_s, self._planner.tip(beat.measured)))

        return tell
