"""An arm on another machine, with the methods, results and errors of ``Arm``."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Self, TypeVar, get_args

from numpy.typing import ArrayLike

from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.motion_calls import MotionCalls
from ikservo.apps.remote.plan_fields import RemoteTrajectory
from ikservo.apps.remote.remote_description import RemotePoses, describe, described_chain
from ikservo.apps.remote.remote_stream import RemoteStream, goal_fields, next_items
from ikservo.apps.remote.wire_messages import ClampedPose, ServedHealth, parse_result
from ikservo.arguments import (
    OnExit,
    check_callable,
    check_exit,
    check_iterable,
    parse_all_positions,
)
from ikservo.arm import (
    ArmState,
    JointMoveResult,
    MotionPlan,
    MoveResult,
    StopKind,
    StopReason,
    ZeroSource,
)
from ikservo.arm.arm_protocol import KeepGoing
from ikservo.arm.background_motion import Background
from ikservo.arm.leader_following import follow_arm, published_positions
from ikservo.arm.motion_methods import MotionMethods
from ikservo.arm.target_tracking import CartesianOrJointTarget, parse_target
from ikservo.clock import Clock, RealClock
from ikservo.control.stop_requests import REQUEST_HINT, STOPPED_AFTER_REQUEST
from ikservo.errors import BadValueError, PortError, RefusedError, StoppedError, shown
from ikservo.kinematics import JointIndex
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.planning.motions import MotionValue, check_motion, motion_fields
from ikservo.planning.poses import PoseLibrary, PoseWithinLimits
from ikservo.planning.reports import FollowResult, JogResult, OnProgress

R = TypeVar("R")

_TARGET_PERIOD_S = 0.01


class RemoteArm(MotionMethods):
    """An open arm on another machine; see ``Arm`` for what each method does.

    The arm is controlled from its first motion until it is closed. Plans stay on the
    server of the arm.

    Args:
        model: The model of the arm on this machine.
        connection: The connection to the server of the arm; closed with the arm.
        on_exit: The torque after ``close``: ``hold`` or ``relax``.

    Raises:
        InputError: The served arm's joints differ from the model's.
    """

    is_remote = True

    def __init__(self, model: Model, connection: Connection, on_exit: OnExit = "hold") -> None:
        self._on_exit: OnExit = check_exit(on_exit)
        self._connection = connection
        self._calls = MotionCalls(connection)
        self._described = describe(model, connection)
        self.model, self.chain = model, described_chain(model, self._described)
        self.zeros = ZeroSource[self._described.zeros]
        self.joint_index = JointIndex.from_names(self.joint_names, self.chain.names)
        self.poses: PoseLibrary = RemotePoses(model, connection)
        self.background = Background(self, self._calls.stop_request)

    def __repr__(self) -> str:
        """Show arm and address."""
        state = "open" if self._connection.is_open else "closed"
        return f"RemoteArm({self.model.name!r} at {self.port_name!r}, {state})"

    def __enter__(self) -> Self:
        """Return the arm; leaving the block closes it.

        Raises:
            PortError: The arm has already been closed.
        """
        if not self._connection.is_open:
            raise PortError(f"{self.port_name} was closed.", "Open the arm again: open_arm().")
        return self

    @property
    def port_name(self) -> str:
        """The address of the arm."""
        return str(self._connection.address)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """All joints, in the order used in vectors (n,)."""
        return self._described.joints

    @property
    def clock(self) -> Clock:
        """The clock of this computer."""
        return RealClock()

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lower and upper limits (n,), in whole ticks, rad or m; read-only."""
        return self._described.lower, self._described.upper

    def clearance_m(self, positions: Mapping[str, float] | ArrayLike) -> float:
        """Return the minimum clearance of the body [m]; see ``Arm.clearance_m``."""
        given = parse_all_positions(positions, self.joint_names)
        return parse_result(float, self._connection.watch("clearance", positions=given))

    def where(self) -> ArmState:
        """Measure the tip, the joints and the servos' health."""
        return parse_result(ArmState, self._connection.watch("where"))

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle.

        Raises:
            IkservoError: No control cycle has run yet.
        """
        return parse_result(ArmState, self._connection.watch("last_state"))

    def health(self) -> Mapping[str, Any]:
        """Return state, operator, stop reason and temperature of the arm; see ``ikservo fleet``."""
        return self._health().model_dump()

    def close(self, on_exit: OnExit | None = None) -> None:
        """Release control and close the connection; see ``Arm.close``."""
        chosen = check_exit(on_exit or self._on_exit)
        if not self._connection.is_open:
            return
        try:
            self.background.close()
            if chosen == "relax":
                self.relax()
        finally:
            self._connection.close()

    # torque and stops

    def enable(self) -> None:
        """Switch torque on without motion; see ``Arm.enable``."""
        self._calls.run("enable", None)

    def relax(self, on_progress: OnProgress | None = None) -> JointMoveResult:
        """Lower the arm to its rest pose, then switch torque off; see ``Arm.relax``."""
        return parse_result(JointMoveResult, self._calls.run("relax", on_progress))

    def disable_torque(self) -> None:
        """Switch every servo's torque off; an arm that is not supported falls."""
        self._connection.drive("disable_torque")

    def reconnect(self, within_s: float = 10.0) -> None:
        """Refuse, because only the server of the arm can reopen the port.

        Raises:
            RefusedError: Always.
        """
        text = f"Reopening the port within {within_s:g} s works only on the arm's computer."
        raise RefusedError(text, f"Run the program on {self._connection.address.endpoint.host}.")

    def return_within_limits(self) -> None:
        """Move joints that are a little outside their limits back inside, slowly."""
        self._calls.run("return_within_limits", None)

    def request_stop(self, reason: StopReason) -> None:
        """Stop the arm like ``stop``, for any kind of reason."""
        self._calls.stop_request.set(reason)

    @property
    def stop_requests(self) -> int:
        """Number of requested stops since the last ``acknowledge``."""
        return self._health().stop_requests

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop until ``acknowledge``; None if the arm is not stopped."""
        health = self._health()
        if not health.stop_kind:
            return None
        kind = StopKind.__members__.get(health.stop_kind, StopKind.PROGRAM)
        return StopReason(kind, health.stop_text)

    def _health(self) -> ServedHealth:
        return parse_result(ServedHealth, self._connection.watch("health"))

    def acknowledge(self) -> None:
        """Acknowledge a stop: the arm may move again, but nothing moves yet."""
        self._connection.acknowledge()

    # plans

    def plan(self, motion: MotionValue[Any]) -> MotionPlan:
        """Plan a motion from the present position; see ``Arm.plan``."""
        return self._calls.plan(check_motion(motion))

    def pose_within_limits(self, pose: str, start: Vector | None = None) -> PoseWithinLimits:
        """Clamp a named pose to this arm's limits; see ``Arm.pose_within_limits``."""
        found = self._connection.watch("within_limits", pose=pose, start=start)
        clamped = parse_result(ClampedPose, found)
        return PoseWithinLimits(clamped.positions, tuple(clamped.changed))

    def _execute_plan(
        self, plan: MotionPlan, on_progress: OnProgress | None
    ) -> MoveResult | JointMoveResult:
        """Execute a plan of this arm."""
        path = getattr(plan, "trajectory", None)
        if plan.motion is None or not isinstance(path, RemoteTrajectory):
            raise BadValueError("The plan", shown(plan), "a plan of this arm")
        done = self._calls.run("execute", on_progress, plan=path.plan)
        return parse_result(_result_type(plan.motion), done)

    @property
    def _own_stops(self) -> int:
        return self._calls.stop_request.count_here

    def _make(self, motion: MotionValue[R], on_progress: OnProgress | None, own_stops: int) -> R:
        if self._own_stops != own_stops:
            raise StoppedError(STOPPED_AFTER_REQUEST.text, REQUEST_HINT)
        done = self._calls.run("move", on_progress, motion=motion_fields(motion))
        return parse_result(_result_type(motion), done)

    def jog(self, what: str, speed: float | None = None, *, wanted: KeepGoing) -> JogResult:
        """Move a joint or the tip while ``wanted`` returns True; see ``Arm.jog``."""
        if not callable(wanted):
            raise BadValueError("The argument `wanted`", shown(wanted), "a function")
        pending = self._calls.start("jog", what=what, speed=speed)

        def go_on() -> None:
            chosen = wanted()
            if chosen is not None:
                self._connection.send_setpoint(wanted=chosen)

        return parse_result(JogResult, self._calls.await_result(pending, go_on))

    def follow(
        self,
        targets: Iterable[CartesianOrJointTarget | None],
        *,
        speed: str = "normal",
        on_progress: OnProgress | None = None,
    ) -> FollowResult:
        """Follow a stream of targets, a hundred per second, until it ends; see ``Arm.follow``."""
        check_iterable("The stream of targets", targets, "an iterable of targets")
        items = next_items(self.clock, targets, _TARGET_PERIOD_S)

        def send_next() -> None:
            goal, ended = next(items, (None, True))
            if goal is not None:
                self._connection.send_setpoint(**goal_fields(parse_target(goal, self.joint_names)))
            elif ended:
                self._connection.send_setpoint(wanted=False)

        with self._calls.reporting(on_progress):
            pending = self._calls.start("follow", speed=speed)
            result = self._calls.await_result(pending, send_next, poll_s=0.0)
            return parse_result(FollowResult, result)

    follow_arm = follow_arm

    def target_period_s(self) -> float:
        """Return the time between two sent targets."""
        return _TARGET_PERIOD_S

    @contextmanager
    def leader_positions(
        self, joints: Sequence[str], period_s: float, until: Callable[[], bool] | None
    ) -> Generator[Iterator[dict[str, float] | None]]:
        """Yield the newest published positions once per period, for ``follow_arm``."""
        newest: list[ArmState] = []

        def keep(value: object) -> None:
            if isinstance(value, ArmState):
                newest[:] = [value]

        def take() -> dict[str, float] | None:
            return newest.pop().positions if newest else None

        with self._connection.subscribed("state", keep):
            yield published_positions(take, joints, period_s, until)

    def stream(self, *, speed: str = "normal", rate_hz: float | None = None) -> RemoteStream:
        """Open a stream of setpoints; see ``Arm.stream``."""
        return RemoteStream(self, self._connection, self._calls, speed, rate_hz)

    def teach(
        self, name: str, until: Callable[[], object] | None = None, *, hold: bool = False
    ) -> dict[str, float]:
        """Save the measured joint positions as a pose on the arm's machine; see ``Arm.teach``."""
        check_callable("until", until)
        self.poses.check_name(name)
        if until is not None:
            if any(joint.torque for joint in self.where().joints):
                self.relax()
            until()
        taught = self._calls.run("teach", None, name=name, hold=hold)
        return parse_result(dict[str, float], taught)


def _result_type(motion: MotionValue[R]) -> type[R]:
    """Return the type of a motion's result, from the base ``MotionValue[R]`` of its class."""
    (result,) = get_args(vars(type(motion))["__orig_bases__"][0])
    return result
