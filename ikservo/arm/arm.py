"""The machine a person owns: it goes to a point, says where it is, holds and lets go."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import check_callable, parse_all_positions
from ikservo.arm.background_motion import Motion
from ikservo.arm.motion_options import JointOptions, OnProgress, PointOptions
from ikservo.arm.motion_runner import CLOSED
from ikservo.arm.plan import MotionPlan, rebase_trajectory
from ikservo.arm.preflight import Foreseeing
from ikservo.arm.reports import JointMoveResult, MotionProgress, MoveResult
from ikservo.arm.settling import SettlingResult, settle
from ikservo.arm.tick_rounding import SettlingTarget, backlash_approach
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation
from ikservo.arm.zeros import ZeroSource
from ikservo.control.loop import ControlCycle, OnCycle
from ikservo.control.servo_group import ServoGroup
from ikservo.deprecation import current_name
from ikservo.errors import (
    BadValueError,
    IkservoError,
    PortError,
    RefusedError,
    StoppedError,
    UnknownNameError,
)
from ikservo.guard import CollisionChecker
from ikservo.hardware.port import Port
from ikservo.ik import Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model

__all__ = ["Arm", "OnExit"]

OnExit = Literal["hold", "relax"]

# Servos of this class stand within one or two ticks of 0.09° of where they are told.
POSITION_TOLERANCE_M = 0.002
JOINT_TOLERANCE_RAD = math.radians(0.5)


_RENAMED = {
    "glimpse": "last_state",
    "plan_by": "plan_cartesian",
    "plan_down": "plan_lowering",
    "release": "disable_torque",
    "stops_asked": "stop_requests",
}


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
        servos: ServoGroup,
        port: Port,
        on_exit: OnExit = "hold",
        space: CollisionChecker | None = None,
        zeros: ZeroSource = ZeroSource.SIMULATED,
    ) -> None:
        if on_exit not in ("hold", "relax"):
            raise UnknownNameError("way to exit", on_exit, ("hold", "relax"))
        super().__init__(model, chain, servos, port, space, zeros)
        self._on_exit: OnExit = on_exit

    def __repr__(self) -> str:
        """Return which arm on which port, and how it is; asks no servo."""
        state = "open" if self._port.is_open else "closed"
        stopped = f", stopped: {self.stopped_for}" if self.stopped_for else ""
        return f"Arm({self.model.name!r} on {self.port_name!r}, {state}{stopped})"

    def __enter__(self) -> Arm:
        """Return the arm; leaving the block closes it.

        Raises:
            PortError: It was closed before.
        """
        self._check_open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(self._on_exit if error is None else "hold")

    def execute(
        self, plan: MotionPlan, on_progress: OnProgress | None = None
    ) -> MoveResult | JointMoveResult:
        """Move as planned, block until the arm is at rest, and report how it ended, measured.

        Args:
            plan: Of this arm, from where it holds now.
            on_progress: Called in every control cycle.

        Returns:
            A ``MoveResult`` of a plan of ``plan_to``, ``plan_line`` or ``plan_through``; of a plan
            of joints a ``JointMoveResult`` of those that it moves.

        Raises:
            RefusedError: The arm has moved since it was planned, or the guard stopped it; the arm
                holds.
            StoppedError: It was stopped by ``stop`` or from another terminal; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        plan, arrival = self._run_plan(plan, on_progress)
        if plan.target_m is not None:
            return self._move_report(plan, arrival)
        ends = zip(plan.names, plan.start.tolist(), plan.goal.tolist(), strict=True)
        moved = {name: goal for name, start, goal in ends if goal != start}
        return self._joint_report(moved, arrival)

    if not TYPE_CHECKING:  # a type checker knows today's names only

        def __getattr__(self, name: str) -> object:
            """Return what an old name stands for, for one version more; it warns."""
            return getattr(self, current_name("Arm", _RENAMED, name))

    def go(self, plan: MotionPlan, on_progress: OnProgress | None = None) -> SettlingResult:
        """Execute a plan. Deprecated: use ``execute``, whose report says more."""
        warnings.warn("Arm.go is deprecated: use Arm.execute.", DeprecationWarning, stacklevel=2)
        return self._run_plan(plan, on_progress)[1]

    def carry_out(self, plan: MotionPlan, on_progress: OnProgress | None = None) -> MoveResult:
        """Execute a plan of the tip. Deprecated: use ``execute``."""
        warnings.warn(
            "Arm.carry_out is deprecated: use Arm.execute.", DeprecationWarning, stacklevel=2
        )
        return self._execute_move(plan, on_progress)

    def _execute_move(self, plan: MotionPlan, on_progress: OnProgress | None) -> MoveResult:
        """Execute a plan of the tip.

        Raises:
            BadValueError: It is a plan of joints.
        """
        _check_plan(plan)
        _require_target(plan)
        return self._move_report(*self._run_plan(plan, on_progress))

    def _run_plan(
        self, plan: MotionPlan, on_progress: OnProgress | None
    ) -> tuple[MotionPlan, SettlingResult]:
        """Execute a plan; return it as it was from where the arm held, and where it ended."""
        _check_plan(plan)
        check_callable("on_progress", on_progress)
        self._check_speed(plan)
        with self._motion_turn():
            plan = self._replan_if_moved(plan)
            return plan, self._run_motion(plan, on_progress)

    @overload
    def move_to(
        self,
        position_m: ArrayLike,
        *,
        wait: Literal[True] = True,
        **options: Unpack[PointOptions],
    ) -> MoveResult: ...
    @overload
    def move_to(
        self, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[PointOptions]
    ) -> Motion[MoveResult]: ...
    def move_to(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> MoveResult | Motion[MoveResult]:
        """Move the tip to a point and block until the arm is at rest.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast.
            stance: How the tool shall stand there, see ``plan_to``.
            orientation: The whole orientation R_base_tip (3, 3), instead of a stance. Arms with
                fewer than six joints have it at few points; they take a direction or a pitch.
            on_progress: Called in every control cycle, in the thread that moves the arm.
            wait: Whether to block. If false the motion is planned and runs in the background,
                after the ones before it; the returned ``Motion`` has ``done``, ``wait`` and
                ``cancel``, its ``wait`` returns the report and raises the errors. Closing the arm
                cancels it.

        Raises:
            UnreachableError: No joints inside the limits reach it; nothing has moved.
            OrientationError: The tool cannot stand there as asked; nothing has moved.
            RefusedError: The guard will not pass a goal on.
            StoppedError: It was stopped by ``stop`` or from another terminal; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        check_callable("on_progress", on_progress)
        asked = check_orientation(stance, orientation)

        def move() -> MoveResult:
            plan = self._plan_from_held(lambda: self.plan_to(position_m, speed=speed, stance=asked))
            return self._execute_move(plan, on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)

    def _move_report(self, plan: MotionPlan, arrival: SettlingResult) -> MoveResult:
        tip_m = self._planner.tip(arrival.measured)
        target_m, solution = _require_target(plan)
        error_m = float(np.linalg.norm(target_m - tip_m))
        limits = tuple(str(limit) for limit in solution.binding)
        return MoveResult(
            target_m=target_m,
            commanded_tip_m=plan.tip_m,
            measured_tip_m=tip_m,
            error_m=error_m,
            duration_s=arrival.duration_s,
            reached=error_m <= POSITION_TOLERANCE_M,
            binding=limits + arrival.residuals,
            orientation_error_rad=plan.orientation_error_rad
            + self._planner.rotation_between(plan.goal, arrival.measured),
            motion_s=arrival.motion_s,
            settling_s=arrival.settling_s,
            orientation_requested=plan.orientation_requested,
            orientation_change_rad=self._planner.rotation_between(plan.start, arrival.measured),
        )

    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[True] = True,
        **options: Unpack[JointOptions],
    ) -> JointMoveResult: ...
    @overload
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        wait: Literal[False],
        **options: Unpack[JointOptions],
    ) -> Motion[JointMoveResult]: ...
    def move_joints(
        self,
        positions: Mapping[str, float] | ArrayLike,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointMoveResult | Motion[JointMoveResult]:
        """Move some joints and block until the arm is at rest.

        Args:
            positions: By joint, rad, or m for prismatic ones; the others stay. Or an array of all
                joints (n,), in the order of ``where().names``.
            speed: slow, normal or fast.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnknownNameError: No such joint.
            RefusedError: A position lies outside the joint's limits; nothing has moved.
            StoppedError: It was stopped by ``stop`` or from another terminal; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        check_callable("on_progress", on_progress)
        goal = parse_all_positions(positions, self._servos.names)

        def move() -> JointMoveResult:
            plan = self._plan_from_held(lambda: self.plan_joints(goal, speed=speed))
            return self._move_along_plan(goal, plan, on_progress)

        return self._background.run_blocking(move) if wait else self._background.start(move)

    def _move_along_plan(
        self,
        positions: Mapping[str, float],
        plan: MotionPlan,
        on_progress: Callable[[MotionProgress], None] | None,
    ) -> JointMoveResult:
        return self._joint_report(positions, self._run_plan(plan, on_progress)[1])

    def _joint_report(
        self, positions: Mapping[str, float], arrival: SettlingResult
    ) -> JointMoveResult:
        measured = arrival.measured
        there = {name: float(measured[self._planner.joint_index(name)]) for name in positions}
        errors = (abs(there[name] - position) for name, position in positions.items())
        error_rad = max(errors, default=0.0)
        return JointMoveResult(
            goal_rad=dict(positions),
            measured_rad=there,
            measured_tip_m=self._planner.tip(measured),
            error_rad=error_rad,
            duration_s=arrival.duration_s,
            reached=error_rad <= JOINT_TOLERANCE_RAD,
            binding=arrival.residuals,
        )

    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower the arm to its rest pose, slowly, then switch every servo's torque off.

        The rest pose is brought inside the arm's limits. Where the arm cannot be lowered, for
        something is in its way or a servo is not well, torque is switched off where it stands;
        the report then has ``reached`` False and says why in ``binding``.

        Raises:
            CalibrationError: Nobody knows where the rest pose is; see ``release``.
            StoppedError: Somebody stopped it; the arm holds.
            RefusedError: A motion is running, or a stop was not acknowledged; the arm holds.
            BusError: A servo does not answer; the torque of all others is off.
        """
        self.zeros.require_known(self.model.name)
        with self._turn:
            self._servos.torque.check_idle()
            self._servos.check_stop()
            self._servos.torque.invalidated()  # enabled anew by limits that let it come down
            report = self._try_lower(on_progress)
            self.disable_torque()
            return (
                self._release_without_lowering(report)
                if isinstance(report, IkservoError)
                else report
            )

    def _try_lower(
        self, on_progress: Callable[[MotionProgress], None] | None
    ) -> JointMoveResult | IkservoError:
        """Lower the arm as far as its way is free; return why where it could not be lowered."""
        try:
            return self._lower(on_progress)
        except (StoppedError, PortError):
            raise
        except IkservoError as error:
            if self._servos.stop_request:
                raise
            return error

    def _lower(
        self, on_progress: Callable[[MotionProgress], None] | None = None
    ) -> JointMoveResult:
        with self._servos.tolerate_heat():
            plan = self._plan_from_held(self.plan_lowering)
            inside = self._rest_pose()
            report = self._move_along_plan(inside.positions, plan, on_progress)
        return replace(report, binding=inside.changed + report.binding)

    def _release_without_lowering(self, error: IkservoError) -> JointMoveResult:
        """Return where an arm was let go that could not be lowered."""
        rest, where = dict(self.model.pose("rest")), self.where()
        measured = {name: where.positions[name] for name in rest}
        return JointMoveResult(
            goal_rad=rest,
            measured_rad=measured,
            measured_tip_m=where.tip_m,
            error_rad=max(abs(measured[name] - rest[name]) for name in rest),
            duration_s=0.0,
            reached=False,
            binding=(f"not lowered, torque is off: {error.message}",),
        )

    def close(self, on_exit: OnExit | None = None) -> None:
        """Give the port back, leaving the arm held or relaxed; the second time is nothing.

        What runs in the background is cancelled; another running motion ends with
        ``StoppedError`` first.

        Args:
            on_exit: ``hold`` or ``relax``; what ``open_arm`` was told if None.

        Raises:
            UnknownNameError: Neither; the arm stays open.
            RefusedError: The arm shall be relaxed, and the callback of a motion asks for that.
        """
        if on_exit not in (None, "hold", "relax"):
            raise UnknownNameError("way to exit", on_exit, ("hold", "relax"))
        if not self._port.is_open:
            return
        self._background.close()
        relaxed = (on_exit or self._on_exit) == "relax"
        if relaxed:
            with self._turn:
                self._servos.torque.check_idle()
        try:
            if relaxed:
                self.relax()
        finally:
            self._closed = True
            with self._after_motion(*CLOSED):
                pass
            if self._listener is not None:
                self._listener.close()
            with self._turn:  # not while another terminal relaxes the arm
                self._port.close()

    def _run_motion(
        self, plan: MotionPlan, on_progress: Callable[[MotionProgress], None] | None
    ) -> SettlingResult:
        servos, paces = self._servos, self._planner.motion_limits(plan.speed)
        horn_rad_s = self.model.speed(plan.speed).rad_s
        course = rebase_trajectory(plan, servos.goals(), paces, servos.names)
        self.workings.check_streamed_path(course, plan.speed)
        aim = SettlingTarget(self.chain, servos.fences, plan, servos.measure_positions())
        started_s = servos.clock.now_s()
        self._stream.run(course, self._progress_reporter(on_progress), speed_rad_s=horn_rad_s)
        motion_s = servos.clock.now_s() - started_s
        below = self._backlash_goals(plan)
        return settle(self._stream, servos, aim, paces, horn_rad_s, motion_s, below)

    def _backlash_goals(self, plan: MotionPlan) -> Vector | None:
        """Return the goals from which joints with known play come up to their places (n,).

        None on a line, on which the tool stays, and where something is in that way.
        """
        goals, fences = self._servos.goals(), self._servos.fences
        backlash = np.array([self.model.joint(name).backlash for name in self._servos.names])
        below = backlash_approach(goals, plan.goal != plan.start, backlash, fences)
        if below is None or plan.is_cartesian:
            return None
        try:
            self.workings.check_straight_path(goals, below)
        except RefusedError:
            return None
        return below

    def _progress_reporter(
        self, on_progress: Callable[[MotionProgress], None] | None
    ) -> OnCycle | None:
        if on_progress is None:
            return None

        def tell(beat: ControlCycle) -> None:
            on_progress(self.workings.progress(beat))

        return tell


def _check_plan(plan: object) -> None:
    if not isinstance(plan, MotionPlan):
        raise BadValueError(
            "The plan", repr(plan), "a plan, such as arm.plan_to((0.25, 0.0, 0.15))"
        )


def _require_target(plan: MotionPlan) -> tuple[Vector, Result]:
    if plan.target_m is None or plan.solution is None:
        raise BadValueError("The plan", "a motion of joints", "a plan of plan_to")
    return plan.target_m, plan.solution
