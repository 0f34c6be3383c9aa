"""The arm of a user's program: plan, move, measure, stop, and switch torque off."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Unpack, overload

from numpy.typing import ArrayLike

from ikservo.arm.arguments import (
    check_callable,
    check_choice,
    check_iterable,
    parse_all_positions,
    parse_path,
    parse_points,
)
from ikservo.arm.background_motion import Background, Motion
from ikservo.arm.calibrated_arm import ZeroSource, is_simulated
from ikservo.arm.context import ArmContext
from ikservo.arm.control_server import CommandHandler, ControlServer, serve
from ikservo.arm.execution import (
    GripperOptions,
    JointOptions,
    PointOptions,
    ThroughOptions,
    execute,
    lower,
    move_joints,
    move_tip,
    relax,
    run_plan,
)
from ikservo.arm.following import (
    CartesianOrJointTarget,
    FollowResult,
    GoalSource,
    follow,
    follow_arm,
    follow_goals,
)
from ikservo.arm.gripper import GraspResult, GripperCommand, move_gripper, resolve_goal
from ikservo.arm.jogging import JogResult, KeepGoing, jog
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.plan import MotionPlan, PoseWithinLimits
from ikservo.arm.poses import PoseLibrary, teach
from ikservo.arm.preflight import PreflightPlanner
from ikservo.arm.recording import Recording, RecordResult, record_arm
from ikservo.arm.replay import RecordedTrajectory, ReplayResult, load_replay, replay
from ikservo.arm.reports import ArmState, JointMoveResult, MoveResult, OnProgress
from ikservo.arm.setpoint_stream import SetpointStream
from ikservo.arm.settling import SettlingResult
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation
from ikservo.clock import Clock
from ikservo.control.stopping import STOPPED_BY_PROGRAM
from ikservo.deprecation import current_name
from ikservo.errors import BadValueError
from ikservo.guard import StopKind, StopReason
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model

__all__ = ["Arm", "OnExit"]

OnExit = Literal["hold", "relax"]

JointPositions = Mapping[str, float] | ArrayLike
"""Positions by joint, or of all joints (n,), rad or m."""

BLEND_M = 0.02
"""The distance from a waypoint at which the path turns towards the next."""

_RENAMED = {
    "glimpse": "last_state",
    "plan_down": "plan_lowering",
    "release": "disable_torque",
    "stops_asked": "stop_requests",
}


class Arm:
    """An arm on an open port; see ``open_arm``.

    The first motion switches torque on. It stays on when the arm is closed unless ``on_exit`` is
    ``relax``: an arm never drops because a program ended.

    Args:
        context: What the arm is made of.
        runner: Runs its motions.
        on_exit: What ``close`` does with torque: ``hold`` or ``relax``.

    Attributes:
        model: The arm's model.
        chain: Base to tool, inside this arm's limits in whole ticks.
        zeros: Where the zeros of its joints come from.
        poses: The poses of its arm file, and the taught ones.
        joint_index: Which column of vectors of all joints (n,) is which.
    """

    def __init__(self, context: ArmContext, runner: MotionRunner, on_exit: OnExit = "hold") -> None:
        self._on_exit: OnExit = check_choice("way to exit", on_exit, ("hold", "relax"))
        self._context, self._runner, self._port = context, runner, context.port
        self.model: Model = context.model
        self.chain: Chain = context.chain
        self.zeros: ZeroSource = context.zeros
        self.joint_index: JointIndex = context.index
        self.poses = PoseLibrary(context.model, context.serial_number)
        self._preflight = PreflightPlanner(context, runner, self.poses)
        self._background = Background(runner, context.servos.stop_request)
        self._server: ControlServer | None = None
        runner.on_overheat = self._lower

    def __repr__(self) -> str:
        """Return arm, port and why it is stopped; reads no servo."""
        state = "open" if self._port.is_open else "closed"
        stopped = f", stopped: {self.stopped_for}" if self.stopped_for else ""
        return f"Arm({self.model.name!r} on {self.port_name!r}, {state}{stopped})"

    def __enter__(self) -> Arm:
        """Return the arm; leaving the block closes it.

        Raises:
            PortError: It was closed before.
        """
        self._runner.check_open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(self._on_exit if error is None else "hold")

    if not TYPE_CHECKING:  # a type checker knows today's names only

        def __getattr__(self, name: str) -> object:
            """Return what an old name stands for, for one version more; it warns."""
            return getattr(self, current_name("Arm", _RENAMED, name))

    @property
    def port_name(self) -> str:
        """Return the name of the port the arm is on."""
        return self._port.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return all joints, in the order of vectors (n,)."""
        return self._context.servos.names

    @property
    def clock(self) -> Clock:
        """Return the clock of the port: simulated time on a simulated bus."""
        return self._context.servos.clock

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lower and upper limits (n,), in whole ticks, rad or m."""
        return self._context.limits()

    def clearance_m(self, positions: JointPositions) -> float:
        """Return the smallest distance of the body [m] to itself, the table and the boxes.

        Args:
            positions: By joint, rad or m; the others as measured. Or of all joints (n,).

        Returns:
            Infinite where the arm is not calibrated or was opened without collision checks.
        """
        return self._preflight.clearance_m(positions)

    def where(self) -> ArmState:
        """Measure tip, joints and health.

        While another thread moves the arm, they are those of its last control cycle.
        """
        return self._runner.state()

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle; reads no servo and is safe in any thread.

        Raises:
            IkservoError: There was none yet.
        """
        return self._runner.last_state()

    def close(self, on_exit: OnExit | None = None) -> None:
        """Close the port, leaving the arm held or relaxed; the second call does nothing.

        Motions in the background are cancelled; another running motion ends with ``StoppedError``.

        Args:
            on_exit: ``hold`` or ``relax``; as given to ``open_arm`` if None.

        Raises:
            UnknownNameError: Neither; the arm stays open.
            RefusedError: The arm shall be relaxed, and a callback of its motion closes it.
        """
        chosen = check_choice("way to exit", on_exit or self._on_exit, ("hold", "relax"))
        if self._port.is_open:
            self._background.close()
            self._runner.close(self.relax if chosen == "relax" else None, self._close_server)

    def listen(self) -> None:
        """Accept stop, state and relax commands of this user's other processes."""
        if self._server is None and not is_simulated(self.port_name):
            self._server = serve(self.port_name, CommandHandler(self._runner, self.relax))
            self._runner.caches_states = self._server is not None

    def enable(self) -> None:
        """Switch torque on; each servo's goal is set to its position first, so nothing moves.

        Raises:
            RefusedError: A motion is running; ``stop`` ends it.
        """
        self._runner.enable()

    def hold(self) -> None:
        """Hold the present position: another name of ``enable``."""
        self.enable()

    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower the arm to its rest pose, slowly, then switch every servo's torque off.

        The rest pose is clamped to the limits. Where the arm cannot be lowered, for something is in
        the way or a servo has a fault, torque is switched off at once; the result then has
        ``reached`` False and the reason in ``binding``.

        Raises:
            CalibrationError: The arm is not calibrated; see ``disable_torque``.
            RefusedError: A motion is running, or a stop was not acknowledged; the arm holds.
            BusError: A servo does not answer; the torque of all others is off.
        """
        return relax(self._context, self._runner, self._preflight, on_progress)

    def disable_torque(self) -> None:
        """Switch every servo's torque off; an arm that is not supported falls.

        A running motion ends with ``StoppedError`` first.

        Raises:
            BusError: A servo does not answer; the torque of all others is off.
        """
        self._runner.disable_torque()

    def reconnect(self, within_s: float = 10.0) -> None:
        """Open the port again after the cable was pulled; moves nothing.

        The arm stays stopped until ``acknowledge``. Its servos may have been without power: torque
        is read again, and the first motion is slow.

        Args:
            within_s: How long to wait for the adapter, known by its USB serial number.

        Raises:
            BadValueError: The wait is no number of seconds.
            PortLostError: The adapter was not plugged in in time.
            ServoSilentError: A servo does not answer.
            RefusedError: A motion is running.
        """
        self._runner.reconnect(within_s)

    def return_within_limits(self) -> None:
        """Move joints that are a little outside their limits back inside, slowly."""
        self._runner.return_within_limits()

    def stop(self, reason: str = "") -> None:
        """Brake the running motion within 0.3 s and hold; safe from signals and other threads.

        The motion ends with ``StoppedError``; nothing moves again before ``acknowledge``.
        """
        text = str(reason) or STOPPED_BY_PROGRAM.text
        self.request_stop(StopReason(StopKind.PROGRAM, text))

    def request_stop(self, reason: StopReason) -> None:
        """Stop as ``stop`` does, for a reason of any kind."""
        self._runner.request_stop(reason)

    @property
    def stop_requests(self) -> int:
        """Return how often a stop was requested since the last ``acknowledge``."""
        return self._runner.stop_requests

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the arm was stopped, until ``acknowledge``; None where it is not stopped."""
        return self._runner.stop_reason

    @property
    def stopped_for(self) -> str:
        """The text of ``stop_reason``; empty where the arm is not stopped."""
        return self._runner.stop_text

    def acknowledge(self) -> None:
        """End a stop: the cause is gone, and the arm may be moved again; nothing moves yet."""
        self._runner.acknowledge()

    def plan_to(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Plan a motion of the tip to a point (3,) [m], base frame; see ``move_to``.

        Raises:
            UnreachableError: It is out of reach; carries the nearest point.
        """
        return self._preflight.plan_to(position_m, speed, check_orientation(stance, orientation))

    def plan_line(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Plan a straight line of the tip to a point; see ``move_line``."""
        stance = check_orientation(stance, orientation)
        return self.plan_through([position_m], line=True, speed=speed, stance=stance)

    def plan_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        blend_m: float = BLEND_M,
        line: bool = False,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Plan a motion through points without a stop; see ``move_through``."""
        stance = check_orientation(stance, orientation)
        return self._preflight.plan_through(points_m, blend_m, speed, stance, line=line)

    def plan_joints(self, positions: JointPositions, *, speed: str = "normal") -> MotionPlan:
        """Plan a motion of some joints; see ``move_joints``."""
        return self._preflight.plan_joints(positions, speed)

    def plan_rest(self) -> MotionPlan:
        """Plan the slow motion to the rest pose, by another pose where the path is not free."""
        return self._preflight.plan_rest()

    def plan_lowering(self) -> MotionPlan:
        """Plan the slow motion to the rest pose, or as much of it as is free."""
        return self._preflight.plan_lowering()

    def pose_within_limits(self, pose: str, start: Vector | None = None) -> PoseWithinLimits:
        """Clamp a named pose to this arm's limits, which may be narrower than the pose.

        The rest pose is clamped however far it is beyond them: an arm must always be able to come
        down. Another pose is where its joints are on their end stops, just beyond a limit.

        Args:
            pose: Its name.
            start: The present joints (n,); measured if None.

        Raises:
            UnknownNameError: No such pose.
        """
        return self._preflight.pose_within_limits(pose, start)

    def execute(
        self, plan: MotionPlan, on_progress: OnProgress | None = None
    ) -> MoveResult | JointMoveResult:
        """Execute a plan, block until the arm is at rest, and report the measured result.

        Returns:
            A ``MoveResult`` for a plan of ``plan_to``, ``plan_line`` or ``plan_through``; for a
            plan of joints a ``JointMoveResult`` of those that it moves.

        Raises:
            RefusedError: The arm has moved since it was planned, or the guard stopped it.
        """
        return execute(self._context, self._runner, plan, on_progress)

    def go(self, plan: MotionPlan, on_progress: OnProgress | None = None) -> SettlingResult:
        """Execute a plan. Deprecated: use ``execute``, whose report says more."""
        _warn_deprecated("go")
        return run_plan(self._context, self._runner, plan, on_progress)[1]

    def carry_out(self, plan: MotionPlan, on_progress: OnProgress | None = None) -> MoveResult:
        """Execute a plan of the tip. Deprecated: use ``execute``."""
        _warn_deprecated("carry_out")
        return move_tip(self._context, self._runner, plan, on_progress)

    @overload
    def move_to(
        self, position_m: ArrayLike, *, wait: Literal[True] = True, **options: Unpack[PointOptions]
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
            speed: slow, normal or fast; the first motion after torque comes on is slow.
            stance: The orientation of the tool at the end; by default the arm keeps the present one
                as well as it can.
            orientation: The whole orientation R_base_tip (3, 3) instead. Arms with fewer than six
                joints have it at few points; they take a direction or a pitch.
            on_progress: Called in every control cycle, in the thread that moves the arm.
            wait: Whether to block. If false the motion is planned and runs in the background, after
                the ones before it; the returned ``Motion`` has ``done``, ``wait`` and ``cancel``,
                its ``wait`` returns the result and raises the errors. Closing the arm cancels it.

        Raises:
            UnreachableError: No joint positions within the limits reach it; nothing has moved.
            OrientationError: The tool cannot have the orientation there; nothing has moved.
            CalibrationError: The arm is not calibrated; nothing has moved.
            RefusedError: Something is in the way, or the guard stopped the motion; the arm holds.
            StoppedError: ``stop`` was called, here or by another process; the arm holds.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        stance = check_orientation(stance, orientation)
        return self._move_tip(
            lambda: self.plan_to(position_m, speed=speed, stance=stance), on_progress, wait=wait
        )

    @overload
    def move_line(
        self, position_m: ArrayLike, *, wait: Literal[True] = True, **options: Unpack[PointOptions]
    ) -> MoveResult: ...
    @overload
    def move_line(
        self, position_m: ArrayLike, *, wait: Literal[False], **options: Unpack[PointOptions]
    ) -> Motion[MoveResult]: ...
    def move_line(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> MoveResult | Motion[MoveResult]:
        """Move the tip to a point on a straight line, and block until the arm is at rest.

        Options and errors are those of ``move_to``; the tool turns evenly along the line.

        Raises:
            UnreachableError: A point on the line is out of reach; nothing has moved.
        """
        stance = check_orientation(stance, orientation)
        return self._move_tip(
            lambda: self.plan_line(position_m, speed=speed, stance=stance), on_progress, wait=wait
        )

    @overload
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        wait: Literal[True] = True,
        **options: Unpack[ThroughOptions],
    ) -> MoveResult: ...
    @overload
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        wait: Literal[False],
        **options: Unpack[ThroughOptions],
    ) -> Motion[MoveResult]: ...
    def move_through(
        self,
        points_m: Sequence[ArrayLike],
        *,
        blend_m: float = BLEND_M,
        line: bool = False,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> MoveResult | Motion[MoveResult]:
        """Move the tip through points without a stop, to rest at the last.

        Args:
            points_m: The points (k, 3), metres, in the arm's base frame.
            blend_m: Within which distance the tip passes each point but the last.
            line: Whether the tip moves on straight lines; else the joints do.
            speed: slow, normal or fast.
            stance: The orientation of the tool at the last point.
            orientation: The whole orientation R_base_tip (3, 3) there instead.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnreachableError: A point, or a line to it, is out of reach; nothing has moved. Others
                as for ``move_to``.
        """
        stance, points_m = check_orientation(stance, orientation), parse_points(points_m)
        return self._move_tip(
            lambda: self._preflight.plan_through(points_m, blend_m, speed, stance, line=line),
            on_progress,
            wait=wait,
        )

    @overload
    def move_joints(
        self,
        positions: JointPositions,
        *,
        wait: Literal[True] = True,
        **options: Unpack[JointOptions],
    ) -> JointMoveResult: ...
    @overload
    def move_joints(
        self, positions: JointPositions, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[JointMoveResult]: ...
    def move_joints(
        self,
        positions: JointPositions,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointMoveResult | Motion[JointMoveResult]:
        """Move some joints and block until the arm is at rest.

        Args:
            positions: By joint, rad, or m for prismatic ones; the others stay. Or an array of all
                joints (n,), in the order of ``joint_names``.
            speed: slow, normal or fast.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            UnknownNameError: No such joint.
            RefusedError: A position is outside the limits; nothing has moved. Others as for
                ``move_to``.
        """
        check_callable("on_progress", on_progress)
        goal = parse_all_positions(positions, self.joint_names)
        return self._background.run(lambda: self._move_joints(goal, speed, on_progress), wait=wait)

    @overload
    def pose(
        self, name: str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> JointMoveResult: ...
    @overload
    def pose(
        self, name: str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[JointMoveResult]: ...
    def pose(
        self,
        name: str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> JointMoveResult | Motion[JointMoveResult]:
        """Move to a pose of the arm file, or to a taught one, clamped to the limits.

        Args:
            name: Its name.
            speed: slow, normal or fast.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Returns:
            The result; ``binding`` names the joints that were clamped.

        Raises:
            UnknownNameError: No such pose; suggests the closest.
            RefusedError: It is outside this arm's limits, or something is in the way.
        """
        check_callable("on_progress", on_progress)
        self.model.speed(speed)
        inside = self.pose_within_limits(name)
        return self._background.run(lambda: self._move_pose(inside, speed, on_progress), wait=wait)

    @overload
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        wait: Literal[True] = True,
        **options: Unpack[GripperOptions],
    ) -> GraspResult: ...
    @overload
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        wait: Literal[False],
        **options: Unpack[GripperOptions],
    ) -> Motion[GraspResult]: ...
    def gripper(
        self,
        to: GripperCommand | float | None = None,
        *,
        width_m: float | None = None,
        force: float | None = None,
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> GraspResult | Motion[GraspResult]:
        """Open or close the gripper, or move its jaws to a width.

        Where an object blocks the jaws they stop, and hold it with no more than the given force.

        Args:
            to: open, close, or a width in metres where the arm file has widths.
            width_m: The same width, by name.
            force: The fraction of the servo's torque that it may use, 0.05 to 1; 0.3 if None.
            on_progress: Called in every control cycle.
            wait: Whether to block; else the motion runs in the background, see ``move_to``.

        Raises:
            IkservoError: The arm has no gripper.
            RefusedError: A jaw would touch something; nothing has moved.
            BadValueError: The width is out of its range or unknown, or the force is no fraction.
        """
        check_callable("on_progress", on_progress)
        goal, arm = resolve_goal(to, width_m), (self._context, self._runner)
        return self._background.run(lambda: move_gripper(*arm, goal, force, on_progress), wait=wait)

    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[True] = True, **options: Unpack[JointOptions]
    ) -> ReplayResult: ...
    @overload
    def replay(
        self, path: Path | str, *, wait: Literal[False], **options: Unpack[JointOptions]
    ) -> Motion[ReplayResult]: ...
    def replay(
        self,
        path: Path | str,
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
        wait: bool = True,
    ) -> ReplayResult | Motion[ReplayResult]:
        """Move to the first pose of a recording of this arm, then along it.

        It is as fast as recorded where that is within the speed class, else slowed down as a whole.

        Raises:
            FileFormatError: It is malformed, or another arm's; says in which line.
            RefusedError: It leaves this arm's limits, or something is in the way; nothing moved.
            CalibrationError: The arm is not calibrated.
        """
        path, arm = self._check_replay(path, speed), (self._context, self._runner)
        check_callable("on_progress", on_progress)
        return self._background.run(lambda: replay(*arm, path, speed, on_progress), wait=wait)

    def load_replay(
        self, path: Path | str, *, speed: str = "normal"
    ) -> tuple[Recording, RecordedTrajectory]:
        """Read a recording, and what ``replay`` would play after its first pose; nothing moves.

        Raises:
            FileFormatError, RefusedError, CalibrationError: As ``replay``.
        """
        return load_replay(self._context, self._check_replay(path, speed), speed)

    def record(
        self,
        path: Path | str,
        *,
        duration_s: float | None = None,
        until: Callable[[], bool] | None = None,
        period_s: float = 0.02,
        overwrite: bool = False,
    ) -> RecordResult:
        """Write the measured joints to a file at a fixed rate; torque stays as it is.

        Ctrl-C ends it; the file is complete up to then.

        Args:
            path: A new file: a header, then one line of JSON for each sample.
            duration_s: How long; until ``until`` returns True if None.
            until: Called at each sample.
            period_s: Between two samples.
            overwrite: Whether an existing file may be replaced.

        Raises:
            BadValueError: The file exists, or a number is out of its range.
            FileWriteError: It cannot be written.
            ServoSilentError: A servo does not answer; the samples before are kept.
        """
        return record_arm(self._context, path, duration_s, until, period_s, overwrite=overwrite)

    def teach(
        self, name: str, until: Callable[[], object] | None = None, *, hold: bool = False
    ) -> dict[str, float]:
        """Save the measured joints as a pose of this arm; return them, rad or m by name.

        Args:
            name: 1 to 64 of A-Z a-z 0-9 _ -, and no pose of the arm file.
            until: Returns once the arm has been moved by hand. The arm is relaxed before, if it
                holds; without this nothing is relaxed.
            hold: Whether torque is switched on afterwards.

        Raises:
            BadValueError: The name cannot be used; nothing has moved.
            FileWriteError: The pose cannot be saved.
        """
        arm = (self._context, self._runner)
        return teach(*arm, self.poses, name, until, self.relax, hold=hold)

    def jog(self, what: str, speed: float | None = None, *, wanted: KeepGoing) -> JogResult:
        """Move a joint or the tip in one direction for as long as ``wanted`` returns True.

        Args:
            what: A joint, or x, y, z, -x, -y, -z, up, down in the arm's base frame.
            speed: rad/s of a joint (m/s of a slide) or m/s of the tip; negative the other way. The
                arm file's slow speed, or 0.05 m/s, if None.
            wanted: Called in every control cycle: True goes on, False brakes and holds, None is no
                news; after 0.3 s without news the arm brakes and holds, too.

        Returns:
            Where it ended, and why: no longer requested, a limit, or the guard.

        Raises:
            UnknownNameError: No such joint or direction.
            BadValueError: The speed is zero, not finite or too high.
        """
        return jog(self._context, self._runner, what, speed, wanted)

    def follow(
        self,
        targets: Iterable[CartesianOrJointTarget | None],
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
        """Follow a stream of targets, one in each control cycle, until it ends.

        Each cycle takes the next item: a ``Target``, a point (3,) [m], a pose (4, 4) of the tip,
        positions by joint [rad or m], or None for nothing new. The arm goes there as fast as its
        speed class allows, without a stop or a jump, and keeps its branch. A target is valid for
        0.3 s: without a new one the arm then brakes where it is.

        At the end the sag under load is corrected, as by ``move_to``, at the last target that the
        guard accepted, or where the arm was braked; not after a stop or an error of the stream.

        Args:
            targets: The stream; a generator may block for a while.
            speed: slow, normal or fast.
            on_progress: Called in every control cycle.

        Raises:
            BadValueError: An item is no target; the arm was braked first.
            StoppedError: ``stop`` was called; the arm holds.
        """
        check_callable("on_progress", on_progress)
        check_iterable("The stream of targets", targets, "an iterable of targets")
        return follow(self._context, self._runner, targets, speed, on_progress)

    def follow_arm(
        self,
        leader: Arm,
        *,
        speed: str = "normal",
        until: Callable[[], bool] | None = None,
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
        """Follow another arm that is guided by hand, joint by joint of the same name.

        The leader's torque is left as it is; its gripper leads the gripper. This arm keeps its own
        limits, and brakes where the leader does not answer for 0.3 s.

        Args:
            leader: An open arm on another port.
            speed: slow, normal or fast; fast keeps closest.
            until: Ends it by returning True.
            on_progress: Called in every control cycle.

        Raises:
            InputError: The arms have no joint in common.
            CalibrationError: One of the arms is not calibrated.
        """
        context, arm = self._leader_context(leader), (self._context, self._runner)
        check_callable("until", until)
        check_callable("on_progress", on_progress)
        return follow_arm(*arm, context, speed, until, on_progress)

    def follow_goals(self, source: GoalSource, *, speed: str = "normal") -> None:
        """Follow joint goals that ``source`` gives in every control cycle, until it ends.

        Raises:
            CalibrationError: The arm is not calibrated.
        """
        follow_goals(self._context, self._runner, source, speed)

    def stream(self, *, speed: str = "normal", rate_hz: float | None = None) -> SetpointStream:
        """Open a stream of setpoints, which the program sends at its own rate.

        ::

            with arm.stream(speed="fast", rate_hz=50) as stream:
                for q in trajectory:           # (n,), or {"elbow_flex": 0.3}, or a Target
                    stream.send(q)

        The arm follows the newest setpoint as fast as the speed class allows and without a jump,
        through the guard. After 0.3 s without one, and at the end of the block, it brakes and
        holds. An error ends the stream and is raised by the next ``send``, or at the end of the
        block.

        Args:
            speed: slow, normal or fast; fast keeps closest.
            rate_hz: Setpoints a second, 5 to 1000: ``send`` returns when the next is due. If None
                it returns at once, and the program keeps its own time.

        Raises:
            CalibrationError: The arm is not calibrated.
            BadValueError: The rate is out of its range.
            RefusedError: Another stream is open.
        """
        start = self._background.start_stream
        return SetpointStream(self._context, self._runner, start, speed, rate_hz)

    def _move_tip(
        self, planning: Callable[[], MotionPlan], on_progress: OnProgress | None, *, wait: bool
    ) -> MoveResult | Motion[MoveResult]:
        check_callable("on_progress", on_progress)
        arm, held = (self._context, self._runner), self._preflight.plan_from_held
        return self._background.run(lambda: move_tip(*arm, held(planning), on_progress), wait=wait)

    def _move_joints(
        self, goal: Mapping[str, float], speed: str, on_progress: OnProgress | None
    ) -> JointMoveResult:
        plan = self._preflight.plan_from_held(lambda: self.plan_joints(goal, speed=speed))
        return move_joints(self._context, self._runner, goal, plan, on_progress)

    def _move_pose(
        self, inside: PoseWithinLimits, speed: str, on_progress: OnProgress | None
    ) -> JointMoveResult:
        report = self._move_joints(inside.positions, speed, on_progress)
        return replace(report, binding=inside.changed + report.binding)

    def _check_replay(self, path: Path | str, speed: str) -> Path:
        self._context.require_zeros()
        self.model.speed(speed)
        return parse_path(path)

    def _leader_context(self, leader: object) -> ArmContext:
        if not isinstance(leader, Arm) or leader is self:
            raise BadValueError("The leader", repr(leader), "another open arm")
        return leader._context

    def _lower(self) -> None:
        lower(self._context, self._runner, self._preflight)

    def _close_server(self) -> None:
        if self._server is not None:
            self._server.close()


def _warn_deprecated(name: str) -> None:
    text = f"Arm.{name} is deprecated: use Arm.execute."
    warnings.warn(text, DeprecationWarning, stacklevel=3)
