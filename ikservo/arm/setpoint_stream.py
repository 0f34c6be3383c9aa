"""Setpoints that a program sends at its own rate; the control loop keeps them within the limits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import TypeVar

from numpy.typing import ArrayLike

from ikservo.arguments import parse_period_s
from ikservo.arm.arm_protocol import ArmParts
from ikservo.arm.background_motion import Motion
from ikservo.arm.following import follow_targets
from ikservo.arm.target_tracking import CartesianOrJointTarget, parse_setpoint
from ikservo.clock import Clock, RealClock
from ikservo.errors import RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from ikservo.ik import Target
from ikservo.kinematics.arrays import Vector
from ikservo.planning.reports import MotionProgress

_POLL_PERIOD_S = 0.1  # time in which a waiting sender notices the loop's end


class SetpointMailbox:
    """Mailbox for the newest setpoint from the program to the control loop.

    Simulated time could run far ahead of the program. Therefore, it pauses until the next setpoint
    from a sender with a fixed rate; for other senders, it follows real time.

    Args:
        clock: The clock of the arm.
        period_s: Time between two setpoints from a sender with a fixed rate; None for other
            senders.
        ended: Returns whether the control loop has ended.
    """

    def __init__(self, clock: Clock, period_s: float | None, ended: Callable[[], bool]) -> None:
        self._clock, self._period_s, self._ended = clock, period_s, ended
        self._real = isinstance(clock, RealClock)
        self._changed = threading.Condition()
        self._setpoint: CartesianOrJointTarget | None = None
        self._taken_s, self._due_s = 0.0, 0.0
        self._late = self._closed = False
        self.put_count = 0
        self._taken_count = 0

    def put(self, setpoint: CartesianOrJointTarget) -> None:
        """Replace the setpoint; return when the next is due, or at once without a fixed rate."""
        with self._changed:
            self._setpoint, self._late = setpoint, False
            self.put_count += 1
            self._changed.notify_all()
            if self._period_s is None:
                return
            count = self.put_count
            while self._taken_count < count and not self._ended():
                self._changed.wait(_POLL_PERIOD_S)
        if self._real:
            self._due_s = max(self._due_s + self._period_s, self._clock.now_s())
            self._clock.sleep_until(self._due_s)
            return
        with self._changed:
            while self._clock.now_s() - self._taken_s < self._period_s and not self._ended():
                self._changed.wait(_POLL_PERIOD_S)

    def close(self) -> None:
        """End the control loop."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def await_first(self) -> bool:
        """Wait for a setpoint; return whether one arrived before the mailbox was closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._setpoint is not None)
            return not self._closed

    def setpoints(self) -> Iterator[CartesianOrJointTarget | None]:
        """Yield the newest setpoint, or None, in each control cycle until the mailbox is closed."""
        start_s, start_wall_s = self._clock.now_s(), time.monotonic()
        self._taken_s, self._late = start_s, False
        while not self._closed:
            now_s = self._clock.now_s()
            if not self._real and self._period_s is None:
                wall_s = time.monotonic() - start_wall_s
                time.sleep(max(0.0, now_s - start_s - wall_s))
            yield self._take_setpoint(now_s)

    def _take_setpoint(self, now_s: float) -> CartesianOrJointTarget | None:
        with self._changed:
            due = self._period_s is not None and now_s - self._taken_s >= self._period_s
            if due and not (self._real or self._late or self._has_update()):
                # Simulated time is paused until the next setpoint.
                self._changed.notify_all()  # wakes a sender that waits for this instant
                updated = self._changed.wait_for(self._has_update, timeout=DEAD_MAN_TIMEOUT_S)
                self._late = not updated
            setpoint, self._setpoint = self._setpoint, None
            if setpoint is not None:
                # At a fixed rate, the setpoint counts as taken at its nominal time.
                planned_s = self._taken_s + (self._period_s or 0.0)
                on_time = self._period_s is not None and now_s - planned_s < self._period_s
                self._taken_s = planned_s if on_time else now_s
                self._taken_count = self.put_count
            self._changed.notify_all()
            return setpoint

    def _has_update(self) -> bool:
        return self._closed or self._setpoint is not None


T = TypeVar("T")


class SetpointStream:
    """A stream that accepts setpoints in a ``with`` block; see ``Arm.stream``.

    Attributes:
        unreached: The number of setpoints out of reach; the arm moved as close to them as it could.
        refused: The number of setpoints that the guard refused; the arm kept the previous one.
        reason: The reason for the last refusal.
        kept: The goal (n,) that the arm kept at the last refusal, rad or m; None before that.
    """

    def __init__(self, arm: ArmParts, speed: str, rate_hz: float | None) -> None:
        context = arm.context
        context.require_zeros()
        context.model.speed(speed)
        arm.runner.check_open()
        self._arm, self._context, self._speed = arm, context, speed
        self._mailbox = SetpointMailbox(
            context.servos.clock, parse_period_s(rate_hz), lambda: self._has_ended
        )
        self._motion: Motion[None] | None = None
        self._progress: MotionProgress | None = None
        self._raised = False
        self.unreached = self.refused = 0
        self.reason = ""
        self.kept: Vector | None = None

    def __enter__(self) -> SetpointStream:
        """Start accepting setpoints; the arm moves from the first one on.

        Raises:
            RefusedError: The stream has already been used, or another one is open.
        """
        if self._motion is not None:
            raise RefusedError("This stream has already been used.", "Open another: arm.stream().")
        self._motion = self._arm.background.start_stream(self._follow_setpoints)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Brake and hold; raise the stream's error, unless the ``with`` block raised one."""
        self._mailbox.close()
        motion = self._require_motion()
        if error is None and not self._raised:
            motion.wait()
        else:
            motion.cancel()
            motion.join()

    def send(self, setpoint: Mapping[str, float] | ArrayLike | Target) -> None:
        """Send a setpoint; it replaces the previous one.

        The call returns at once or, with ``rate_hz``, once the next setpoint is due.

        Args:
            setpoint: Positions by joint, or of all joints (n,) in the order of ``names``, rad or m;
                a pose T_base_tip (4, 4); or a ``Target``, for a point
                ``Target((0.25, 0.0, 0.15))``. Positions are clamped to the limits.

        Raises:
            BadValueError: The setpoint has none of these forms, or a number is not finite.
            UnknownNameError: There is no such joint.
            StoppedError: The arm was stopped; it holds.
            IkservoError: The error that ended the stream; the arm holds.
        """
        checked = parse_setpoint(setpoint, self.names)
        self._check_running()
        self._mailbox.put(checked)
        self._check_running()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, in the order used in arrays (n,)."""
        return self._context.servos.names

    @property
    def progress(self) -> MotionProgress | None:
        """The last control cycle: measured positions, setpoints and tip; None before the first."""
        return self._progress

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings since the first setpoint: a servo is hot, or is about to protect itself."""
        return tuple(self._context.servos.warnings)

    @property
    def sent(self) -> int:
        """Number of setpoints sent."""
        return self._mailbox.put_count

    def __repr__(self) -> str:
        """Show the numbers of setpoints sent and refused."""
        state = "closed" if self._has_ended else "open"
        return f"SetpointStream({state}, {self.sent} sent, {self.refused} refused)"

    @property
    def _has_ended(self) -> bool:
        return self._motion is not None and self._motion.done

    def _follow_setpoints(self) -> None:
        """Follow setpoints, and hold while there are none."""
        self._context.warm_up()
        while self._mailbox.await_first():
            setpoints = self._mailbox.setpoints()
            report = follow_targets(
                self._arm, setpoints, self._speed, self._store_progress, self._store_refusal
            )
            self.unreached += report.unreached

    def _store_progress(self, progress: MotionProgress) -> None:
        self._progress = progress

    def _store_refusal(self, error: RefusedError, kept: Vector) -> None:
        self.reason, self.kept = error.message, kept
        self.refused += 1  # changes last: a sender that sees it reads the others

    def _require_motion(self) -> Motion[None]:
        if self._motion is None:
            raise RefusedError("The stream is not open.", "Open it: with arm.stream() as stream:")
        return self._motion

    def _check_running(self) -> None:
        motion = self._require_motion()
        if motion.done:
            self._raised = True  # the end of the block does not raise it again
            motion.wait()
            raise RefusedError("The stream is closed.", "Open another: arm.stream().")


def open_stream(
    arm: ArmParts, *, speed: str = "normal", rate_hz: float | None = None
) -> SetpointStream:
    """Open a stream of setpoints, which the program sends at its own rate.

    ::

        with arm.stream(speed="fast", rate_hz=50) as stream:
            for q in trajectory:           # (n,), or {"elbow_flex": 0.3}, or a Target
                stream.send(q)

    The arm follows the newest setpoint as fast as the speed class (slow, normal or fast, which
    follows most closely) allows, without jumps, through the guard. After 0.3 s without a setpoint,
    and at the end of the block, it brakes and holds. An error ends the stream and is raised by the
    next ``send``, or at the end of the block. With ``rate_hz``, 5 to 1000 setpoints per second,
    ``send`` returns when the next one is due; otherwise it returns at once.

    Raises:
        CalibrationError: The arm is not calibrated.
        BadValueError: The rate is out of its range.
        RefusedError: Another stream is open.
    """
    return SetpointStream(arm, speed, rate_hz)
