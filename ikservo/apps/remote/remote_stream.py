"""Goals that a program streams to an arm on another machine."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterable, Mapping

from numpy.typing import ArrayLike

from ikservo.apps.remote.client_connection import Connection, PendingCall
from ikservo.apps.remote.motion_calls import MotionCalls
from ikservo.apps.remote.wire_messages import StreamCounts, TargetFields, parse_result
from ikservo.arguments import parse_period_s
from ikservo.arm import MotionProgress, OpenArm
from ikservo.arm.target_tracking import CartesianOrJointTarget, parse_setpoint
from ikservo.clock import Clock, Rate
from ikservo.errors import RefusedError
from ikservo.ik import Target
from ikservo.kinematics.arrays import Matrix, Vector

_CLOSE_TIMEOUT_S, _END_PERIOD_S = 10.0, 0.1


class RemoteStream:
    """Stream of setpoints in a ``with`` block; see ``Arm.stream`` and ``SetpointStream``.

    Attributes:
        sent: The number of setpoints that were sent.
        unreached: The number of setpoints out of reach; known at the end of the block.
        refused: The number of setpoints that the guard refused; known at the end of the block.
        reason: The reason for the last refusal.
        kept: Always None, because the goal that the arm kept is known only on its machine.
    """

    def __init__(
        self,
        arm: OpenArm,
        connection: Connection,
        calls: MotionCalls,
        speed: str,
        rate_hz: float | None,
    ) -> None:
        self._arm, self._connection, self._calls, self._speed = arm, connection, calls, speed
        self._period_s = parse_period_s(rate_hz)
        self._due_s = 0.0
        self._pending: PendingCall | None = None
        self.sent = self.unreached = self.refused = 0
        self.reason = ""
        self.kept: Vector | None = None

    def __enter__(self) -> RemoteStream:
        """Take control and start; the arm moves from the first setpoint on.

        Raises:
            RefusedError: The stream was used before, or another program controls the arm.
        """
        if self._pending is not None:
            raise RefusedError("This stream was used before.", "Open another: arm.stream().")
        self._pending = self._calls.start("stream", speed=self._speed)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Brake and hold; raise the stream's error, unless the ``with`` block raised one."""
        pending = self._require_pending()
        end_s = time.monotonic() + _CLOSE_TIMEOUT_S
        while not pending.done and time.monotonic() < end_s:  # the server drops later goals
            self._connection.send_setpoint(wanted=False)
            pending.wait(_END_PERIOD_S)
        if error is None:
            self._take_counts(pending)

    @property
    def progress(self) -> MotionProgress | None:
        """Always None, because the control loop runs on the machine of the arm."""
        return None

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order used in arrays (n,)."""
        return self._arm.joint_names

    def send(self, setpoint: Mapping[str, float] | ArrayLike | Target) -> None:
        """Send a setpoint, which replaces the previous one. See ``SetpointStream.send``.

        Raises:
            BadValueError: The value is not a setpoint, or a number is not finite.
            UnknownNameError: There is no such joint.
            IkservoError: The error that ended the stream; the arm holds.
        """
        goal = goal_fields(parse_setpoint(setpoint, self.names))
        pending = self._require_pending()
        if pending.done:
            self._take_counts(pending)
            raise RefusedError("The stream is closed.", "Open another: arm.stream().")
        self._connection.send_setpoint(**goal)
        self.sent += 1
        if self._period_s is not None:
            self._due_s = max(self._due_s + self._period_s, self._arm.clock.now_s())
            self._arm.clock.sleep_until(self._due_s)

    def _take_counts(self, pending: PendingCall) -> None:
        counts = parse_result(StreamCounts, pending.result())
        self.unreached, self.refused = counts.unreached, counts.refused
        self.reason = counts.reason

    def _require_pending(self) -> PendingCall:
        if self._pending is None:
            raise RefusedError("The stream is not open.", "Open it: with arm.stream() as stream:")
        return self._pending


def goal_fields(goal: Target | Mapping[str, float] | Matrix) -> dict[str, object]:
    """Return the fields of a ``Setpoint`` for a goal that ``target_tracking`` has parsed."""
    if isinstance(goal, Target):
        return {"target": TargetFields.of(goal)}
    return {"positions" if isinstance(goal, Mapping) else "pose": goal}


def next_items(
    clock: Clock, targets: Iterable[CartesianOrJointTarget | None], period_s: float
) -> Generator[tuple[CartesianOrJointTarget | None, bool]]:
    """Yield an item per period, and whether ``targets`` have ended; then None and True."""
    items = iter(targets)
    for _ in Rate(clock, period_s):
        try:
            yield next(items), False
        except StopIteration:
            break
    while True:
        yield None, True
        time.sleep(period_s)
