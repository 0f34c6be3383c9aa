"""The arm in a user's program: plan, move, measure, stop, and switch torque off."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypeVar

from ikservo.app_discovery import ImportedMethod
from ikservo.arguments import OnExit, check_exit, check_flag
from ikservo.arm.background_motion import Background
from ikservo.arm.motion_methods import MotionMethods, Positions
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.stoppable_bus import StopListener
from ikservo.clock import Clock
from ikservo.guard import StopKind, StopReason
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MotionValue, check_motion
from ikservo.planning.poses import PoseLibrary, PoseWithinLimits, teach
from ikservo.planning.preflight_planner import PreflightPlanner
from ikservo.planning.reports import ArmState, JointMoveResult, MoveResult, OnProgress

if TYPE_CHECKING:
    from ikservo.arm import following, jogging, leader_following, setpoint_stream
    from ikservo.arm.scene import Scene

R = TypeVar("R")


class Arm(MotionMethods):
    """An arm on an open port; see ``open_arm``.

    Units are metres and radians. Points and orientations are in the arm's base frame. Vectors of
    all joints (n,) are in the order of ``joint_names``, with metres for prismatic joints.

    The first motion switches torque on, and is slow. Torque stays on when the arm is closed unless
    ``on_exit`` is ``relax``: an arm never drops because a program ended.

    Motions (``move_to``, ``gripper``, …) block until the arm is at rest. With ``wait=False`` they
    run in the background, after the motions before them, and return a ``RunningMotion``, whose
    ``wait`` returns the result or raises the error. Closing the arm cancels them. ``plan``,
    ``execute`` and ``start`` take a motion as a value; ``ikservo.planning.motions`` documents all
    motions and options. Apps add methods such as ``record`` and ``replay``, and the attribute
    ``camera``.

    Args:
        context: The servos, model, calibration and checks of the arm.
        runner: Runs the arm's motions.
        on_exit: The state after ``close``: ``hold`` or ``relax``.

    Attributes:
        model: The arm's model.
        chain: The joints from base to tool; their limits are those of this arm, at whole ticks.
        zeros: The source of the joint zeros.
        poses: The poses in the arm file, and taught poses.
        joint_index: The columns of the joints in vectors of all joints (n,).
        preflight: The planner and checker of motions; only for use inside this package.
        background: The runner of motions that the program does not wait for; only for use inside
            this package.

    Raises:
        CalibrationError: The arm is not calibrated, and the motion is more than a small step of
            single joints; nothing has moved.
        RefusedError: The arm would touch something, and nothing has moved; or the guard stopped the
            motion, and the arm holds.
        StoppedError: ``stop``, called here or by another process, ended a motion; the arm holds.
        KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
    """

    is_remote = False
    """Whether the servos are on another machine."""

    def __init__(self, context: ArmContext, runner: MotionRunner, on_exit: OnExit = "hold") -> None:
        self._on_exit: OnExit = check_exit(on_exit)
        self._context, self._runner, self._port = context, runner, context.port
        self.model: Model = context.model
        self.chain: Chain = context.chain
        self.zeros: ZeroSource = context.zeros
        self.joint_index: JointIndex = context.index
        self.poses = PoseLibrary(context.model, context.serial_number)
        self.preflight = PreflightPlanner(context, runner, self.poses)
        self.background = Background(runner, context.servos.stop_request)
        runner.on_overheat = self._lower

    def __repr__(self) -> str:
        """Show the arm, its port and the reason for a stop, without reading a servo."""
        state = "open" if self._port.is_open else "closed"
        stopped = f", stopped: {self.stopped_for}" if self.stopped_for else ""
        return f"Arm({self.model.name!r} on {self.port_name!r}, {state}{stopped})"

    def __enter__(self) -> Self:
        """Return the arm; leaving the block closes it.

        Raises:
            PortError: The arm has already been closed.
        """
        self._runner.check_open()
        return self

    @property
    def scene(self) -> Scene:
        """The things around the arm, and the things that its gripper holds."""
        return self._scene

    @cached_property
    def _scene(self) -> Scene:
        from ikservo.arm.scene import Scene  # noqa: PLC0415  # few programs use it

        return Scene(self._context, self._runner)

    @property
    def context(self) -> ArmContext:
        """The arm's servos, model, calibration and checks; only for use inside this package."""
        return self._context

    @property
    def runner(self) -> MotionRunner:
        """The motion runner; only for use inside this package."""
        return self._runner

    @property
    def port_name(self) -> str:
        """The name of the port to which the arm is connected."""
        return self._port.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in the order used in vectors (n,)."""
        return self._context.servos.names

    @property
    def clock(self) -> Clock:
        """The clock of the port: simulated time on a simulated bus."""
        return self._context.servos.clock

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lower and upper limits (n,), rad or m, at whole ticks; read-only arrays."""
        return self._context.limits()

    def clearance_m(self, positions: Positions) -> float:
        """Return the smallest distance [m] between parts of the arm, or to the table or a box.

        ``positions`` are given by joint, rad or m (other joints: as measured), or for all joints
        (n,). The distance is infinite if the arm is not calibrated or has no collision checks.
        """
        return self.preflight.clearance_m(positions)

    def where(self) -> ArmState:
        """Measure the tip, the joints and the servos' health.

        While another thread moves the arm, the values are those of its last control cycle.
        """
        return self._runner.state()

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle; reads no servo and is safe in any thread.

        Raises:
            IkservoError: There is no state yet.
        """
        return self._runner.last_state()

    def close(self, on_exit: OnExit | None = None) -> None:
        """Close the port and leave the arm holding or relaxed; a second call does nothing.

        Motions in the background are cancelled; another running motion ends with ``StoppedError``.
        ``on_exit`` is ``hold`` or ``relax``; None uses the value given to ``open_arm``.

        Raises:
            UnknownNameError: ``on_exit`` is neither ``hold`` nor ``relax``; the arm stays open.
            RefusedError: A callback of the arm's motion tried to relax and close the arm.
        """
        chosen = check_exit(on_exit or self._on_exit)
        if self._port.is_open:
            self.background.close()
            self._runner.close(self.relax if chosen == "relax" else None, self._leave)

    def listen(self) -> None:
        """Accept stop, state and relax commands from this user's other processes.

        If another process has already stopped this program, the arm is stopped.
        """
        listener = self._context.servos.bus.stop_listener
        if not isinstance(listener, StopListener) or not listener.is_served:
            return
        from ikservo.arm.control_server import command_handler  # noqa: PLC0415
        from ikservo.arm.service import ArmService  # noqa: PLC0415

        self._runner.caches_states = True
        stopped = listener.hand_over(command_handler(ArmService(self)))
        if stopped:
            self.request_stop(StopReason(StopKind.CLIENT, stopped))

    def enable(self) -> None:
        """Switch torque on; each servo's goal is set to its position first, so nothing moves.

        Raises:
            RefusedError: A motion is running; ``stop`` ends it.
        """
        self._runner.enable()

    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower the arm slowly to its rest pose, then switch every servo's torque off.

        The rest pose is clamped to the limits. If the arm cannot be lowered, because something is
        in the way or a servo has a fault, torque is switched off at once; the result then has
        ``reached`` False and the reason in ``binding``.

        Raises:
            CalibrationError: The arm is not calibrated; see ``disable_torque``.
            RefusedError: A motion is running, or a stop was not acknowledged; the arm holds.
            BusError: A servo does not answer; the torque of all others is off.
        """
        from ikservo.arm.plan_execution import relax  # noqa: PLC0415

        return relax(self, on_progress)

    def disable_torque(self) -> None:
        """Switch every servo's torque off; an arm that is not supported falls.

        A running motion ends with ``StoppedError`` first.

        Raises:
            BusError: A servo does not answer; the torque of all others is off.
        """
        self._runner.disable_torque()

    def reconnect(self, within_s: float = 10.0) -> None:
        """Open the port again after the cable was unplugged; nothing moves.

        The call waits up to ``within_s`` for the adapter, which is identified by its USB serial
        number. The arm stays stopped until ``acknowledge``. The servos may have lost power, so
        torque is read again, and the first motion is slow.

        Raises:
            BadValueError: The wait is not a number of seconds.
            PortLostError: The adapter did not come back in time.
            ServoSilentError: A servo does not answer.
            RefusedError: A motion is running.
        """
        self._runner.reconnect(within_s)

    def return_within_limits(self) -> None:
        """Slowly move joints that are slightly outside their limits back inside."""
        self._runner.return_within_limits()

    def request_stop(self, reason: StopReason) -> None:
        """Stop the arm like ``stop``, with a reason of any kind."""
        self._runner.request_stop(reason)

    @property
    def stop_requests(self) -> int:
        """Number of stop requests since the last ``acknowledge``."""
        return self._runner.stop_requests

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop, until ``acknowledge``; None if the arm is not stopped."""
        return self._runner.stop_reason

    def acknowledge(self) -> None:
        """Acknowledge a stop: the arm may be moved again, but nothing moves yet."""
        self._runner.acknowledge()

    def plan(self, motion: MotionValue[Any]) -> MotionPlan:
        """Plan a motion from the present position; see ``MotionMethods.plan``."""
        return self.preflight.plan(check_motion(motion))

    def pose_within_limits(self, pose: str, start: Vector | None = None) -> PoseWithinLimits:
        """Clamp a named pose to this arm's limits, which may exclude it.

        The rest pose is clamped however far outside the limits it is, because it must always be
        possible to lower the arm. Other poses are clamped only if joints are on end stops, just
        outside a limit. ``start`` holds the present joints (n,); measured if None.

        Raises:
            UnknownNameError: There is no such pose.
            BadValueError: ``start`` has the wrong shape, or a number is not finite.
        """
        return self.preflight.pose_within_limits(pose, start)

    def _execute_plan(
        self, plan: MotionPlan, on_progress: OnProgress | None
    ) -> MoveResult | JointMoveResult:
        from ikservo.arm.plan_execution import execute  # noqa: PLC0415

        return execute(self, plan, on_progress)

    def _make(self, motion: MotionValue[R], on_progress: OnProgress | None, own_stops: int) -> R:
        from ikservo.arm.run_by_kind import run_motion  # noqa: PLC0415

        return run_motion(self, motion, on_progress)

    # Methods that are functions of an arm, defined in the modules of their subjects.
    if TYPE_CHECKING:
        jog = jogging.jog
        follow = following.follow
        follow_arm = leader_following.follow_arm
        follow_goals = following.follow_goals
        stream = setpoint_stream.open_stream
    else:
        jog = ImportedMethod("ikservo.arm.jogging:jog")
        follow = ImportedMethod("ikservo.arm.following:follow")
        follow_arm = ImportedMethod("ikservo.arm.leader_following:follow_arm")
        follow_goals = ImportedMethod("ikservo.arm.following:follow_goals")
        stream = ImportedMethod("ikservo.arm.setpoint_stream:open_stream")

    def teach(
        self, name: str, until: Callable[[], object] | None = None, *, hold: bool = False
    ) -> dict[str, float]:
        """Save the measured positions as a pose of this arm; return them, rad or m by joint.

        Args:
            name: 1 to 64 of A-Z a-z 0-9 _ -; not a pose of the arm file.
            until: Called while the user moves the arm by hand; returns once this is done. An arm
                that holds is relaxed first. If None, the arm is not relaxed.
            hold: Whether torque is switched on afterwards.

        Raises:
            BadValueError: The name cannot be used; nothing has moved.
            FileWriteError: The pose cannot be saved.
        """
        check_flag("hold", hold)
        positions = teach(self._context, self.poses, name, until, self.relax)
        if hold:
            self.enable()
        return positions

    def target_period_s(self) -> float:
        """Return the time between two control cycles; only for use inside this package."""
        return self._runner.loop.measure_cycle_time_s()

    @contextmanager
    def leader_positions(
        self, joints: Sequence[str], period_s: float, until: Callable[[], bool] | None
    ) -> Generator[Iterator[dict[str, float] | None]]:
        """Yield an iterator that measures joints in every period; for ``follow_arm``."""
        from ikservo.arm.leader_following import leader_positions  # noqa: PLC0415

        yield leader_positions(self._context, joints, period_s, until)

    def _lower(self) -> None:
        from ikservo.arm.plan_execution import lower  # noqa: PLC0415

        lower(self)

    def _leave(self) -> None:
        if "_scene" in vars(self):
            self._scene.close()
        listener = self._context.servos.bus.stop_listener
        if listener is not None:
            listener.close()
