"""Inbox for the operator's setpoints, between the network and the running motion."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator

from ikservo.apps.remote.wire_messages import Setpoint
from ikservo.arm import OpenArm, StopKind, StopReason
from ikservo.arm.target_tracking import CartesianOrJointTarget
from ikservo.clock import RealClock
from ikservo.control.stop_requests import RELAX_HINT
from ikservo.errors import StoppedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from ikservo.kinematics import finite_array

_POLL_S = 0.05


class SetpointInbox:
    """Store of the newest goal, and of whether the operator wants the motion to continue.

    Setpoints may overtake the request that starts their motion. Therefore, setpoints that arrive
    before ``begin`` are kept, and are used if they were sent after that request.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._begun, self._closed = ("", 0), True
        self._goal: tuple[Setpoint, CartesianOrJointTarget] | None = None
        self._go_on: Setpoint | None = None
        self._end: Setpoint | None = None
        self._goal_s = math.inf

    def begin(self, lease: str, number: int) -> None:
        """Start the motion of a lease's numbered request; use setpoints sent after the request."""
        with self._changed:
            self._begun, self._closed, self._goal_s = (lease, number), False, math.inf

    def put(self, setpoint: Setpoint) -> None:
        """Store a setpoint that the lease has accepted.

        Raises:
            BadValueError: The target is not valid.
        """
        goal: CartesianOrJointTarget | None = setpoint.positions
        if setpoint.target is not None:
            goal = setpoint.target.target()
        elif setpoint.pose is not None:
            goal = finite_array(setpoint.pose, (4, 4), "The setpoint")
        with self._changed:
            if goal is not None:
                self._goal = (setpoint, goal)
            if setpoint.wanted:
                self._go_on = setpoint
            elif setpoint.wanted is not None:
                self._end = setpoint
            self._changed.notify_all()

    def close(self) -> None:
        """End the motion, because the operator is gone."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def wanted(self) -> bool:
        """Whether the operator wants the motion to continue."""
        return not (self._closed or self._counts(self._end))

    def take(self) -> CartesianOrJointTarget | None:
        """Return the newest goal once; None if there is no new goal."""
        with self._changed:
            found, self._goal = self._goal, None
            if found is None or not self._counts(found[0]):
                return None
            self._goal_s = time.monotonic()
            return found[1]

    def wait(self) -> None:
        """Wait for a new goal, the end of the motion, or a time-out."""
        with self._changed:
            self._changed.wait_for(lambda: self._goal is not None or not self.wanted, _POLL_S)

    def silence_s(self) -> float:
        """Return the time since the last new goal; negative before the first."""
        return time.monotonic() - self._goal_s

    def keep_going(self) -> bool | None:
        """Return whether to continue; None if the operator has sent nothing new."""
        with self._changed:
            if not self.wanted:
                return False
            said, self._go_on = self._counts(self._go_on), None
            return True if said else None

    def _counts(self, setpoint: Setpoint | None) -> bool:
        """Check whether a setpoint was sent after the request of the running motion."""
        lease, number = self._begun
        return setpoint is not None and setpoint.lease == lease and setpoint.number > number


class _Pace:
    """Pace that slows simulated time down to the real time of the operator."""

    def __init__(self, arm: OpenArm) -> None:
        self._clock = arm.clock
        self._real = isinstance(arm.clock, RealClock)
        self._start_s: tuple[float, float] | None = None

    def wait(self) -> None:
        """Wait until as much real as simulated time has passed since the first call."""
        if self._real:
            return
        now_s = self._clock.now_s()
        start_s, wall_s = self._start_s = self._start_s or (now_s, time.monotonic())
        time.sleep(max(0.0, now_s - start_s - (time.monotonic() - wall_s)))


def run_jog(arm: OpenArm, inbox: SetpointInbox, what: str, speed: float | None) -> object:
    """Jog as long as the operator's setpoints request it; see ``Arm.jog``."""
    pace = _Pace(arm)

    def wanted() -> bool | None:
        pace.wait()
        return inbox.keep_going()

    return arm.jog(what, speed, wanted=wanted)


def run_follow(arm: OpenArm, inbox: SetpointInbox, speed: str, timeout_s: float) -> object:
    """Follow the operator's goals until the operator ends the stream; see ``Arm.follow``.

    If the operator is alive but sends no goal within the time-out, the arm stops and holds.

    Raises:
        StoppedError: The arm was stopped.
    """
    result = arm.follow(_goals(arm, inbox, timeout_s), speed=speed)
    if inbox.wanted:  # the stream ended because no goal arrived
        _stop_without_goal(arm)
        raise StoppedError(arm.stopped_for, RELAX_HINT)
    return result


def _goals(
    arm: OpenArm, inbox: SetpointInbox, timeout_s: float
) -> Iterator[CartesianOrJointTarget | None]:
    """Yield the newest goal in each control cycle, or None."""
    pace = _Pace(arm)
    while inbox.wanted:
        pace.wait()
        goal = inbox.take()
        if inbox.silence_s() >= timeout_s and not arm.stop_requests:
            _stop_without_goal(arm)
        yield goal


def _stop_without_goal(arm: OpenArm) -> None:
    text = f"No goal was received for {DEAD_MAN_TIMEOUT_S:g} s; the arm holds its position."
    arm.request_stop(StopReason(StopKind.CLIENT, text))


def run_stream(arm: OpenArm, inbox: SetpointInbox, speed: str, timeout_s: float) -> object:
    """Send the operator's goals through ``Arm.stream`` until the operator ends the stream.

    If the operator is alive but sends no goal within the time-out, the arm stops and holds.

    Returns:
        The number of goals out of reach, the number of refused goals, and the reason.
    """
    with arm.stream(speed=speed) as stream:
        while inbox.wanted and arm.stop_reason is None:
            goal = inbox.take()
            if goal is not None:
                stream.send(goal)
            elif inbox.silence_s() > timeout_s:
                _stop_without_goal(arm)
            else:
                inbox.wait()
    if arm.stop_reason is not None:
        raise StoppedError(arm.stopped_for, RELAX_HINT)
    return {name: getattr(stream, name) for name in ("sent", "unreached", "refused", "reason")}
